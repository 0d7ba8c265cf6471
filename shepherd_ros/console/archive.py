"""Bags and jobs of the console: record, list, replay, counterfactual, and a value map."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Callable, Sequence
from contextlib import suppress
from pathlib import Path
import shutil
import tempfile
from typing import Any

from shepherd_ros.config import ConfigError
from shepherd_ros.console.desk import Answer, ConsoleDesk
from shepherd_ros.console.jobs import bag_path, Jobs
from shepherd_ros.console.messages import message_text
from shepherd_ros.console.recording import Recording
from shepherd_ros.console.sessions import Session

FILES_KEPT = 4  # results that a page may have; older ones are deleted


class Archive:
    """Carries out the commands on bags; all is called in the server's loop."""

    def __init__(self, desk: ConsoleDesk, record_dir: Path, words: Sequence[str]) -> None:
        """Serve the pages of a desk; words are added to the command line of recorders."""
        self.desk, self.record_dir = desk, record_dir
        self.folder = Path(tempfile.mkdtemp(prefix='shepherd_console_'))
        self.jobs = Jobs(self.folder)
        self.recording = Recording(record_dir, words, self.folder, desk.tell)
        self.files: defaultdict[int, list[str]] = defaultdict(list)  # results, by page
        self.owners: dict[int, int] = {}  # page by job
        commands: dict[str, Callable[..., None]] = {
            'record': self._record,
            'stop_recording': self._stop_recording,
            'list_bags': self._list_bags,
            'replay': self._replay,
            'counterfactual': self._replay,
            'cancel': self._cancel,
        }
        desk.own |= commands
        desk.results = self.path_of
        desk.on_open.append(self.opened)
        desk.on_close.append(self.closed)
        self.recording.say()
        self.asked_for_catalog = False

    def opened(self, session: Session) -> None:
        """Find out once what pages may choose from, which needs torch and so a process."""
        if not self.asked_for_catalog:
            self.asked_for_catalog = True
            self.jobs.start('catalog', {}, self._catalog)

    def _catalog(self, job: int, line: dict[str, Any]) -> None:
        if 'result' in line:
            self.desk.describe(**line['result'])

    def path_of(self, name: str) -> str | None:
        """Return the path of a result with a name, None if there is none."""
        known = any(name in names for names in self.files.values())
        return str(self.folder / name) if known else None

    def closed(self, session: Session) -> None:
        """End the jobs of a page and delete its results."""
        for job in [job for job, page in self.owners.items() if page == session.number]:
            self.jobs.cancel(job)
            del self.owners[job]
        self._delete(self.files.pop(session.number, []))

    def _delete(self, names: Sequence[str]) -> None:
        for name in names:
            (self.folder / name).unlink(missing_ok=True)

    async def close(self) -> None:
        """End all processes and delete all results."""
        await self.jobs.close()
        await self.recording.close()
        shutil.rmtree(self.folder, ignore_errors=True)

    # ---- commands ----

    def _record(self, session: Session, answer: Answer) -> None:
        self.recording.start(answer)

    def _stop_recording(self, session: Session, answer: Answer) -> None:
        self.recording.stop(answer)

    def _list_bags(self, session: Session, answer: Answer) -> None:
        def on_line(job: int, line: dict[str, Any]) -> None:
            if 'result' in line:
                self.desk.tell('bags', bags=line['result'])
                answer(True, f'{len(line["result"])} bags')
            elif 'error' in line:
                answer(False, line['error'])

        self.jobs.start('bags', {'record_dir': str(self.record_dir)}, on_line)

    def _replay(self, session: Session, answer: Answer, bag: str, **request: Any) -> None:
        kind = 'counterfactual' if 'controller' in request else 'replay'
        request |= {'bag': bag, 'path': str(bag_path(self.record_dir, bag))}

        def on_line(job: int, line: dict[str, Any]) -> None:
            self._on_job_line(session, kind, job, line)

        job = self.jobs.start(kind, request, on_line)
        self.owners[job] = session.number
        answer(True, f'job {job}')

    def _on_job_line(self, session: Session, kind: str, job: int, line: dict[str, Any]) -> None:
        """Tell a page what a job of its own says."""
        if session.number not in self.desk.sessions:
            return
        status = {'done': 0.0, 'text': '', 'result': None, 'state': 'running'} | line
        if 'error' in line:
            status |= {'state': 'failed', 'text': status.pop('error')}
        elif 'result' in line:
            status |= {'state': 'done', 'done': 1.0}
            names = self.files[session.number]
            names += [track['url'] for track in line['result']['tracks']]
            self._delete(names[:-FILES_KEPT])
            del names[:-FILES_KEPT]
        session.tell(f'job {job}', message_text('job', job=job, kind=kind, **status))
        if status['state'] != 'running':
            self.owners.pop(job, None)

    def _cancel(self, session: Session, answer: Answer, job: int) -> None:
        if self.owners.get(job) != session.number:
            raise ConfigError(f'job is {job}: expected the number of one of this page that runs')
        with suppress(KeyError):
            del self.owners[job]
        self.jobs.cancel(job)
        ended = {'state': 'cancelled', 'done': 0.0, 'text': 'cancelled', 'result': None}
        session.tell(f'job {job}', message_text('job', job=job, kind='', **ended))
        answer(True, f'job {job} is cancelled')
