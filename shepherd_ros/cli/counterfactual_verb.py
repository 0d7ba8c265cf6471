"""Verb counterfactual: a recorded episode, driven on from some moment by another controller."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import count
from pathlib import Path
import shutil
from typing import Annotated

from shepherd_ros.cli.bag_verbs import one_episode
from shepherd_ros.cli.controllers import chosen
from shepherd_ros.cli.out_folders import claimed_folder
from shepherd_ros.cli.progress import progress
from shepherd_ros.cli.user_error import UserError
import tyro

STEPS_BEFORE = 20  # steps of the common past at the beginning of the animation


@dataclass
class Counterfactual:
    """
    Let a controller drive on from a recorded state, and show what was beside what would have been.

    The simulation goes on from that state with the random numbers of its seed and step. If the
    controller is the one that was recorded (with its --params, all it would have commanded until
    then is what was recorded), it keeps what it remembers, and its future is the recorded one.
    Any other controller begins at that state.
    """

    bag: tyro.conf.Positional[Path]
    """Folder of a bag, or one .mcap file."""
    at: float
    """Stamp of the state to go on from [s]; between two states the earlier one is taken."""
    out: Annotated[Path, tyro.conf.arg(aliases=['-o'])]
    """Folder of the new bag, futures.png, futures.gif and metrics.md."""
    controller: str = 'strombom'
    """Controller that drives on; a wrong name shows all of them."""
    params: Annotated[tuple[str, ...], tyro.conf.arg(aliases=['-p'])] = ()
    """Parameters of the controller, such as noise_std:=0.5."""
    params_file: Path | None = None
    """File with parameters of the controller."""
    episode: int = 0
    """Which episode of the bag, counted from 0."""
    namespace: str | None = None
    """Namespace of the stack, if the bag has several."""
    overwrite: bool = False
    """Replace the bag, the pictures and the table that are in the folder."""

    def run(self) -> int:
        """Drive on, write and draw; return the exit code."""
        from shepherd_ros.recordings.counterfactual import metrics_table, record_future
        from shepherd_ros.recordings.episodes import iter_episodes
        from shepherd_ros.recordings.replay import track_of
        from shepherd_ros.rosbag2.metadata import FILE
        from shepherd_ros.rosbag2.reader import open_bag
        from shepherd_ros.sim.world import WorldConfig
        from shepherd_ros.view.animation import animate
        from shepherd_ros.view.picture import draw_tracks

        choice = chosen(self.controller, self.params, self.params_file)
        choice.config()  # refuses what cannot be, before the bag is read
        recorded = one_episode(self.bag, self.namespace, self.episode)
        at = self._step(stamps := [frame.stamp_ns * 1e-9 for frame in recorded.frames])
        controller = choice.make(WorldConfig.from_dict(recorded.world))
        claimed_folder('--out', self.out, '', self.overwrite)
        folder = self.out / 'bag'
        if self.overwrite and (folder / FILE).exists():
            shutil.rmtree(folder)
        driven = count(1)
        with progress('driving on', recorded.episode_steps + 1) as show:
            same = record_future(
                recorded,
                at,
                controller,
                choice.noise_std,
                folder,
                lambda worlds: show(next(driven)),
            )
            (future,) = iter_episodes(open_bag(folder))
            name = f'{self.controller} from {stamps[at]:g} s on'
            table = metrics_table(recorded, future, name)
            (self.out / 'metrics.md').write_text(table, encoding='utf-8')
            was = track_of(recorded, f'{self.bag.name}, as recorded', at)
            would_be = track_of(future, name, at)
            draw_tracks(was, self.out / 'futures.png', beside=[would_be])
        with progress('drawing') as show:
            animate(
                was,
                self.out / 'futures.gif',
                first=max(at - STEPS_BEFORE, 0),
                beside=[would_be],
                on_frame=show,
            )
        past = 'with its memory of the past' if same else 'from there, without any memory'
        print(f'{name}, {past}\n\n{table}')
        for file in ('bag', 'futures.png', 'futures.gif', 'metrics.md'):
            print(f'wrote {self.out / file}')
        return 0

    def _step(self, stamps: list[float]) -> int:
        """Return the index of the stamp [s] to go on from, or raise UserError."""
        if not stamps[0] <= self.at <= stamps[-1]:
            raise UserError(
                f'--at is {self.at}: expected a stamp of the episode, {stamps[0]:g} to '
                f'{stamps[-1]:g} s'
            )
        return max(k for k, stamp in enumerate(stamps) if stamp <= self.at + 1e-9)
