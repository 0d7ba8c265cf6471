"""The value map of the running world: a critic's values of the places of one shepherd."""

from __future__ import annotations

import asyncio
from collections.abc import Callable
from typing import Any

from shepherd_ros.config import ConfigError
from shepherd_ros.console.desk import Answer, ConsoleDesk
from shepherd_ros.console.jobs import Jobs
from shepherd_ros.console.sessions import Session

ASK_PERIOD = 0.25  # [s] between two looks for a new state
NO_VALUES: dict[str, Any] = {'step': None, 'x': None, 'y': None, 'values': None}


class LiveValues:
    """
    Has a process map the newest state again and again while a page wants it.

    moment(shepherd) returns a state as plain data, None before the first. All pages share a map.
    """

    def __init__(
        self,
        desk: ConsoleDesk,
        jobs: Jobs,
        moment: Callable[[int], dict[str, Any] | None],
    ) -> None:
        """Begin without a map."""
        self.desk, self.jobs, self.moment = desk, jobs, moment
        self.job = 0  # number, 0: none
        self.request: dict[str, Any] = {}
        self.last: dict[str, Any] | None = None  # state that was mapped
        self.ready = False  # whether the process waits for a state
        desk.own['value_map'] = self._value_map
        desk.on_close.append(self._closed)
        self._say(text='')

    def _say(self, text: str, **content: Any) -> None:
        on = bool(self.job)
        request = {'checkpoint': None, 'shepherd': None} | self.request
        self.desk.tell('value_map', on=on, text=text, **request, **(NO_VALUES | content))

    def _value_map(
        self,
        session: Session,
        answer: Answer,
        on: bool,
        checkpoint: str = 'strombom',
        shepherd: int = 0,
    ) -> None:
        self._end()
        if on:
            if self.moment(shepherd) is None:
                raise ConfigError(f'no state with a shepherd {shepherd} is there to be mapped yet')
            self.request = {'checkpoint': checkpoint, 'shepherd': shepherd}
            self.job = self.jobs.start('value_map', self.request, self._on_line)
            self._say(text='loading the checkpoint')
            asyncio.get_running_loop().call_later(ASK_PERIOD, self._ask, self.job)
        answer(True, f'values of {checkpoint}' if on else 'no value map')

    def _end(self, text: str = '') -> None:
        if self.job:
            self.jobs.cancel(self.job)
        self.job, self.last, self.ready, self.request = 0, None, False, {}
        self._say(text=text)

    def _closed(self, session: Session) -> None:
        if self.job and not self.desk.sessions:
            self._end()

    def _ask(self, job: int) -> None:
        """Send the newest state if the process waits for one."""
        if job != self.job or job not in self.jobs.running:
            return
        asyncio.get_running_loop().call_later(ASK_PERIOD, self._ask, job)
        moment = self.moment(self.request['shepherd']) if self.ready else None
        if moment is not None and moment != self.last:
            self.last, self.ready = moment, False
            self.jobs.running[job].say(moment)

    def _on_line(self, job: int, line: dict[str, Any]) -> None:
        if job != self.job:
            return
        if 'error' in line:
            self.job = 0
            self._end(text=line['error'])
        elif 'values' in line:
            self.ready = True
            self._say(text='', **line)
        else:
            self.ready = True
