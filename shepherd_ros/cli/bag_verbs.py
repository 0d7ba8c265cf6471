"""Verbs bag info, check, recover, export, diff and render: bags without ROS."""

from __future__ import annotations

from dataclasses import dataclass
import json
from pathlib import Path
from typing import Annotated, Literal, TYPE_CHECKING

from shepherd_ros.arguments import verb_group
from shepherd_ros.cli.out_folders import claimed_folder
from shepherd_ros.cli.progress import progress, reading
from shepherd_ros.cli.user_error import UserError
import tyro

if TYPE_CHECKING:
    from shepherd_ros.recordings.bag_list import BagList
    from shepherd_ros.recordings.episodes import RecordedEpisode
    from shepherd_ros.recordings.info import BagInfo

Bags = tyro.conf.Positional[Path]
_EXIT_DIFFERENT = 1  # exit code of check, diff and recover when something was found


@dataclass
class _Info:
    """Show what is in a bag: files, topics, episodes and their metrics; list a folder of bags."""

    bag: Bags
    """Folder of a bag, one .mcap, .db3 or .bag file, or a folder of bags."""
    metrics: bool = True
    """Count the metrics of each episode from its poses."""
    json: bool = False
    """Print JSON: times in ns, sizes in bytes."""

    def run(self) -> int:
        """Print the content; return 1 if a bag of a folder cannot be read, else 0."""
        from shepherd_ros.recordings.info import bag_info
        from shepherd_ros.rosbag2.reader import bags_in, open_bag

        bags = bags_in(self.bag)
        if bags and bags != [self.bag]:
            return self._list(bags)
        bag = open_bag(self.bag)
        with reading(bag):
            found = bag_info(bag, self.metrics)
        print(self._shown(found))
        return 0

    def _shown(self, found: BagInfo | BagList) -> str:
        return json.dumps(found.content(), indent=1) if self.json else found.text()

    def _list(self, bags: list[Path]) -> int:
        """Print a line for each bag, and totals."""
        from shepherd_ros.recordings.bag_list import list_bags

        with progress('reading', len(bags)) as show:
            found = list_bags(bags, self.metrics, lambda done, bag: show(done, text=bag.path.name))
        print(self._shown(found))
        return _EXIT_DIFFERENT if found.unreadable else 0


@dataclass
class _Check:
    """Check that every step of every episode is there; exit code 1 if not."""

    bag: Bags
    """Folder of a bag, or one .mcap file."""
    require: tuple[Literal['scans', 'commands'], ...] = ()
    """Parts that must have been recorded."""

    def run(self) -> int:
        """Print what is missing, the first gap first; return the exit code."""
        from shepherd_ros.recordings.check import check_bag
        from shepherd_ros.rosbag2.reader import open_bag

        bag = open_bag(self.bag)
        with reading(bag):
            result = check_bag(bag, self.require)
        print(result.text())
        return 0 if result.ok else _EXIT_DIFFERENT


@dataclass
class _Recover:
    """Rewrite what can be read of a damaged bag; exit code 1 if something of it is not kept."""

    bag: Bags
    """Folder of a bag, or one .mcap file; it is not touched."""
    output: Annotated[Path | None, tyro.conf.arg(aliases=['-o'])] = None
    """New folder; by default beside the bag, with _recovered at its end."""
    compression: Literal['none', 'zstd', 'lz4'] = 'none'
    """Compression of the new bag."""

    def run(self) -> int:
        """Write the new bag, print what was kept and lost; return the exit code."""
        from shepherd_ros.recordings.recording_writer import recover_recording

        with progress('recovering') as show:
            result = recover_recording(
                self.bag,
                self.output,
                compression=self.compression,
                on_progress=lambda messages: show(messages, text=f'{messages} messages'),
            )
        print(result.text())
        return 0 if result.whole else _EXIT_DIFFERENT


@dataclass
class _Export:
    """Write episodes, states, scans and commands as tables."""

    bag: Bags
    """Folder of a bag, or one .mcap file."""
    output: Annotated[Path, tyro.conf.arg(aliases=['-o'])]
    """Folder of the tables."""
    format: Literal['parquet', 'csv'] = 'parquet'
    """Format of the tables."""
    namespace: str | None = None
    """Namespace of the stack, if the bag has several."""

    def run(self) -> int:
        """Write the tables and print their names; return the exit code."""
        from shepherd_ros.recordings.export import export_bag
        from shepherd_ros.rosbag2.reader import open_bag

        bag = open_bag(self.bag)
        with reading(bag):
            tables = export_bag(bag, self.output, self.format, self.namespace)
        for table in tables.values():
            print(f'{table.path}: {table.rows} rows')
        return 0


@dataclass
class _Diff:
    """Compare the decoded content of two bags; exit code 1 if they differ."""

    left: Bags
    """Folder of a bag, or one .mcap file."""
    right: Bags
    """The other bag."""
    times: bool = False
    """Also compare the times of recording."""
    once: bool = False
    """Count a message that is exactly the one before it on its topic once. flock_sim shows a state
    again while it waits for answers, so two runs with one seed may differ in such repeats."""

    def run(self) -> int:
        """Print a line for each topic; return the exit code."""
        from shepherd_ros.rosbag2.diff import diff_bags
        from shepherd_ros.rosbag2.reader import open_bag

        left, right = open_bag(self.left), open_bag(self.right)
        with reading(left):  # both are read side by side
            result = diff_bags(left, right, times=self.times, once=self.once)
        print(result.text())
        return 0 if result.equal else _EXIT_DIFFERENT


def one_episode(bag: Path, namespace: str | None, number: int) -> RecordedEpisode:
    """Return an episode of a bag, counted from 0, that has states; raises UserError."""
    from itertools import islice

    from shepherd_ros.recordings.episodes import iter_episodes
    from shepherd_ros.rosbag2.reader import open_bag

    episodes = iter_episodes(open_bag(bag), namespace)
    episode = next(islice(episodes, max(number, 0), None), None)
    if episode is None or not episode.frames:
        raise UserError(
            f'--episode is {number}: expected an episode with states, counted from 0, as '
            f'`shepherd bag info {bag}` lists them'
        )
    return episode


@dataclass
class _Render:
    """Draw an episode of a bag: a picture, an animation and a page that replays it."""

    bag: Bags
    """Folder of a bag, or one .mcap file."""
    output: Annotated[Path, tyro.conf.arg(aliases=['-o'])]
    """Folder of tracks.png, replay.html and an animation with the task's name, as herding.gif."""
    episode: int = 0
    """Which episode of the bag, counted from 0."""
    namespace: str | None = None
    """Namespace of the stack, if the bag has several."""
    end: float | None = None
    """Time at which the animation ends [s]; that of the episode by default."""
    speed: float | None = None
    """Seconds of the episode in a second of the animation; all in 10 s by default."""
    title: str = ''
    """Title of picture, animation and page; the bag, its episode and seed by default."""
    overwrite: bool = False
    """Write into a folder that holds something else."""

    def run(self) -> int:
        """Draw and print the files written; return the exit code."""
        from shepherd_ros.recordings.replay import (
            metrics_over_time,
            ranges_of,
            states_of,
            task_of,
            track_of,
        )
        from shepherd_ros.sim.metrics import shown
        from shepherd_ros.view.animation import animate
        from shepherd_ros.view.page import write_page
        from shepherd_ros.view.picture import draw_tracks

        episode = one_episode(self.bag, self.namespace, self.episode)
        claimed_folder('--output', self.output, 'replay.html', self.overwrite)
        name = f'{self.bag.name}, episode {episode.number}, seed {episode.seed}'
        track = track_of(episode, self.title or name)
        task = task_of(episode)
        curves = metrics_over_time(states_of(episode), episode.episode_steps, task)
        on_page = shown('page', task.metrics)
        drawn = {metric.name: curves[metric.name] for metric in on_page}
        units = {metric.name: metric.unit for metric in on_page if metric.unit != '1'}
        paths = [self.output / name for name in ('tracks.png', f'{task.name}.gif', 'replay.html')]
        draw_tracks(track, paths[0])
        with progress('drawing') as show:
            animate(track, paths[1], end=self.end, speed=self.speed, on_frame=show)
        write_page(track, drawn, paths[2], units=units, ranges=ranges_of(episode))
        for path in paths:
            print(f'wrote {path}')
        return 0


BagVerbs = verb_group(
    'Look at bags, check, recover, export and compare them.',
    info=_Info,
    check=_Check,
    recover=_Recover,
    export=_Export,
    diff=_Diff,
    render=_Render,
)
