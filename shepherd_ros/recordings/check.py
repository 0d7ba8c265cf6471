"""Check that a recording is complete and made by this project."""

from __future__ import annotations

from collections.abc import Collection, Iterator
from dataclasses import dataclass
import json

from shepherd_ros.config import unknown_name
from shepherd_ros.recordings.findings import CheckResult, Finding, MAX_FINDINGS
from shepherd_ros.recordings.grouping import (
    namespaces,
    RecordedGroup,
    RecordedGroups,
    RecordedState,
    SCANS,
)
from shepherd_ros.recordings.recording_writer import CONTRACT_KEY, LOST_KEY, TOPICS_KEY
from shepherd_ros.rosbag2.bag import Bag
from shepherd_ros.rosbag2.errors import BagError
from shepherd_ros.sim.lidar_layout import sorted_channels
from shepherd_ros.wire.contract import (
    contract_hash,
    FIRST_CONTRACT_HASH,
    known,
    known_text,
    topic_hashes,
)
from shepherd_ros.wire.episode import Episode
from shepherd_ros.wire.topics import COMMANDS, GOAL_POSES, SHEEP_POSES, SHEPHERD, SHEPHERD_POSES

PARTS = ('scans', 'commands')


def check_bag(bag: Bag, require: Collection[str] = ()) -> CheckResult:
    """
    Return the findings on a bag, damage included.

    require names parts, scans or commands, that must have been recorded.
    """
    for name in require:
        if name not in PARTS:
            raise unknown_name('require', name, PARTS)
    result = CheckResult()
    result.add(*_identity(bag))
    spaces = namespaces(bag)
    if not spaces:
        result.add(Finding('absent', 'no episode was recorded'))
    try:
        for namespace in spaces:
            _check_namespace(bag, namespace, require, result)
    except BagError as error:
        result.add(Finding('damage', error.reason))
    return result


def _identity(bag: Bag) -> Iterator[Finding]:
    """Yield findings on types, schemas, contract and metadata of a bag."""
    for topic in bag.topics.values():
        entry = known(topic.name)
        if entry is None:
            continue
        if topic.type not in entry.types:
            expected = ' or '.join(entry.types)
            yield Finding('type', f'{topic.type!r}, expected {expected}', topic=topic.name)
        elif bag.definitions[topic.name] != {(topic.type, 'ros2msg', known_text(topic.type))}:
            yield Finding('schema', f'the text of {topic.type} is not ours', topic=topic.name)
    yield from _contract(bag)
    yield from _lost(bag.custom_data.get(LOST_KEY, '{}'))
    if bag.metadata_count not in (None, bag.count):
        yield Finding(
            'metadata', f'{bag.metadata_count} messages are noted, {bag.count} are there'
        )


def _contract(bag: Bag) -> Iterator[Finding]:
    """Yield findings on topics whose contract was another one when the bag was recorded."""
    text, recorded_hash = bag.custom_data.get(TOPICS_KEY), bag.custom_data.get(CONTRACT_KEY)
    if text is None:  # of before topics had hashes of their own
        if recorded_hash not in (None, FIRST_CONTRACT_HASH, contract_hash()):
            expected_hash = f'{contract_hash()!r:.9}'
            yield Finding(
                'contract', f'{CONTRACT_KEY} is {recorded_hash!r:.20}, ours {expected_hash}'
            )
        return
    try:
        hashes = dict(json.loads(text))
    except (TypeError, ValueError, RecursionError):
        yield Finding('metadata', f'{TOPICS_KEY} is {text!r:.40}, expected hashes by topic')
        return
    for name in bag.topics:
        entry = known(name)
        expected_hash = '' if entry is None else topic_hashes()[entry.row]
        if entry is not None and hashes.get(entry.row, expected_hash) != expected_hash:
            yield Finding('contract', 'it had another meaning when it was recorded', topic=name)


def _lost(text: str) -> Iterator[Finding]:
    """Yield findings on messages that the recorder reports lost."""
    try:
        for topic, count in json.loads(text).items():
            message = f'{int(count)} messages did not reach the recorder'
            yield Finding('lost', message, topic=str(topic))
    except (AttributeError, TypeError, ValueError, RecursionError):
        yield Finding('metadata', f'{LOST_KEY} is {text!r:.40}, expected numbers by topic')


def _check_namespace(
    bag: Bag, namespace: str, require: Collection[str], result: CheckResult
) -> None:
    groups = RecordedGroups(bag, namespace)
    recorded = [entry for name, entry in groups.topics.items() if bag.topics[name].count]
    channels: dict[int, list[str]] = {}
    for entry in recorded:
        if entry.topic.name.startswith(SCANS) and entry.shepherd is not None:
            channels.setdefault(entry.shepherd, []).append(entry.topic.name.removeprefix(SCANS))
    scanned = {h: sorted_channels(names) for h, names in channels.items()}
    commanded = any(entry.topic.name == COMMANDS for entry in recorded)
    for part, recorded_part in (('scans', bool(scanned)), ('commands', commanded)):
        if not recorded_part:
            result.absent.append(f'{namespace} {part}'.strip())
            if part in require:
                result.add(Finding('absent', f'no {part} were recorded', topic=namespace))
    before: RecordedGroup | None = None
    begin = 0
    expected = _Expected(namespace, scanned, commanded)
    for group in groups:
        if before is None:
            begin = _first_whole(group, expected)
        else:
            _check_group(before, group, expected, result, begin)
            begin = 0
        before = group
    if before is not None:
        _check_group(before, None, expected, result, begin)
    for topic, count in groups.stray.items():
        result.add(Finding('stray', f'{count} messages belong to no episode', topic=topic))


@dataclass(frozen=True)
class _Expected:
    """Topics that every state of a namespace has to have."""

    namespace: str
    scanned: dict[int, tuple[str, ...]]  # channels of shepherds with a lidar
    commanded: bool

    def missing(self, state: RecordedState, info: Episode, answered: bool) -> Iterator[str]:
        """Yield the topics that a state lacks; answered: commands count too."""
        if state.sheep is None:
            yield f'{self.namespace}/{SHEEP_POSES}'
        if state.shepherds is None:
            yield f'{self.namespace}/{SHEPHERD_POSES}'
        if state.goal is None and info.goal_moves:
            yield f'{self.namespace}/{GOAL_POSES}'
        for h in range(info.n_shepherds):
            for channel in self.scanned.get(h, ()):
                if (h, channel) not in state.scans:
                    yield f'{self.namespace}/{SCANS.format(h=h)}{channel}'
        for h in range(info.n_shepherds if self.commanded and answered else 0):
            if h not in state.commands:
                yield f'{self.namespace}/{COMMANDS.format(h=h)}'


def _first_whole(group: RecordedGroup, expected: _Expected) -> int:
    """Return the first step to check: of a recorder that joined late, that of a whole state."""
    steps = () if 0 in group.states else range(group.last_step + 1)
    for step in steps:
        state = group.states.get(step, RecordedState())
        if not any(expected.missing(state, group.info, step < group.last_step)):
            return step
    return 0


def _check_group(
    group: RecordedGroup,
    following: RecordedGroup | None,
    expected: _Expected,
    result: CheckResult,
    begin: int,
) -> None:
    """Check one episode from a step on; following is the next one, None after the last."""
    info, last = group.info, group.last_step
    result.episodes += 1
    result.steps += sum(1 for s in group.states.values() if s.sheep and s.shepherds)
    final = group.states.get(last, RecordedState())
    complete = last == info.episode_steps or info.end == 'terminated'
    if following is None:  # the recording may have ended within a state
        complete = complete and not any(expected.missing(final, info, answered=False))
    # a world that was told to begin anew goes on with the next stamp
    regular = (
        following is None or following.info.start_ns == info.start_ns + (last + 1) * info.dt_ns
    )
    if not complete:
        result.unfinished.append(info.number)
    if begin:
        result.late[info.number] = begin
    for topic, stamp_ns in group.disorder:
        step = (stamp_ns - info.start_ns) // info.dt_ns
        message = 'it came after a later stamp'
        result.add(Finding('order', message, info.number, step, stamp_ns, topic))
    for topic, stamp_ns in group.astray:
        message = 'the stamp is that of no state'
        result.add(Finding('stray', message, info.number, None, stamp_ns, topic))
    if not group.goals and last >= 0:
        result.add(Finding('gap', 'no goal was recorded', info.number))
    for step in range(last + 1 if complete or regular else info.episode_steps + 1):
        state = group.states.get(step, RecordedState())
        stamp_ns = info.start_ns + step * info.dt_ns
        place = info.number, step, stamp_ns
        if step >= begin and (step < last or complete or not regular):
            for topic in expected.missing(state, info, step < last):
                result.add(Finding('gap', 'missing', *place, topic))
        result.add(*_counts(group, state, place))
        if len(result.findings) == MAX_FINDINGS:
            return


def _counts(
    group: RecordedGroup, state: RecordedState, place: tuple[int, int, int]
) -> Iterator[Finding]:
    """Yield findings on the sizes of the arrays of a state."""
    info = group.info
    for poses, name, count in (
        (state.sheep, SHEEP_POSES, info.n_sheep),
        (state.shepherds, SHEPHERD_POSES, info.n_shepherds),
    ):
        if poses is not None and len(poses.xy) != count:
            yield Finding('count', f'{len(poses.xy)} poses, expected {count}', *place, name)
    for h in range(info.n_shepherds):
        sizes = {len(state.scans.get((h, c), ())) for c in group.channels} - {0}
        if len(sizes) > 1:
            message = f'channels of {sorted(sizes)} rays'
            yield Finding('count', message, *place, f'{SHEPHERD.format(h=h)}/scan')
