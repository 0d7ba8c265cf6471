"""The recorder node: topics as they are on the wire into a rosbag2 directory."""

from __future__ import annotations

from collections.abc import Callable
from contextlib import suppress
from datetime import datetime
from pathlib import Path
from typing import Any

from diagnostic_msgs.msg import DiagnosticStatus
from rclpy.duration import Duration
from shepherd_ros.nodes.recorder_bags import RecorderBags
from shepherd_ros.nodes.recorder_options import RecorderOptions
from shepherd_ros.nodes.recorder_subscriptions import QUEUE_DEPTH, RecorderSubscriptions, Row
from shepherd_ros.ros.node import ERROR, OK, ShepherdNode, WARN
from shepherd_ros.ros.runtime import run
from shepherd_ros.rosbag2.errors import BagError
from shepherd_ros.wire.contract import known, KnownTopic
from shepherd_ros.wire.decode import CdrError, decode_clock, decode_stamp, decode_string
from shepherd_ros.wire.episode import Episode
from shepherd_ros.wire.topics import CLOCK, EPISODE, GOAL
from std_srvs.srv import Trigger

TAKE_PERIOD = 0.02  # [s] between two looks for messages
GRAPH_PERIOD = 0.1  # [s] between two looks for new topics
FLUSH_PERIOD = 1.0  # [s] of messages that a crash may cost at most
RECORDER_ACK_TIMEOUT = (
    4.0  # [s] for others to hear of a failure: DDS asks for what is missed every 3 s
)
EPISODE_WAIT = 0.5  # [s] for the last messages of an episode when the next one has begun
REPEATED = ('state', 'sensor', 'command', 'clock')  # profiles of what comes with a state shown
USER = ('user',)
EXIT_LOSSY = 1  # exit code of a bag that is not whole


class Recorder(ShepherdNode):
    """
    Writes every message it gets.

    Messages are taken in batches, many times a second: that costs less than a callback for each,
    and they go into the bag in the order in which they came, whatever their topics.
    """

    def __init__(self, options: RecorderOptions, **kwargs: Any) -> None:
        """Create the node; the bag is opened with the first message."""
        options.check()
        self.folder = Path(options.output or f'rosbag2_{datetime.now():%Y_%m_%d-%H_%M_%S}')
        try:
            self.folder.mkdir(parents=True)
            self.folder.rmdir()
        except OSError as error:
            there = isinstance(error, FileExistsError)
            what = 'it exists already' if there else f'it cannot be created ({error.strerror})'
            raise BagError(self.folder, what, 'choose another folder with --output') from error
        super().__init__('recorder', **kwargs)
        self.executor_kind = 'single'  # it only sees timers and services
        self.options = options
        self.wanted = options.wish(self.resolve_topic_name)
        self.recording = not options.start_paused
        self.begun = False  # whether the bag that is open tells of an episode
        self.failure = ''
        self.clock_ns: int | None = None
        self.dt_ns = 0  # between two states
        self.early: list[Row] = []  # what came before the simulated clock
        self.rate_of = (self.wall(), 0)  # when and how many messages at the last report
        wait = EPISODE_WAIT if options.per_episode else 0.0
        self.intake = RecorderSubscriptions(self, self._heard, self._refuse, wait)
        self.losses = self.intake.losses
        self.bags = RecorderBags(self.folder, options, self.intake, self.wanted)
        self.create_service(Trigger, '~/start', self._server(True))
        self.create_service(Trigger, '~/stop', self._server(False))
        self.timer(TAKE_PERIOD, self.take)
        self.timer(GRAPH_PERIOD, self.intake.look)
        self.timer(FLUSH_PERIOD, self.flush)
        self.get_logger().info(f'listening for topics that go into {self.folder}')

    def _heard(self, name: str) -> bool:
        """Return whether to listen to a topic."""
        return self.wanted(name) or (self.options.use_sim_time and name == CLOCK)

    def _refuse(self, why: str) -> None:
        self.failure = self.failure or why
        self.get_logger().error(why)

    # ---- messages ----

    def take(self, everything: bool = False) -> None:
        """Take the messages that have arrived."""
        for name, raw, info in self.intake.take(everything):
            self.receive(name, raw, info)

    def receive(self, name: str, raw: bytes, info: dict[str, int]) -> None:
        """Take a message of a topic with its times and its number."""
        ours = known(name)
        number = info.get('publication_sequence_number')
        sender = self.losses.heard(name, number, self._stamp(name, ours, raw), self.dt_ns)
        if ours is not None and ours.topic.name == EPISODE:
            self._next_episode(ours.namespace, raw)
        if name == CLOCK:
            with suppress(CdrError):
                self.clock_ns = max(decode_clock(raw), 0)
                for row in self.early:
                    self._record(*row)
                self.early.clear()
        if self.intake.inputs[name].latched:
            self.bags.latch(name, sender, raw)
        if self.recording and self.wanted(name):
            self._record(name, raw, info)

    def _stamp(self, name: str, ours: KnownTopic | None, raw: bytes) -> int | None:
        """Return the stamp [ns] of a message that is the same whenever it comes again."""
        if ours is None or ours.topic.profile not in REPEATED or ours.topic.publisher == USER:
            return None
        with suppress(CdrError):
            if self.intake.inputs[name].kind == ours.topic.type:
                return decode_stamp(raw)
        return None

    def _record(self, name: str, raw: bytes, info: dict[str, int]) -> None:
        """Write a message; with simulated time it waits for the first of the clock."""
        received: int | None = info['received_timestamp']
        if self.options.use_sim_time:
            received = self.clock_ns
        if received is not None:
            coming = {id(row[1]) for row in self.early}
            try:
                publish_ns = info['source_timestamp'] or received
                self.bags.write(name, raw, received, publish_ns, coming)
            except (BagError, OSError) as error:
                self._fail(error)
        elif len(self.early) < QUEUE_DEPTH:
            self.early.append((name, raw, info))
        else:
            self.losses.dropped(name, 1)

    def _next_episode(self, namespace: str, raw: bytes) -> None:
        """Expect the topics of an episode; begin its bag if each has its own."""
        with suppress(ValueError):
            episode = Episode.from_json(decode_string(raw))
            self.dt_ns = episode.dt_ns
            self.intake.expect(namespace, episode.n_shepherds)
        told = self.bags.latched[f'{namespace}/{EPISODE}'].values()
        again = raw in told  # to those who were silent
        if self.recording and self.options.per_episode and not (again and self.begun):
            if self.begun:
                self.bags.close()
                self.bags.latched.pop(f'{namespace}/{GOAL}', None)  # another one follows
            self.begun = True

    # ---- the bag ----

    def flush(self) -> None:
        """Put what was taken so far on the disk, with what was lost."""
        self.take()
        self.intake.group.open = True  # until the next take()
        if not self.failure:
            try:
                self.bags.flush()
            except BagError as error:
                self._fail(error)

    def _fail(self, error: BagError | OSError) -> None:
        """End with an error, which everybody is told of."""
        self.failure = str(error)
        self.bags.count_kept()
        self.get_logger().error(self.failure)
        self.recording, self.finished = False, True
        self.publish_diagnostics()

    def _server(self, start: bool) -> Callable[[Any, Any], Any]:
        """Return the callback of ~/start or ~/stop."""

        def serve(request: Any, response: Any) -> Any:
            self.take(everything=True)  # that came before
            response.success = self.recording != start and not self.failure
            state = 'recording' if start else 'stopped'
            response.message = state if response.success else self.failure or f'already {state}'
            if response.success:
                self.recording = start
            return response

        return serve

    # ---- the end ----

    def end(self) -> int:
        """Close the bag, say what is in it and what is not, and return the exit code."""
        try:
            self.take(everything=True)  # it came before the end, too
            self.bags.close()
        except BagError as error:
            self._fail(error)
        if self.early:
            self.failure = self.failure or (
                f'{len(self.early)} messages came and no {CLOCK}, which --use-sim-time needs'
            )
        if self.failure:
            self._diagnostics.wait_for_all_acked(Duration(seconds=RECORDER_ACK_TIMEOUT))
        lost = self.losses.report()
        print(
            f'{self.bags.written} messages of {len(self.bags.announced)} topics in {self.folder}'
        )
        for line in lost:
            print(f'lost: {line}')
        for name, count in self.losses.earlier().items():
            print(f'sent before the first that was heard: {name}: {count}')
        if self.failure:
            print(f'failed: {self.failure}')
        whole = not lost and not self.failure
        print('the bag is whole' if whole else 'the bag is NOT whole')
        return 0 if whole else EXIT_LOSSY

    def diagnose(self) -> list[DiagnosticStatus]:
        """Return whether everything heard is in the bag, and how fast it comes."""
        by_topic = self.losses.by_topic()
        now, (then, before) = self.wall(), self.rate_of
        rate = (self.bags.written - before) / max(now - then, 1e-3)
        self.rate_of = now, self.bags.written
        level, message = OK, 'recording' if self.recording else 'stopped'
        if self.failure:
            level, message = ERROR, self.failure
        elif by_topic:
            level, message = WARN, f'{by_topic.total()} messages were lost'
        return [
            self.status(
                'recorder', level, message,
                bag=self.folder, messages=self.bags.written, on_disk=self.bags.safe,
                rate=round(rate, 1), topics=len(self.bags.announced), lost=by_topic.total(),
                **{f'lost {name}': count for name, count in by_topic.items()},
            )
        ]  # fmt: skip


def main() -> int:
    """Record topics into a rosbag2 directory."""
    return run(Recorder, 'recorder', main.__doc__ or '', RecorderOptions)
