"""Verb demo: a whole stack of processes herds one flock, is watched and drawn."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
import os
from pathlib import Path
import time
from typing import Any, TYPE_CHECKING

from rich.console import Console
from rich.table import Table
from shepherd_ros.bringup import Process, stack_in
from shepherd_ros.cli.out_folders import claimed_folder
from shepherd_ros.cli.processes import isolate, Running, running
from shepherd_ros.cli.progress import progress
from shepherd_ros.cli.user_error import UserError
from shepherd_ros.experiments.setting_arguments import OneSetting

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray
    from shepherd_ros.experiments.setting import Setting
    from shepherd_ros.nodes.episode_probe import EpisodeProbe
    from shepherd_ros.sim.state import WorldState

DEMO_TIMEOUT = 60.0  # [s] wall time without any news before giving up


def progress_text(task: str, metrics: dict[str, float]) -> str:
    """Return what the progress of a demo says of this moment, '' until all of it is heard."""
    from shepherd_ros.sim.tasks import TASKS

    try:
        return TASKS[task].progress.format_map(metrics)
    except KeyError:
        return ''


@dataclass(kw_only=True)
class Demo(OneSetting):
    """Herd a flock over ROS 2 topics with separate processes; draw what happened."""

    controller: str = 'policy'
    """Controller that commands, or policy:CHECKPOINT; a wrong name shows all of them."""
    mux: bool = False
    """Let one of several sources command each shepherd: the controller, keys, a joystick."""
    standby: tuple[str, ...] = ()
    """With mux: other controllers to switch to."""
    seed: int = 0
    """Seed of the episode."""
    out: Path = Path('out/demo')
    """Folder for picture, animation and logs."""
    animation: str = 'gif'
    """Form of the animation: gif, mp4 or none."""
    overwrite: bool = False
    """Write into a folder that holds something else."""

    def run(self) -> int:
        """Run the demo; return the exit code."""
        setting = self._check()
        stack = stack_in(
            setting,
            self.controller,
            mux=self.mux,
            standby=self.standby,
            seed=self.seed,
            episodes=1,
            wait_for_scans=True,
        )
        claimed_folder('--out', self.out, 'logs/*.log', self.overwrite)
        isolate(os.environ)
        console = Console()
        console.print(
            f'{setting.sheep} sheep, {setting.shepherds} shepherds, {self.controller} on a '
            f'{setting.flock} flock, seed {self.seed}; ROS_DOMAIN_ID={os.environ["ROS_DOMAIN_ID"]}'
        )
        for note in self._notes(setting):
            console.print(note, highlight=False)
        # rclpy reads the environment when it is imported
        from shepherd_ros.nodes.episode_probe import open_episode_probe

        with (
            running(self.out / 'logs') as processes,
            open_episode_probe(task=setting.task) as (probe, spin),
        ):
            self._follow(stack, setting, processes, probe, spin)
        times, states = probe.trajectory()
        console.print(self._table(states, setting))
        self._draw(setting, probe, times, states, console)
        return 0

    def _check(self) -> Setting:
        """Return the setting; refuse what no process could do, before any is started."""
        from shepherd_ros.experiments.setting import canonical_setting

        if self.animation not in ('gif', 'mp4', 'none'):
            raise UserError(f'--animation is {self.animation!r}: expected gif, mp4 or none')
        return canonical_setting(self.setting)

    def _notes(self, setting: Setting) -> list[str]:
        """Return a note on each policy whose intervals are no multiples of the time step."""
        from shepherd_ros.experiments.methods import full_name, timing_note
        from shepherd_ros.experiments.setting import env_config

        dt = env_config(setting).world.dt
        notes = (timing_note(full_name(name), dt) for name in (self.controller, *self.standby))
        return [note for note in notes if note]

    def _follow(
        self,
        stack: list[Process],
        setting: Setting,
        processes: Running,
        probe: EpisodeProbe,
        spin: Callable[[float], None],
    ) -> None:
        """Start everything, the controller last, and follow the episode to its end."""
        steps = setting.steps
        with progress(setting.task, steps) as show:
            show(0, text='(processes start)')
            processes.start(stack[:-1])
            self._until(lambda: probe.is_complete, processes, probe, spin)
            processes.start(stack[-1:])

            def done() -> bool:
                now = progress_text(setting.task, probe.metrics)
                show(max(probe.step, 0), text=f'step {max(probe.step, 0)} of {steps}, {now}')
                return processes.ended('flock_sim')

            self._until(done, processes, probe, spin)
            limit = time.monotonic() + 1.0  # the last words of metrics and lidar
            while time.monotonic() < limit:
                spin(0.1)
            done()
        expected = probe.step + 1 if probe.outcome == 'terminated' else steps + 1
        if len(probe.states) != expected:
            raise UserError(
                f'heard {len(probe.states)} of {expected} states: the machine is too '
                f'busy to follow; the logs are in {processes.logs}'
            )

    @staticmethod
    def _until(
        done: Callable[[], bool],
        processes: Running,
        probe: EpisodeProbe,
        spin: Callable[[float], None],
    ) -> None:
        """Spin until done; raise UserError if a process fails or nothing is heard for long."""
        news, since, checked = -1, time.monotonic(), 0.0
        while True:
            spin(0.1)
            now = time.monotonic()
            if now - checked > 0.1:
                checked = now
                processes.check()
                if done():
                    return
            if probe.step != news:
                news, since = probe.step, now
            elif now - since > DEMO_TIMEOUT:
                raise UserError(
                    f'no news for {DEMO_TIMEOUT:.0f} s at step {news}: the logs are in '
                    f'{processes.logs}'
                )

    @staticmethod
    def _table(states: WorldState, setting: Setting) -> Table:
        """Return the metrics of all states (T) as a table, the most important first."""
        from shepherd_ros.experiments.setting import env_config
        from shepherd_ros.recordings.replay import metrics_over_time
        from shepherd_ros.sim.metrics import shown

        task = env_config(setting).world.task
        curves = metrics_over_time(states, setting.steps, task)
        table = Table(title='Metrics of the episode')
        for column in ('metric', 'value', 'unit', 'meaning'):
            table.add_column(column, justify='right' if column == 'value' else 'left')
        for metric in shown('summary', task.metrics):
            value = f'{curves[metric.name][-1]:.4g}'
            table.add_row(metric.name, value, metric.unit, metric.meaning)
        return table

    def _draw(
        self,
        setting: Setting,
        probe: EpisodeProbe,
        times: NDArray[np.float64],
        states: WorldState,
        console: Console,
    ) -> None:
        """Write picture and animation of the states (T) at times (T,) s."""
        from shepherd_ros.sim.tasks import TASKS
        from shepherd_ros.view.track import EpisodeTrack

        words = TASKS[setting.task].words
        track: Any = EpisodeTrack(
            times=times,
            sheep=states.sheep.numpy(),
            shepherds=states.shepherds.numpy(),
            goal=states.goal.numpy(),
            goal_radius=float(states.goal_radius[0]),
            title=f'{self.controller}, {setting.sheep} {words[0]} ({setting.flock}), '
            f'seed {self.seed}',
            ranges=probe.ranges(),
            lidar_shepherd=probe.shepherd,
            words=words,
        )
        from shepherd_ros.view.animation import animate
        from shepherd_ros.view.picture import draw_tracks

        picture = self.out / 'tracks.png'
        draw_tracks(track, picture)
        console.print(f'wrote {picture}')
        if self.animation != 'none':
            film = self.out / f'{setting.task}.{self.animation}'
            with progress(f'drawing {film}'):
                animate(track, film)
            console.print(f'wrote {film}')
