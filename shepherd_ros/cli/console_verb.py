"""Verb console: a whole stack of processes with a page that shows and drives it."""

from __future__ import annotations

from dataclasses import dataclass
import os
from pathlib import Path
import re
import signal
from tempfile import TemporaryDirectory
import time
from typing import Any

from shepherd_ros.bringup import stack_in, with_console
from shepherd_ros.cli.processes import isolate, Running, running
from shepherd_ros.experiments.setting_arguments import OneSetting

_LOOK_PERIOD = 0.2  # [s] between two looks at processes


@dataclass(kw_only=True)
class LiveConsole(OneSetting):
    """Herd a flock over ROS 2 topics with separate processes; show and drive it in a browser."""

    controller: str = 'policy'
    """Controller that commands, or policy:CHECKPOINT; a wrong name shows all of them."""
    standby: tuple[str, ...] = ('strombom',)
    """Other controllers to switch to."""
    seed: int = 0
    """Seed of the first episode."""
    rate: float = 20.0
    """Steps per second of wall time at most; 0: as many as can be made."""
    host: str = '127.0.0.1'
    """Address to listen on; 0.0.0.0: all, and then the page needs a token."""
    port: int = 8080
    """Port to listen on; 0: any that is free."""
    record_dir: Path = Path('bags')
    """Folder of the bags."""

    def run(self) -> int:
        """Run everything until a stop signal; return the exit code."""
        standby = [word for word in self.standby if word != self.controller]
        stack = stack_in(
            self.setting, self.controller, mux=True, standby=standby, seed=self.seed,
            rate=self.rate,
        )  # fmt: skip
        stack = with_console(
            stack, host=self.host, port=self.port, record_dir=str(self.record_dir.absolute())
        )
        isolate(os.environ)
        signal.signal(signal.SIGTERM, _interrupt)
        with TemporaryDirectory(prefix='shepherd_console_') as logs, running(Path(logs)) as all_of:
            all_of.start(stack)
            try:
                self._follow(all_of)
            except KeyboardInterrupt:
                print('stopping', flush=True)
        return 0

    @staticmethod
    def _follow(processes: Running) -> None:
        """Print the address of the page once it is known; return when flock_sim has ended."""
        shown = False
        while not processes.ended('flock_sim'):
            processes.check()
            if not shown:
                log = (processes.logs / 'console.log').read_text(errors='replace')
                if found := re.search(r'open (http\S+)', log):
                    shown = True
                    domain = os.environ['ROS_DOMAIN_ID']
                    print(f'open {found[1]} (ROS_DOMAIN_ID={domain}; Ctrl-C ends it)', flush=True)
            time.sleep(_LOOK_PERIOD)


def _interrupt(number: int, frame: Any) -> None:
    raise KeyboardInterrupt
