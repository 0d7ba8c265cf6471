"""All checks of an installation in their order."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import closing

from shepherd_ros.doctor import dds_settings, installation, machine
from shepherd_ros.doctor.diagnosis import Check, Diagnosis, error
from shepherd_ros.doctor.discovery import Pair

INSTALLATION: tuple[Check, ...] = (
    installation.check_python,
    installation.check_packages,
    installation.check_commands,
    installation.check_torch,
    installation.check_numba,
    installation.check_ffmpeg,
    installation.check_plugins,
    installation.check_checkpoints,
)
NETWORK: tuple[Check, ...] = (
    dds_settings.check_domain,
    dds_settings.check_discovery_range,
    dds_settings.check_profile,
    dds_settings.check_multicast,
    machine.check_shared_memory,
)
MACHINE: tuple[Check, ...] = (machine.check_disk, machine.check_logs)


def run_checks() -> Iterator[tuple[str, Diagnosis]]:
    """Yield the title of a group and a finding, one after another."""
    with closing(Pair()) as pair:
        groups: dict[str, tuple[Check, ...]] = {
            'installation': INSTALLATION,
            'machine': MACHINE,
            'ROS 2': (*NETWORK, pair.check),
        }
        for title, checks in groups.items():
            for check in checks:
                for finding in guarded(check):
                    yield title, finding


def guarded(check: Check) -> Iterator[Diagnosis]:
    """Yield the findings of a check; an exception that it does not expect is an error."""
    try:
        yield from check()
    except Exception as fault:
        name = check.__name__.removeprefix('check_').replace('_', ' ')
        text = f'{type(fault).__name__}: {" ".join(str(fault).split())[:200]}'
        yield error(name, text, 'install the package again')
