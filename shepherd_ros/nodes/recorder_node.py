"""The recorder node: topics as they are on the wire into a rosbag2 directory."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from datetime import datetime
from functools import partial
from pathlib import Path
import re
from typing import Annotated, Any, Literal

from diagnostic_msgs.msg import DiagnosticStatus
from rclpy.event_handler import SubscriptionEventCallbacks
from rclpy.qos import DurabilityPolicy, QoSProfile, ReliabilityPolicy
from rclpy.subscription import Subscription
from shepherd_ros.bags.contract import known
from shepherd_ros.bags.errors import BagError
from shepherd_ros.bags.qos import Qos
from shepherd_ros.bags.schemas import installed_text, nested_text, wire_types
from shepherd_ros.bags.writer import BagWriter
from shepherd_ros.config import ConfigError
from shepherd_ros.nodes.base import ERROR, message_type, OK, ShepherdNode, WARN
from shepherd_ros.nodes.losses import Losses, Waiting, waiting
from shepherd_ros.nodes.runtime import run
from std_srvs.srv import Trigger
import tyro

DEPTH = 10_000  # messages that may wait for the recorder, per topic
GRAPH_PERIOD = 0.1  # [s] between two looks for new topics
LOSSY = 1  # exit code of a bag that is not whole


@dataclass(frozen=True)
class RecorderOptions:
    """Record topics into a rosbag2 directory; by default those of the contract."""

    output: Annotated[str, tyro.conf.arg(aliases=['-o'])] = ''
    """Folder to write; by default rosbag2_ and the time."""
    topics: tuple[str, ...] = ()
    """Names of topics to record, instead of those of the contract."""
    regex: Annotated[str, tyro.conf.arg(aliases=['-e'])] = ''
    """Record topics whose name matches this regular expression, too."""
    exclude: Annotated[str, tyro.conf.arg(aliases=['-x'])] = ''
    """Leave out topics whose name matches this regular expression."""
    all: Annotated[bool, tyro.conf.arg(aliases=['-a'])] = False
    """Record every topic."""
    compression: Literal['none', 'zstd', 'lz4'] = 'none'
    """Compression of chunks."""
    max_bag_size: Annotated[int, tyro.conf.arg(aliases=['-b'])] = 0
    """Go on in a new file after so many bytes; 0: never."""
    max_bag_duration: Annotated[float, tyro.conf.arg(aliases=['-d'])] = 0.0
    """Go on in a new file after so many seconds; 0: never."""
    per_episode: bool = False
    """One bag per episode: output/episode_0000 and so on."""
    start_paused: bool = False
    """Record nothing before ~/start is called."""
    use_sim_time: bool = False
    """Log times are those of /clock."""

    def check(self) -> None:
        """Raise ConfigError for numbers that make no sense."""
        if not (self.max_bag_size >= 0 and self.max_bag_duration >= 0):
            values = f'--max-bag-size is {self.max_bag_size}, -duration {self.max_bag_duration}'
            raise ConfigError(f'{values}: expected 0 (never) or more')
        _ = self.pattern('regex'), self.pattern('exclude')

    def pattern(self, name: str) -> re.Pattern[str] | None:
        """Return a compiled expression, None if there is none; ConfigError for a bad one."""
        text = getattr(self, name)
        try:
            return re.compile(text) if text else None
        except re.error as error:
            what = f'--{name} is {text!r}: expected a regular expression'
            raise ConfigError(f'{what} ({error})') from None


class Recorder(ShepherdNode):
    """Subscribes to what is there as soon as it is there, and writes every message it gets."""

    def __init__(self, options: RecorderOptions, **kwargs: Any) -> None:
        """Create the node; the bag is opened with the first topic."""
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
        self.options = options
        self.wanted = self._wish(options)
        self.writer: BagWriter | None = None
        self.recording = not options.start_paused
        self.inputs: dict[str, Subscription | None] = {}
        self.single: dict[str, bool] = {}  # whether a topic has one publisher
        self.topics: dict[str, dict[str, Any]] = {}  # as they are announced to a bag
        self.latched: dict[str, bytes | None] = {}  # the last message of each such topic
        self.begun = False  # whether the bag that is open tells of an episode
        self.losses = Losses()
        self.failure = ''
        self.parts = self.written = 0
        self.create_service(Trigger, '~/start', self._server(True))
        self.create_service(Trigger, '~/stop', self._server(False))
        self.look()
        self.timer(GRAPH_PERIOD, self.look)

    def _wish(self, options: RecorderOptions) -> Callable[[str], bool]:
        """Return which names to record."""
        regex, exclude = options.pattern('regex'), options.pattern('exclude')
        names = {self.resolve_topic_name(name) for name in options.topics}
        contract_too = not (names or regex or options.all)

        def wanted(name: str) -> bool:
            if exclude is not None and exclude.search(name):
                return False
            by_name = name in names or (regex is not None and regex.search(name) is not None)
            return options.all or by_name or (contract_too and known(name) is not None)

        return wanted

    # ---- topics ----

    def look(self) -> None:
        """Subscribe to new topics that are wanted."""
        self.single = {name: self.count_publishers(name) == 1 for name in self.topics}
        for name, types in self.get_topic_names_and_types():
            if name in self.inputs or not self.wanted(name):
                continue
            if len(types) > 1:
                self._refuse(name, f'it has the types {", ".join(types)}, expected one')
                continue
            offers = self.get_publishers_info_by_topic(name)
            if offers:
                try:
                    self._subscribe(name, types[0], offers)
                except (AttributeError, ImportError, FileNotFoundError, ValueError) as error:
                    self._refuse(name, f'{types[0]} is missing ({error}): install it or --exclude')

    def _refuse(self, name: str, why: str) -> None:
        """Go on without a topic; the bag is not whole then."""
        text = f'{name} is not recorded: {why}'
        self.failure = self.failure or text
        self.get_logger().error(text)
        self.inputs[name] = None

    def _subscribe(self, name: str, kind: str, offers: list[Any]) -> None:
        """Subscribe with a quality of service that all publishers offer."""
        profiles = [offer.qos_profile for offer in offers]
        reliable = all(p.reliability == ReliabilityPolicy.RELIABLE for p in profiles)
        latched = all(p.durability == DurabilityPolicy.TRANSIENT_LOCAL for p in profiles)
        profile = QoSProfile(
            depth=DEPTH,
            reliability=ReliabilityPolicy.RELIABLE if reliable else ReliabilityPolicy.BEST_EFFORT,
            durability=DurabilityPolicy.TRANSIENT_LOCAL if latched else DurabilityPolicy.VOLATILE,
        )
        qos = tuple(Qos(p.reliability.name.lower(), p.durability.name.lower()) for p in profiles)
        message = message_type(kind)
        if latched:
            self.latched[name] = None
        self.topics[name] = {'type_name': kind, 'qos': qos}
        if kind not in wire_types():
            schema = 'ros2msg', nested_text(kind, installed_text).encode()
            hash_text = str(offers[0].topic_type_hash)
            self.topics[name] |= {'schema': schema, 'hash_text': hash_text}
        self.single[name] = len(offers) == 1
        taker: Any = partial(self.receive, name)
        self.inputs[name] = self.create_subscription(
            message,
            name,
            taker,
            profile,
            raw=True,
            event_callbacks=SubscriptionEventCallbacks(
                message_lost=partial(self.losses.lost, name)
            ),
        )
        self.get_logger().info(f'recording {name} ({kind})')

    def receive(self, name: str, raw: bytes, info: Any) -> None:
        """Take a message of a topic with its times."""
        sequence = info.get('publication_sequence_number')
        if self.single[name] and not self.losses.follows(name, sequence):
            self.single[name] = self.count_publishers(name) == 1  # there may be a new one
        self.losses.heard(name, sequence, self.single[name])
        later: list[Waiting] = []
        ours = known(name) if self.recording and self.options.per_episode else None
        if ours is not None and ours.topic.name == 'episode':
            for row in waiting(self.inputs, DEPTH):
                if row[2]['received_timestamp'] < info['received_timestamp']:
                    self.receive(*row)
                else:
                    later.append(row)
            if self.begun:
                self._close()
                self.latched[f'{ours.namespace}/goal'] = None  # another one follows
            self.begun = True
        if name in self.latched:
            self.latched[name] = raw
        if self.recording:
            now = self.get_clock().now().nanoseconds
            received = now if self.options.use_sim_time else info['received_timestamp']
            self._write(name, raw, received, info['source_timestamp'] or received)
        for row in later:
            self.receive(*row)

    # ---- the bag ----

    def _write(self, name: str, raw: bytes, log_ns: int, publish_ns: int) -> None:
        """Write one message; the first of a bag opens it with all that is latched."""
        try:
            if self.writer is None:
                self.writer = self._open()
                for topic, content in self.latched.items():
                    if content is not None and topic != name:
                        self._put(self.writer, topic, content, log_ns, publish_ns)
            self._put(self.writer, name, raw, log_ns, publish_ns)
        except (BagError, OSError) as error:
            self.failure = str(error)
            self.get_logger().error(self.failure)
            self.recording, self.finished = False, True

    def _put(self, writer: BagWriter, name: str, raw: bytes, log_ns: int, publish_ns: int) -> None:
        writer.add_topic(name, **self.topics[name])
        writer.write(name, raw, log_ns, publish_ns)
        self.written += 1

    def _open(self) -> BagWriter:
        """Return a new bag: the folder itself, or the next part in it."""
        folder = self.folder
        if self.options.per_episode or self.parts:
            self.folder.mkdir(parents=True, exist_ok=True)
            folder = self.folder / f'episode_{self.parts:04d}'
        self.parts += 1
        return BagWriter(
            folder,
            compression=self.options.compression,
            split_bytes=self.options.max_bag_size,
            split_seconds=self.options.max_bag_duration,
        )

    def _close(self) -> None:
        if self.writer is not None:
            self.writer.close()
            self.writer = None

    def _server(self, start: bool) -> Callable[[Any, Any], Any]:
        """Return the callback of ~/start or ~/stop."""

        def serve(request: Any, response: Any) -> Any:
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
            for row in waiting(self.inputs, DEPTH):  # it came before the end, too
                self.receive(*row)
            self._close()
        except BagError as error:
            self.failure = str(error)
        lost = self.losses.report()
        print(f'{self.written} messages of {len(self.topics)} topics in {self.folder}')
        for line in lost:
            print(f'lost: {line}')
        if self.failure:
            print(f'failed: {self.failure}')
        whole = not lost and not self.failure
        print('the bag is whole' if whole else 'the bag is NOT whole')
        return 0 if whole else LOSSY

    def diagnose(self) -> list[DiagnosticStatus]:
        """Return whether everything heard is in the bag."""
        lost = self.losses.total
        level, message = OK, 'recording' if self.recording else 'stopped'
        if self.failure:
            level, message = ERROR, self.failure
        elif lost:
            level, message = WARN, f'{lost} messages were lost'
        return [
            self.status(
                'recorder', level, message,
                bag=self.folder, messages=self.written, topics=len(self.topics), lost=lost,
            )
        ]  # fmt: skip


def main() -> int:
    """Record topics into a rosbag2 directory."""
    return run(Recorder, 'recorder', main.__doc__ or '', RecorderOptions)
