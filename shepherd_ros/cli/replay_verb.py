"""Verb replay: recorded states to a controller, and its commands beside the recorded ones."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
import os
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Annotated, TYPE_CHECKING

from shepherd_ros.cli.controllers import Chosen, chosen
from shepherd_ros.cli.processes import isolate, running
from shepherd_ros.cli.progress import progress, Show
from shepherd_ros.cli.user_error import UserError
from shepherd_ros.resources import executable_path
import tyro

if TYPE_CHECKING:
    from shepherd_ros.recordings.episodes import Frame, RecordedEpisode
    from shepherd_ros.recordings.grouping import RecordedGroup
    from shepherd_ros.recordings.replay_check import Comparison

_EXIT_DIFFERENT = 1  # exit code if a command differs or is missing


@dataclass
class Replay:
    """
    Show a controller the recorded states and compare what it commands; exit code 1 if it differs.

    The controller runs as a node of its own, and gets every state with the bytes and the stamp of
    the recording. It begins with the first state of each episode, as it did then.
    """

    bag: tyro.conf.Positional[Path]
    """Folder of a bag, or one .mcap file."""
    controller: str = 'strombom'
    """Controller to ask, a wrong name shows all of them; or an executable of your own."""
    params: Annotated[tuple[str, ...], tyro.conf.arg(aliases=['-p'])] = ()
    """Parameters of the controller with which it was recorded, such as noise_std:=0.5."""
    params_file: Path | None = None
    """File with parameters of the controller."""
    tolerance: float = 0.0
    """Greatest difference of two velocities that counts as none [m/s]."""
    shepherds: tuple[int, ...] = ()
    """Shepherds to compare, all by default."""
    episode: int | None = None
    """Which episode of the bag, counted from 0; all by default."""
    namespace: str | None = None
    """Namespace of the stack, if the bag has several."""
    without_ros: bool = False
    """Ask the law itself, without ROS."""

    def run(self) -> int:
        """Compare all and print the result; return the exit code."""
        from shepherd_ros.recordings.replay_check import Comparison

        if not 0 <= self.tolerance < float('inf'):
            raise UserError(f'--tolerance is {self.tolerance}: expected 0 or more [m/s]')
        choice = chosen(self.controller, self.params, self.params_file)
        if choice.parameters.get('stamped') is False:
            raise UserError('stamped is False: expected commands with the stamp of their state')
        if self.without_ros or choice.of_core or executable_path(self.controller) is None:
            choice.config()  # refuses what cannot be
        result = Comparison(self.tolerance, self.shepherds)
        with progress('comparing') as show:
            if self.without_ros:
                self._ask_law(choice, result, show)
            else:
                self._ask_node(choice, result, show)
        print(f'{self.controller} on {self.bag}')
        print(result.text())
        return 0 if result.ok else _EXIT_DIFFERENT

    def _episodes(
        self, result: Comparison
    ) -> Iterator[tuple[RecordedEpisode, list[Frame], RecordedGroup]]:
        """Yield the episodes to compare with the states to ask about."""
        from shepherd_ros.recordings.episodes import episode_of, one_namespace
        from shepherd_ros.recordings.grouping import RecordedGroups
        from shepherd_ros.recordings.replay_check import frames_to_check
        from shepherd_ros.rosbag2.reader import open_bag

        bag = open_bag(self.bag)
        space = one_namespace(bag, self.namespace)
        number = -1
        for number, group in enumerate(RecordedGroups(bag, space, keep=not self.without_ros)):
            if self.episode not in (None, number):
                continue
            episode = episode_of(bag, group)
            strangers = [h for h in self.shepherds if not 0 <= h < episode.n_shepherds]
            if strangers:
                raise UserError(
                    f'--shepherds has {strangers}: expected 0 to {episode.n_shepherds - 1}'
                )
            frames = frames_to_check(episode)
            result.add_episode(episode, frames)
            if frames:
                yield episode, frames, group
        if self.episode is not None and not 0 <= self.episode <= number:
            raise UserError(
                f'--episode is {self.episode}: expected 0 to {number}, as '
                f'`shepherd bag info {self.bag}` lists them'
            )

    def _ask_law(self, choice: Chosen, result: Comparison, show: Show) -> None:
        """Compare the commands of the control law, called without ROS."""
        from shepherd_ros.recordings.replay import states_of
        from shepherd_ros.recordings.replay_check import law_commands
        from shepherd_ros.sim.world import WorldConfig

        for episode, frames, _ in self._episodes(result):
            controller = choice.make(WorldConfig.from_dict(episode.world))
            answers = law_commands(states_of(episode, frames), controller, choice.noise_std)
            for frame, (_, command) in zip(frames, answers, strict=True):
                result.add(episode, frame, dict(enumerate(command.double().numpy())))
                show(result.compared, text='commands')

    def _ask_node(self, choice: Chosen, result: Comparison, show: Show) -> None:
        """Compare the commands of the controller as a node."""
        isolate(os.environ)
        try:  # now, as rclpy reads the environment when it is imported
            from shepherd_ros.nodes.controller_probe import open_controller_probe
        except ModuleNotFoundError as error:
            raise UserError(f'{error}: install ROS 2, or use --without-ros') from None

        with (
            TemporaryDirectory() as logs,
            running(Path(logs)) as processes,
            open_controller_probe() as probe,
        ):
            silent: set[int] = set()
            for episode, frames, group in self._episodes(result):
                if not processes.started:
                    own = {'frame_id': episode.frame_id, 'shepherd_ids': self._team()}
                    processes.start([choice.process(own)])
                probe.begin(episode)
                for frame in frames:
                    wanted = set(self.shepherds or range(episode.n_shepherds)) - silent
                    over = all(command is None for command in frame.commands)
                    answers = {}
                    if wanted and not (over and frame is frames[-1]):
                        raw = group.states[frame.step].raw
                        answers = probe.request_commands(frame, raw, wanted, processes.check)
                        silent |= wanted - answers.keys()  # not waited for again
                    result.add(episode, frame, answers)
                    show(result.compared, text='commands')

    def _team(self) -> list[int]:
        """Return the shepherds that the node shall command."""
        from shepherd_ros.recordings.episodes import one_namespace
        from shepherd_ros.recordings.grouping import announced_episodes
        from shepherd_ros.rosbag2.reader import open_bag

        bag = open_bag(self.bag)
        infos = announced_episodes(bag, one_namespace(bag, self.namespace))
        most = max(info.n_shepherds for _, info in infos)
        return sorted(self.shepherds) or list(range(most))
