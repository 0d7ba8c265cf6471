"""The recorder node: it writes the bytes of topics into a rosbag2 directory."""

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

POLL_PERIOD = 0.02  # [s] between two looks for messages
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
    Writes every message that it receives.

    Messages are polled in batches, many times a second: that costs less than a callback for each,
    and they go into the bag in their order of arrival over all topics.
    """

    def __init__(self, options: RecorderOptions, **kwargs: Any) -> None:
        """Create the node; the bag is opened with the first message."""
        options.check()
        self.folder = Path(options.output or f'rosbag2_{datetime.now():%Y_%m_%d-%H_%M_%S}')
        try:
            self.folder.mkdir(parents=True)
            self.folder.rmdir()
        except OSError as error:
            exists = isinstance(error, FileExistsError)
            reason = 'it exists already' if exists else f'it cannot be created ({error.strerror})'
            raise BagError(self.folder, reason, 'choose another folder with --output') from error
        super().__init__('recorder', **kwargs)
        self.executor_kind = 'single'  # it only sees timers and services
        self.options = options
        self.wanted = options.topic_filter(self.resolve_topic_name)
        self.recording = not options.start_paused
        self.episode_open = False  # whether the bag that is open tells of an episode
        self.failure = ''
        self.clock_ns: int | None = None
        self.dt_ns = 0  # between two states
        self.waiting: list[Row] = []  # what came before the simulated clock
        self.last_report = (self.wall(), 0)  # when and how many messages at the last report
        wait = EPISODE_WAIT if options.per_episode else 0.0
        self.subscribed = RecorderSubscriptions(
            self, self._subscribes_to, self._refuse, wait, options.verbose
        )
        self.losses = self.subscribed.losses
        self.bags = RecorderBags(self.folder, options, self.subscribed, self.wanted)
        self.create_service(Trigger, '~/start', self._server(True))
        self.create_service(Trigger, '~/stop', self._server(False))
        self.timer(POLL_PERIOD, self.poll_messages)
        self.timer(GRAPH_PERIOD, self.subscribed.look)
        self.timer(FLUSH_PERIOD, self.flush)
        self.get_logger().info(f'listening for topics that go into {self.folder}')

    def _subscribes_to(self, name: str) -> bool:
        """Return whether to subscribe to a topic."""
        return self.wanted(name) or (self.options.use_sim_time and name == CLOCK)

    def _refuse(self, reason: str) -> None:
        self.failure = self.failure or reason
        self.get_logger().error(reason)

    # ---- messages ----

    def poll_messages(self, everything: bool = False) -> None:
        """Handle the messages that have arrived."""
        for name, raw, info in self.subscribed.poll_messages(everything):
            self.receive(name, raw, info)

    def receive(self, name: str, raw: bytes, info: dict[str, int]) -> None:
        """Handle a message of a topic with its times and its number."""
        entry = known(name)
        number = info.get('publication_sequence_number')
        sender = self.losses.count_message(name, number, self._stamp(name, entry, raw), self.dt_ns)
        if entry is not None and entry.topic.name == EPISODE:
            self._next_episode(entry.namespace, raw)
        if name == CLOCK:
            with suppress(CdrError):
                self.clock_ns = max(decode_clock(raw), 0)
                for row in self.waiting:
                    self._record(*row)
                self.waiting.clear()
        if self.subscribed.inputs[name].latched:
            self.bags.latch(name, sender, raw)
        if self.recording and self.wanted(name):
            self._record(name, raw, info)

    def _stamp(self, name: str, entry: KnownTopic | None, raw: bytes) -> int | None:
        """Return the stamp [ns] of a message that flock_sim may repeat, None for others."""
        if entry is None or entry.topic.profile not in REPEATED or entry.topic.publisher == USER:
            return None
        with suppress(CdrError):
            if self.subscribed.inputs[name].kind == entry.topic.type:
                return decode_stamp(raw)
        return None

    def _record(self, name: str, raw: bytes, info: dict[str, int]) -> None:
        """Write a message; with simulated time it waits for the first /clock."""
        received: int | None = info['received_timestamp']
        if self.options.use_sim_time:
            received = self.clock_ns
        if received is not None:
            pending_ids = {id(row[1]) for row in self.waiting}
            try:
                publish_ns = info['source_timestamp'] or received
                self.bags.write(name, raw, received, publish_ns, pending_ids)
            except (BagError, OSError) as error:
                self._fail(error)
        elif len(self.waiting) < QUEUE_DEPTH:
            self.waiting.append((name, raw, info))
        else:
            self.losses.dropped(name, 1)

    def _next_episode(self, namespace: str, raw: bytes) -> None:
        """Subscribe to the topics of an episode; begin its bag if each has its own."""
        with suppress(ValueError):
            episode = Episode.from_json(decode_string(raw))
            self.dt_ns = episode.dt_ns
            self.subscribed.expect(namespace, episode.n_shepherds)
        latched = self.bags.latched[f'{namespace}/{EPISODE}'].values()
        repeated = raw in latched  # to those who were silent
        if self.recording and self.options.per_episode and not (repeated and self.episode_open):
            if self.episode_open:
                self.bags.close()
                self.bags.latched.pop(f'{namespace}/{GOAL}', None)  # another one follows
            self.episode_open = True

    # ---- the bag ----

    def flush(self) -> None:
        """Flush the messages so far to the disk, with the counts of losses."""
        self.poll_messages()
        self.subscribed.group.open = True  # until the next poll_messages()
        self.subscribed.tell()
        if not self.failure:
            try:
                self.bags.flush()
            except BagError as error:
                self._fail(error)

    def _fail(self, error: BagError | OSError) -> None:
        """End with an error, and publish it on /diagnostics."""
        self.failure = str(error)
        self.bags.count_on_disk()
        self.get_logger().error(self.failure)
        self.recording, self.finished = False, True
        self.publish_diagnostics()

    def _server(self, start: bool) -> Callable[[Any, Any], Any]:
        """Return the callback of ~/start or ~/stop."""

        def serve(request: Any, response: Any) -> Any:
            self.poll_messages(everything=True)  # that came before
            response.success = self.recording != start and not self.failure
            state = 'recording' if start else 'stopped'
            response.message = state if response.success else self.failure or f'already {state}'
            if response.success:
                self.recording = start
            return response

        return serve

    # ---- the end ----

    def end(self) -> int:
        """Close the bag, print counts and losses, and return the exit code."""
        try:
            self.poll_messages(everything=True)  # it came before the end, too
            self.bags.close()
        except BagError as error:
            self._fail(error)
        if self.waiting:
            self.failure = self.failure or (
                f'{len(self.waiting)} messages came and no {CLOCK}, which --use-sim-time needs'
            )
        if self.failure:
            self._diagnostics.wait_for_all_acked(Duration(seconds=RECORDER_ACK_TIMEOUT))
        lost = self.losses.by_topic()
        print(f'{self.bags.written} messages of {len(self.bags.topics)} topics in {self.folder}')
        for line in self.losses.summary(self.options.verbose):
            print(line)
        if self.failure:
            print(f'failed: {self.failure}')
        whole = not lost and not self.failure
        print('the bag is whole' if whole else 'the bag is NOT whole')
        return 0 if whole else EXIT_LOSSY

    def diagnose(self) -> list[DiagnosticStatus]:
        """Return the status of the recording: failures, losses and the rate of messages."""
        by_topic = self.losses.by_topic()
        now, (then, written_before) = self.wall(), self.last_report
        rate = (self.bags.written - written_before) / max(now - then, 1e-3)
        self.last_report = now, self.bags.written
        level, message = OK, 'recording' if self.recording else 'stopped'
        if self.failure:
            level, message = ERROR, self.failure
        elif by_topic:
            level, message = WARN, f'{by_topic.total()} messages were lost'
        return [
            self.status(
                'recorder', level, message,
                bag=self.folder, messages=self.bags.written, on_disk=self.bags.on_disk,
                rate=round(rate, 1), topics=len(self.bags.topics), lost=by_topic.total(),
                **{f'lost {name}': count for name, count in by_topic.items()},
            )
        ]  # fmt: skip


def main() -> int:
    """Record topics into a rosbag2 directory."""
    return run(Recorder, 'recorder', main.__doc__ or '', RecorderOptions)
