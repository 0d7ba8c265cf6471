"""Verbs dataset info and build: what can be learned from bags, and the same as Parquet."""

from __future__ import annotations

from dataclasses import dataclass
import json
from pathlib import Path
from typing import Annotated, TYPE_CHECKING

from shepherd_ros.arguments import verb_group
from shepherd_ros.cli.progress import progress
from shepherd_ros.cli.user_error import UserError
import tyro

if TYPE_CHECKING:
    from shepherd_ros.sim.observation import ObservationConfig

Places = tyro.conf.Positional[tuple[Path, ...]]


@dataclass
class _Common:
    """Options of both verbs."""

    places: Places
    """Bags, folders of bags, or data sets that were built."""
    labels: str = ''
    """Namespace of the commands to learn, such as teacher; empty: those that were driven."""
    drivers: str = ''
    """Sources of mux whose steps are examples, such as keys or keys,joy; empty: all."""
    n_frames: int = 3
    """Frames that are seen together, for counting examples."""
    frame_interval: float = 2.0
    """Seconds from one frame to the next, for counting examples."""
    json: bool = False
    """Print JSON."""

    def frames(self) -> ObservationConfig:
        """Return which frames an example shows; raises ConfigError."""
        from shepherd_ros.sim.observation import ObservationConfig

        if not self.places:
            raise UserError('no bags are given: expected bags or folders of bags, as arguments')
        return ObservationConfig(n_frames=self.n_frames, frame_interval=self.frame_interval)


@dataclass
class _Info(_Common):
    """Print what can be learned from bags: examples, dropped steps with reasons, statistics."""

    def run(self) -> int:
        """Print the statistics; return the exit code."""
        from shepherd_ros.datasets.examples import count_examples, driver_names

        options = self.frames(), self.labels, driver_names(self.drivers)
        with progress('reading') as show:
            report = count_examples(self.places, *options, show)
        print(json.dumps(report.to_dict(), indent=1) if self.json else report.text())
        return 0


@dataclass(kw_only=True)
class _Build(_Common):
    """Write the steps of bags as Parquet, with the folders and columns of LeRobot."""

    out: Annotated[Path, tyro.conf.arg(aliases=['-o'])]
    """New folder."""

    def run(self) -> int:
        """Write the files and print their statistics; return the exit code."""
        from shepherd_ros.datasets.examples import build_dataset, driver_names

        options = self.frames(), self.labels, driver_names(self.drivers)
        with progress('reading') as show:
            report = build_dataset(self.places, self.out, *options, show)
        print(json.dumps(report.to_dict(), indent=1) if self.json else report.text())
        if not self.json:
            print(f'\nwrote {self.out}')
        return 0


DatasetVerbs = verb_group(
    'Look at what can be learned from bags, and export it.',
    info=_Info,
    build=_Build,
)
