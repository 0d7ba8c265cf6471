"""Checks of shepherd doctor, each where all is well and where one thing is wrong."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import closing
from importlib.metadata import PackageNotFoundError
import json
import os
from pathlib import Path
import socket
import sys

from nodes.process import Graph
import pytest
from shepherd_ros.cli import main
from shepherd_ros.doctor import checks, dds_settings, discovery, installation, machine
from shepherd_ros.doctor.diagnosis import Check, Diagnosis, ok
from shepherd_ros.policy import checkpoint
from shepherd_ros.resources import quick_profile
import torch


def only(check: Check) -> Diagnosis:
    """Return the one finding of a check; it says what to do unless all is well."""
    (finding,) = check()
    assert bool(finding.fix) == (finding.level != 'ok')
    return finding


@pytest.fixture(autouse=True)
def plain(monkeypatch: pytest.MonkeyPatch) -> None:
    """Take away what the environment says of DDS and plug-ins."""
    for name in os.environ:
        if name.startswith(('ROS_', 'FASTDDS_', 'FASTRTPS_', 'SHEPHERD_ROS_')):
            monkeypatch.delenv(name)


@pytest.mark.parametrize('check', checks.INSTALLATION, ids=lambda check: check.__name__)
def test_this_installation_is_sound(check: Check) -> None:
    assert only(check).level == 'ok'


@pytest.mark.parametrize(
    ('now', 'level'), [((3, 10), 'error'), ((3, 11), 'ok'), ((3, 12), 'ok'), ((3, 13), 'warning')]
)
def test_pythons(now: tuple[int, int], level: str, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(sys, 'version_info', (*now, 0, 'final', 0))
    assert only(installation.check_python).level == level


def test_a_package_that_is_missing_is_named(monkeypatch: pytest.MonkeyPatch) -> None:
    known = installation.version

    def version(name: str) -> str:
        if name in ('mcap', 'tyro'):
            raise PackageNotFoundError(name)
        return known(name)

    monkeypatch.setattr(installation, 'version', version)
    finding = only(installation.check_packages)
    assert finding.level == 'error'
    assert finding.fix == 'pip install mcap tyro'


def test_more_threads_than_the_container_has_cores(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    quota = tmp_path / 'cpu.max'
    monkeypatch.setattr(installation, 'CPU_QUOTA', quota)
    monkeypatch.setattr(os, 'sched_getaffinity', lambda pid: set(range(8)))
    monkeypatch.setattr(torch, 'get_num_threads', lambda: 8)
    for text, cores in (('max 100000', 8), ('250000 100000', 2.5), ('50000 100000', 0.5)):
        quota.write_text(text)
        assert installation.cores() == cores
        finding = only(installation.check_torch)
        assert finding.level == ('ok' if cores == 8 else 'warning')
        assert finding.fix in ('', f'export OMP_NUM_THREADS={max(1, int(cores))}')


def test_a_plugin_that_cannot_be_imported(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv('SHEPHERD_ROS_PLUGINS', 'no_such_plugin')
    finding = only(installation.check_plugins)
    assert finding.level == 'error'
    assert "'no_such_plugin'" in finding.text


def test_a_checkpoint_that_is_damaged(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    broken = tmp_path / 'broken.safetensors'
    broken.write_bytes(b'no checkpoint')
    monkeypatch.setattr(checkpoint, 'shipped_checkpoints', lambda: [str(broken)])
    finding = only(installation.check_checkpoints)
    assert finding.level == 'error'
    assert str(broken) in finding.text


@pytest.mark.parametrize(('free', 'level'), [(5e7, 'error'), (1e9, 'warning'), (5e9, 'ok')])
def test_room_on_the_disk(
    free: float, level: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr('shutil.disk_usage', lambda path: type('Usage', (), {'free': free}))
    assert only(machine.check_disk).level == level
    assert not list(tmp_path.iterdir())


def test_logs_go_where_ros_says(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv('ROS_HOME', str(tmp_path / 'home'))
    assert only(machine.check_logs).text == str(tmp_path / 'home' / 'log')
    (tmp_path / 'file').touch()
    monkeypatch.setenv('ROS_LOG_DIR', str(tmp_path / 'file' / 'log'))
    assert only(machine.check_logs).level == 'error'


@pytest.mark.parametrize(
    ('domain', 'level'),
    [
        ('', 'ok'),
        ('100', 'ok'),
        ('101', 'warning'),
        ('215', 'ok'),
        ('233', 'error'),
        ('x', 'error'),
    ],
)
def test_domains(domain: str, level: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    ports = tmp_path / 'ports'
    ports.write_text('32768\t60999\n')  # of Linux: domains 101 to 214 have some of them
    monkeypatch.setattr(dds_settings, 'EPHEMERAL', ports)
    monkeypatch.setenv('ROS_DOMAIN_ID', domain)
    assert only(dds_settings.check_domain).level == level


@pytest.mark.parametrize(
    ('chosen', 'peers', 'level'),
    [
        ('', '', 'ok'),
        ('LOCALHOST', '', 'ok'),
        ('OFF', '', 'error'),
        ('OFF', '10.0.0.2', 'ok'),
        ('EVERYWHERE', '', 'error'),
    ],
)
def test_discovery_ranges(
    chosen: str, peers: str, level: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv('ROS_AUTOMATIC_DISCOVERY_RANGE', chosen)
    monkeypatch.setenv('ROS_STATIC_PEERS', peers)
    assert only(dds_settings.check_discovery_range).level == level


def test_profiles_of_dds(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path = tmp_path / 'profile.xml'
    good = '<profiles xmlns="http://www.eprosima.com/XMLSchemas/fastRTPS_Profiles"/>'
    for name in dds_settings.PROFILES:
        monkeypatch.setenv(name, str(path))
        assert only(dds_settings.check_profile).level == 'error'
        for text, level in ((good, 'ok'), ('<html/>', 'error'), ('{}', 'error')):
            path.write_text(text)
            assert only(dds_settings.check_profile).level == level
        path.unlink()
        monkeypatch.delenv(name)


def test_multicast_that_is_lost(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(dds_settings, 'PATIENCE', 0.01)
    monkeypatch.setattr(socket.socket, 'sendto', lambda *words: 0)
    assert only(dds_settings.check_multicast).level == 'warning'
    monkeypatch.setenv('ROS_AUTOMATIC_DISCOVERY_RANGE', 'LOCALHOST')
    assert only(dds_settings.check_multicast).level == 'ok'


def test_two_processes_hear_each_other_and_see_who_else_is_there(
    graph: Graph, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv('ROS_DOMAIN_ID', str(graph.domain))
    monkeypatch.setenv('ROS_AUTOMATIC_DISCOVERY_RANGE', 'LOCALHOST')
    monkeypatch.setenv('FASTDDS_BUILTIN_TRANSPORTS', 'UDPv4')
    variable, profile = quick_profile()
    monkeypatch.setenv(variable, str(profile))
    with closing(discovery.Pair()) as pair:
        found = {finding.name: finding for finding in pair.check()}
    assert found['rclpy'].text.startswith('rmw_')
    assert found['discovery'].level == 'ok'
    assert found['neighbours'].level == 'warning'
    assert graph.node.get_fully_qualified_name() in found['neighbours'].text
    assert all(process.returncode == 0 for process in pair.processes)


def test_a_setting_that_rclpy_refuses_is_named(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv('ROS_DOMAIN_ID', '999')
    with closing(discovery.Pair()) as pair:
        finding = only(pair.check)
    assert finding.level == 'error'
    assert "ROS_DOMAIN_ID is '999'" in finding.text


def test_without_rclpy_that_is_a_warning(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(discovery, 'find_spec', lambda name: None)
    pair = discovery.Pair()
    assert pair.processes == []
    assert only(pair.check).level == 'warning'


def raising() -> Iterator[Diagnosis]:
    """Fail as no check should."""
    yield ok('first', 'well')
    raise RuntimeError('of all things')


def test_the_page_tells_all_and_the_exit_code_the_worst(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    sound = [
        ('machine', ok('disk', 'room')),
        ('ROS 2', Diagnosis('domain', 'warning', 'odd', 'do')),
    ]
    monkeypatch.setattr(checks, 'run_checks', lambda: iter(sound))
    assert main(['doctor']) == 0
    output = [line.rstrip() for line in capsys.readouterr().out.splitlines()]
    assert output[-1] == '1 ok, 1 warning, 0 errors'
    assert output[-4:-2] == ['warning  domain  odd', ' ' * 17 + '→ do']
    broken = [('installation', finding) for finding in checks.guarded(raising)]
    monkeypatch.setattr(checks, 'run_checks', lambda: iter(broken))
    assert main(['doctor', '--json']) == 1
    (first, second) = json.loads(capsys.readouterr().out)['checks']
    assert first['group'] == 'installation'
    assert (first['name'], first['level'], first['text']) == ('first', 'ok', 'well')
    assert (second['level'], second['text']) == ('error', 'RuntimeError: of all things')
