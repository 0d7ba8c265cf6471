"""The player node: it publishes the messages of a bag on their topics, at its rate."""

from __future__ import annotations

from collections import deque
from collections.abc import Iterator
from heapq import merge
from threading import Event, Lock, Thread
from typing import Any

from diagnostic_msgs.msg import DiagnosticStatus
from rclpy.duration import Duration
from rclpy.publisher import Publisher
from shepherd_ros.config import ConfigError
from shepherd_ros.nodes.player_options import PlayerOptions
from shepherd_ros.nodes.player_topics import playable_type, recorded_quality
from shepherd_ros.ros.node import OK, ShepherdNode
from shepherd_ros.ros.runtime import run
from shepherd_ros.rosbag2.bag import BagMessage
from shepherd_ros.rosbag2.qos import history
from shepherd_ros.rosbag2.reader import open_bag
from shepherd_ros.wire.encode import encode_clock
from shepherd_ros.wire.topics import CLOCK
from std_srvs.srv import SetBool, Trigger

NS_PER_SECOND = 1_000_000_000  # [ns]
PLAYER_ACK_TIMEOUT = 4.0  # [s] for readers to miss what did not arrive: DDS asks them every 3 s
MIN_LOOP_PERIOD = 0.1  # [s] of --loop: a bag may have one message
PROGRESS_PERIOD = 10.0  # [s] between two lines about how far the bag is played
LATCHED_LEAD = 0.2  # [s] that readers get to know the topics before the first message


class Player(ShepherdNode):
    """Publishes the recorded bytes in their order, at the times of the recording."""

    def __init__(self, options: PlayerOptions, **kwargs: Any) -> None:
        """Create the publishers; a thread plays."""
        options.check()
        self.options = options
        self.bag = open_bag(options.bag)
        unknown = sorted(set(options.topics) - set(self.bag.topics))
        if unknown:
            raise ConfigError(
                f'--topics has {", ".join(unknown)}: expected some of {", ".join(self.bag.topics)}'
            )
        types, skipped = {}, []
        for name, topic in self.bag.topics.items():
            if not options.topics or name in options.topics:
                try:
                    types[name] = playable_type(self.bag, topic)
                except ConfigError as error:
                    skipped.append(str(error))
        if skipped and not types:
            raise ConfigError(skipped[0])
        self.names = list(types)
        super().__init__('player', **kwargs)  # after what needs no graph
        for reason in skipped:
            self.get_logger().warning(f'skipped: {reason}')
        self.outputs: dict[str, Publisher] = {
            name: self.create_publisher(kind, name, recorded_quality(self.bag.topics[name].qos))
            for name, kind in types.items()
        }
        histories = {name: history(self.bag.topics[name].qos) for name in self.names}
        self.latched = {name: depth for name, depth in histories.items() if depth}
        self.clock_output = None
        if options.clock and CLOCK not in self.names:
            self.clock_output = self.advertise(CLOCK)
            self.timer(1 / options.clock, self.publish_clock)
        self.played = 0
        self.lateness: list[float] = []  # [s] of each message
        self.current_ns = self.next_ns = self.bag.start_ns  # of the last and the next message
        # wall times [s]: of the start, later by pauses; of a pause
        self.started = self.paused = 0.0
        self.steps = 0
        self.running = Event()
        if not options.start_paused:
            self.running.set()
        self.lock, self.stopped, self.wake = Lock(), Event(), Event()
        self.failure = ''
        self.create_service(SetBool, '~/pause', self.pause)
        self.option('step_size', 1, 'messages that ~/step plays', read_only=False, low=1)
        self.create_service(Trigger, '~/step', self.step)
        self.timer(PROGRESS_PERIOD, self.report_progress)
        self.thread = Thread(target=self.play, daemon=True)
        self.thread.start()

    # ---- playing ----

    def play(self) -> None:
        """Play the bag, once or for ever."""
        try:
            self.wait_for_subscribers()
            again = True
            while again and not self.stopped.is_set():
                played_before, limit = self.played, self.wall() + MIN_LOOP_PERIOD
                self.play_once()
                again = self.options.loop and self.played > played_before
                self.stopped.wait(limit - self.wall() if again else 0.0)
        except ConfigError as error:
            self.failure = str(error)
        self.finished = True

    def wait_for_subscribers(self) -> None:
        """Wait until every topic has a reader, at most the time of option wait."""
        limit = self.wall() + self.options.wait
        while self.wall() < limit and not self.stopped.wait(0.02):
            if all(o.get_subscription_count() for o in self.outputs.values()):
                break
        self.stopped.wait(LATCHED_LEAD)

    def messages(self) -> Iterator[BagMessage]:
        """Yield the messages to play; from before start_offset only latched ones."""
        first = self.bag.start_ns
        start = first + round(self.options.start_offset * NS_PER_SECOND)
        end = first + round(self.options.until * NS_PER_SECOND) if self.options.until else None
        if self.options.start_offset:
            latched = {
                name: deque[BagMessage](maxlen=depth) for name, depth in self.latched.items()
            }
            for message in self.bag.messages(latched, end_ns=start):
                latched[message.topic].append(message)
            yield from merge(*latched.values(), key=lambda message: message.log_ns)
        yield from self.bag.messages(self.names, start, end)

    def play_once(self) -> None:
        """Publish every message when it is due."""
        first = self.bag.start_ns + round(self.options.start_offset * NS_PER_SECOND)
        self.current_ns = self.next_ns = first
        self.started = self.wall()
        for message in self.messages():
            self.next_ns = max(message.log_ns, first)
            offset = (self.next_ns - first) / NS_PER_SECOND / self.options.rate
            single_step = False  # for this message, by ~/step
            while not self.stopped.is_set():
                if not (single_step or self.running.is_set()):
                    self.paused = self.wall()
                    single_step = self.wait_for_resume()
                    self.started += self.wall() - self.paused
                    self.paused = 0.0
                    continue
                due = self.started + offset
                wait = due - self.wall()
                if wait <= 0:
                    break
                self.wake.wait(wait)
                self.wake.clear()
            else:
                return
            self.current_ns = self.next_ns
            self.outputs[message.topic].publish(message.data)
            self.lateness.append(max(self.wall() - due, 0.0))
            self.played += 1

    def bag_time(self) -> int:
        """Return the time of the bag [ns], interpolated between two messages."""
        passed = ((self.paused or self.wall()) - self.started) * self.options.rate
        first = self.bag.start_ns + self.options.start_offset * NS_PER_SECOND
        return min(max(round(first + passed * NS_PER_SECOND), self.current_ns), self.next_ns)

    def wait_for_resume(self) -> bool:
        """Wait until the pause is over; return whether it is only for a message of ~/step."""
        while not self.stopped.is_set() and not self.running.is_set():
            with self.lock:
                if self.steps > 0:
                    self.steps -= 1
                    return True
            self.wake.wait(0.05)
            self.wake.clear()
        return False

    def publish_clock(self) -> None:
        """Publish the time of the bag on /clock."""
        if self.clock_output is not None and self.started:
            self.clock_output.publish(encode_clock(self.bag_time()))

    # ---- services, diagnostics, end ----

    def pause(self, request: Any, response: Any) -> Any:
        """Pause on true, go on on false."""
        if request.data:
            self.running.clear()
        else:
            self.running.set()
        with self.lock:
            self.steps = 0
        self.wake.set()
        response.success, response.message = True, 'paused' if request.data else 'playing'
        return response

    def step(self, request: Any, response: Any) -> Any:
        """Play step_size messages, then pause."""
        n = self.get_parameter('step_size').value
        self.running.clear()
        with self.lock:
            self.steps += n
        self.wake.set()
        response.success, response.message = True, f'{n} messages, then paused'
        return response

    def diagnose(self) -> list[DiagnosticStatus]:
        """Return the diagnostics of the playback."""
        state = 'playing' if self.running.is_set() else 'paused'
        elapsed = (self.current_ns - self.bag.start_ns) / NS_PER_SECOND
        return [
            self.status(
                'player', OK, state, bag=self.bag.path, messages=self.played, seconds=elapsed
            )
        ]

    def report_progress(self) -> None:
        """Log how far the bag is played."""
        done, total = (
            (ns - self.bag.start_ns) / NS_PER_SECOND for ns in (self.current_ns, self.bag.end_ns)
        )
        self.get_logger().info(f'{done:.0f} of {total:.0f} s, {self.played} messages')

    def end(self) -> int:
        """Stop the thread, print counts and latencies, and return the exit code."""
        self.stopped.set()
        self.wake.set()
        self.thread.join(2.0)
        limit = self.wall() + PLAYER_ACK_TIMEOUT
        for output in self.outputs.values():
            output.wait_for_all_acked(Duration(seconds=max(limit - self.wall(), 0.0)))
        if self.failure:
            print(f'player: {self.failure}')
            return 2
        lateness = sorted(self.lateness) or [0.0]
        median, p99 = (
            lateness[len(lateness) // 2],
            lateness[min(len(lateness) - 1, round(0.99 * len(lateness)))],
        )
        print(
            f'{self.played} messages of {len(self.names)} topics; '
            f'late by {median * 1e3:.2f} ms (p50), {p99 * 1e3:.2f} ms (p99)'
        )
        return 0


def main() -> int:
    """Play a bag back on its topics."""
    return run(Player, 'player', main.__doc__ or '', PlayerOptions)
