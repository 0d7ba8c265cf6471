"""The words of rosbag2, written down by hand from its sources (branch jazzy)."""

from __future__ import annotations

import json
from pathlib import Path

from hypothesis import given as for_all
from hypothesis import settings
from hypothesis import strategies as st
import pytest
from shepherd_ros.recordings.recording_writer import offered_qos
from shepherd_ros.rosbag2.errors import BagError
from shepherd_ros.rosbag2.metadata import FileInfo, Metadata, TopicInfo
from shepherd_ros.rosbag2.qos import (
    agreed_policy,
    dump_yaml,
    duration_ns,
    history,
    INFINITE,
    load_yaml,
    Qos,
    qos_yaml,
    read_qos,
)
from shepherd_ros.wire.topics import contract
import yaml

HASH = 'RIHS01_df668c740482bbd48fb39d76a70dfd4bd59db1288021743503259e948f6b1a18'
QOS = """\
- history: keep_last
  depth: 1
  reliability: reliable
  durability: transient_local
  deadline:
    sec: 9223372036
    nsec: 854775807
  lifespan:
    sec: 9223372036
    nsec: 854775807
  liveliness: automatic
  liveliness_lease_duration:
    sec: 9223372036
    nsec: 854775807
  avoid_ros_namespace_conventions: false
"""
DOCUMENT = f"""\
rosbag2_bagfile_information:
  version: 9
  storage_identifier: mcap
  duration:
    nanoseconds: 30
  starting_time:
    nanoseconds_since_epoch: 100
  message_count: 3
  topics_with_message_count:
    - topic_metadata:
        name: /episode
        type: std_msgs/msg/String
        serialization_format: cdr
        offered_qos_profiles:
{''.join('          ' + line for line in QOS.splitlines(keepends=True))}\
        type_description_hash: {HASH}
      message_count: 3
  compression_format: ""
  compression_mode: ""
  relative_file_paths:
    - bag_0.mcap
    - bag_1.mcap
  files:
    - path: bag_0.mcap
      starting_time:
        nanoseconds_since_epoch: 100
      duration:
        nanoseconds: 10
      message_count: 2
    - path: bag_1.mcap
      starting_time:
        nanoseconds_since_epoch: 130
      duration:
        nanoseconds: 0
      message_count: 1
  custom_data:
    key: "9"
  ros_distro: jazzy
"""
VERSION_4 = """\
rosbag2_bagfile_information:
  version: 4
  storage_identifier: sqlite3
  relative_file_paths: [rosbag2_0.db3]
  duration: {nanoseconds: 5}
  starting_time: {nanoseconds_since_epoch: 7}
  message_count: 2
  topics_with_message_count:
  - topic_metadata:
      name: /t
      type: std_msgs/msg/String
      serialization_format: cdr
      offered_qos_profiles: "- history: 3\\n  depth: 0\\n  reliability: 2\\n  durability: 1\\n\
  deadline:\\n    sec: 2147483647\\n    nsec: 4294967295\\n\
  lifespan:\\n    sec: 1\\n    nsec: 2\\n  liveliness: 1\\n\
  liveliness_lease_duration:\\n    sec: 3\\n    nsec: 4\\n\
  avoid_ros_namespace_conventions: true"
    message_count: 2
  compression_format: ""
  compression_mode: ""
"""
LATCHED = Qos('reliable', 'transient_local', 'keep_last', 1)
TWO_FILES = Metadata(
    topics=(TopicInfo('/episode', 'std_msgs/msg/String', 3, (LATCHED,), HASH),),
    files=(FileInfo('bag_0.mcap', 100, 10, 2), FileInfo('bag_1.mcap', 130, 0, 1)),
    custom_data={'key': '9'},
)


def test_metadata_says_in_the_same_order_what_rosbag2_says() -> None:
    own, reference = yaml.safe_load(TWO_FILES.document()), yaml.safe_load(DOCUMENT)
    assert json.dumps(own) == json.dumps(reference)


def test_the_record_in_the_file_is_the_inner_map() -> None:
    inner = yaml.safe_load(DOCUMENT)['rosbag2_bagfile_information']
    assert yaml.safe_load(TWO_FILES.to_yaml()) == inner


@pytest.mark.parametrize('text', [TWO_FILES.document(), TWO_FILES.to_yaml()])
def test_metadata_comes_back(text: str) -> None:
    assert Metadata.from_yaml(text, Path('bag')) == TWO_FILES


def test_an_empty_bag_starts_at_the_end_of_time_and_has_no_data_of_its_own() -> None:
    text = Metadata(files=(FileInfo('bag_0.mcap'),)).to_yaml()
    assert 'starting_time:\n  nanoseconds_since_epoch: 9223372036854775807\n' in text
    assert 'duration:\n  nanoseconds: 0\n' in text
    assert 'custom_data: null\n' in text
    assert 'topics_with_message_count: []\n' in text


def test_profiles_of_a_channel_are_a_list_as_text() -> None:
    assert qos_yaml((LATCHED,)) == QOS
    assert qos_yaml(()) == '[]\n'
    assert read_qos(QOS, Path('bag')) == (LATCHED,)


def test_what_discovery_does_not_tell_is_unknown() -> None:
    assert qos_yaml((Qos(),)).startswith('- history: unknown\n  depth: 0\n')


def test_profiles_of_the_contract_have_words_of_rosbag2() -> None:
    for profile in contract()[1].values():
        qos = offered_qos(profile)
        assert (qos.history, qos.depth) == ('keep_last', profile.depth)
        assert (qos.reliability, qos.durability) == (profile.reliability, profile.durability)


def test_a_word_that_rosbag2_does_not_know_is_refused() -> None:
    with pytest.raises(ValueError, match=r"reliability is 'RELIABLE': expected one of system_def"):
        Qos('RELIABLE')


def test_older_versions_have_numbers_in_a_text() -> None:
    metadata = Metadata.from_yaml(VERSION_4, Path('bag'))
    (qos,) = metadata.topics[0].qos
    assert (qos.history, qos.reliability, qos.durability) == (
        'unknown', 'best_effort', 'transient_local',
    )  # fmt: skip
    assert (qos.lifespan, qos.liveliness_lease_duration) == ((1, 2), (3, 4))
    assert qos.avoid_ros_namespace_conventions
    assert (metadata.version, metadata.storage, metadata.distro) == (4, 'sqlite3', '')
    assert metadata.files == (FileInfo('rosbag2_0.db3', 7),)


def test_no_anchors_in_yaml_even_for_equal_parts() -> None:
    assert '&' not in qos_yaml((LATCHED, LATCHED))


def test_durations_are_ns_and_infinite_in_the_words_of_any_version() -> None:
    infinite = 2**63 - 1
    for duration, ns in (
        ((0, 0), infinite), ((2**31 - 1, 0), infinite), ((2**31 - 1, 2**32 - 1), infinite),
        (INFINITE, infinite), ((2**31 - 2, 5), (2**31 - 2) * 1_000_000_000 + 5), ((0, 7), 7),
        ((3, 0), 3_000_000_000), ((3, 4), 3_000_000_004),
    ):  # fmt: skip
        assert duration_ns(duration) == ns, duration


def test_a_late_reader_gets_what_all_latched_publishers_keep() -> None:
    latched = [Qos(durability='transient_local', depth=depth) for depth in (0, 1, 5)]
    assert history(tuple(latched)) == 1 + 1 + 5
    assert history((*latched, Qos())) == history((Qos(),)) == 0
    assert history(()) == 0


def test_publishers_that_disagree_offer_the_default() -> None:
    one, other = Qos('best_effort', depth=3), Qos('reliable', depth=3)
    assert agreed_policy((one, one), 'reliability') == 'best_effort'
    assert agreed_policy((one, other), 'depth') == 3
    assert (
        agreed_policy((one, other), 'reliability')
        == agreed_policy((), 'reliability')
        == 'reliable'
    )


def test_yaml_is_read_up_to_thirty_levels_and_sixteen_mebibytes() -> None:
    assert load_yaml('[' * 30 + ']' * 30, Path('bag')) is not None
    with pytest.raises(BagError, match='more than 30 levels'):
        load_yaml('[' * 31 + ']' * 31, Path('bag'))
    assert load_yaml('[' + '[], ' * 40 + ']', Path('bag')) == 40 * [[]]  # beside each other
    with pytest.raises(BagError, match=f'{2**24 + 1} characters: expected at most {2**24}'):
        load_yaml(' ' * (2**24 + 1), Path('bag'))
    assert load_yaml(' ' * 2**24, Path('bag')) is None


def test_a_bag_lasts_from_its_first_message_to_its_last_in_whatever_file() -> None:
    files = (FileInfo('a', 100, 50, 1), FileInfo('b', 120, 10, 2), FileInfo('c'))
    data = Metadata(files=files).to_dict()
    assert data['starting_time'] == {'nanoseconds_since_epoch': 100}
    assert data['duration'] == {'nanoseconds': 50}
    assert data['message_count'] == 3


TEXT = st.text() | st.text('-:#[]{},&*!|>%@`?~ \n\t"\\0123456789.eE_xyno')
PLAIN = st.recursive(
    TEXT | st.integers() | st.booleans() | st.none(),
    lambda inner: st.lists(inner) | st.dictionaries(TEXT, inner),
    max_leaves=8,
)


@settings(max_examples=150, deadline=None)
@for_all(PLAIN)
def test_yaml_says_the_same_to_others(data: object) -> None:
    assert yaml.safe_load(dump_yaml(data)) == data


def test_metadata_with_anchors_is_read_as_rosbag2_reads_it() -> None:
    text = DOCUMENT.replace('deadline:', 'deadline: &never').replace(
        'lifespan:\n              sec: 9223372036\n              nsec: 854775807',
        'lifespan: *never',
    )
    assert '*never' in text
    assert Metadata.from_yaml(text, Path('bag')) == TWO_FILES


def test_aliases_cannot_make_a_text_endless() -> None:
    rows = ['- &a0 [x, x]'] + [f'- &a{k} [*a{k - 1}, *a{k - 1}]' for k in range(1, 29)]
    bomb = '\n    '.join(['', *rows])
    text = DOCUMENT.replace('  version: 9', f'  bomb:{bomb}\n  version: 9')
    with pytest.raises(BagError, match='a list: expected text'):
        Metadata.from_yaml(text.replace('key: "9"', 'key: *a28'), Path('bag'))


def test_text_that_yaml_would_take_for_something_else_stays_text() -> None:
    data = {
        'a': '9',
        'b': 'yes',
        'c': '~',
        'd': 'x: y',
        'e': '{"k": [1]}',
        'f': 'Schäfer\n',
        'g': '',
    }
    assert yaml.safe_load(dump_yaml(data)) == data
    metadata = Metadata(files=(FileInfo('b_0.mcap'),), custom_data=data)
    assert Metadata.from_yaml(metadata.document(), Path('bag')).custom_data == data


@pytest.mark.parametrize(
    ('text', 'what'),
    [
        ('{', 'no YAML'),
        ('- 1', 'cannot be read'),
        ('', 'cannot be read'),
        ('a: 2024-99-99', 'no YAML'),
        ('rosbag2_bagfile_information: 3', 'cannot be read'),
        (DOCUMENT.replace('message_count: 3', 'message_count: three'), 'cannot be read'),
        (DOCUMENT.replace('reliable', 'mostly'), 'quality of service'),
        (DOCUMENT.replace('relative_file_paths', 'paths').replace('files:', 'f:'), 'cannot be'),
        ('[' * 100_000, 'no YAML'),
        ('- ' * 100_000, 'no YAML'),
        ('a: &a [1]\nb: *a', 'cannot be read'),
        (DOCUMENT.replace('mcap', '[]', 1), 'a list: expected text'),
    ],
)
def test_broken_metadata_is_refused_in_words(text: str, what: str) -> None:
    with pytest.raises(BagError, match=what):
        Metadata.from_yaml(text, Path('metadata.yaml'))
