"""Check that two processes find each other over DDS, and who else is in the domain."""

from __future__ import annotations

from collections.abc import Iterator
from importlib.util import find_spec
import json
import subprocess
import sys
from typing import Any

from shepherd_ros.doctor.diagnosis import Diagnosis, error, ok, warning

WITHOUT_ROS = 'source /opt/ros/jazzy/setup.bash, or pip install "shepherd_ros[jazzy]"'
_SEE_NETWORK = 'see the lines above of discovery range, DDS profile and multicast; try '
_LIMIT = 30.0  # [s] for two processes to start and to find each other
MANY = 5  # nodes that a line names


class Pair:
    """Two processes with a node each, which look for each other while other checks run."""

    def __init__(self) -> None:
        """Start both, unless there is no rclpy."""
        self.processes: list[subprocess.Popen[str]] = []
        if find_spec('rclpy') is None:
            return
        for own, other in (('a', 'b'), ('b', 'a')):
            words = ['-m', 'shepherd_ros.nodes.discovery_probe', own, other]
            self.processes.append(
                subprocess.Popen(
                    [sys.executable, *words],
                    stdout=subprocess.PIPE,
                    stderr=subprocess.PIPE,
                    text=True,
                )
            )

    def close(self) -> None:
        """End what still runs."""
        for process in self.processes:
            if process.poll() is None:
                process.kill()
            process.communicate()

    def answers(self) -> list[dict[str, Any]]:
        """Return what each has found: rmw, distro, domain, seconds and others, or error."""
        return [_answer(process) for process in self.processes]

    def check(self) -> Iterator[Diagnosis]:
        """Yield whether rclpy works, whether nodes find each other, and who else is there."""
        if not self.processes:
            yield warning('rclpy', 'not installed: no nodes, no demo; all else works', WITHOUT_ROS)
            return
        found = self.answers()
        broken = [answer for answer in found if 'error' in answer]
        if broken:
            fix = 'change that setting' if broken[0].get('setting') else WITHOUT_ROS
            yield error('rclpy', broken[0]['error'], fix)
            return
        yield ok('rclpy', f'{found[0]["rmw"]}, ROS_DISTRO {found[0]["distro"] or "not set"}')
        if any(answer['seconds'] is None for answer in found):
            text = 'two processes on this machine do not hear each other'
            fix = f'{_SEE_NETWORK}FASTDDS_BUILTIN_TRANSPORTS=UDPv4'
            yield error('discovery', text, fix)
        else:
            seconds = max(answer['seconds'] for answer in found)
            yield ok('discovery', f'two processes hear each other after {seconds:.1f} s')
        yield _neighbours(found)


def _answer(process: subprocess.Popen[str]) -> dict[str, Any]:
    """Return what a process has printed, or its error."""
    try:
        out, err = process.communicate(timeout=_LIMIT)
        return dict(json.loads(out))
    except subprocess.TimeoutExpired:
        return {'error': f'a node does not start within {_LIMIT:g} s'}
    except ValueError:
        lines = err.strip().splitlines()
        return {'error': lines[-1] if lines else f'exit code {process.returncode}'}


def _neighbours(found: list[dict[str, Any]]) -> Diagnosis:
    """Return who else is in the domain."""
    domain = found[0]['domain']
    others = sorted({name for answer in found for name in answer['others']})
    if not others:
        return ok('neighbours', f'nobody else is in domain {domain}')
    more = f' and {len(others) - MANY} more' if len(others) > MANY else ''
    return warning(
        'neighbours',
        f'in domain {domain} there are {", ".join(others[:MANY])}{more}',
        'if they are not yours, export another ROS_DOMAIN_ID',
    )
