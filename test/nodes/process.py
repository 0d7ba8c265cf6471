"""
Processes, nodes and a probe in one DDS domain, and what env.step says that they should do.

A process is forked from one that has imported torch and rclpy, which saves 3 s each time; it then
runs the installed script as a shell would. With fresh=True a new Python runs it.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
import faulthandler
from itertools import pairwise
import json
import os
from pathlib import Path
import re
import runpy
from signal import SIGINT, SIGKILL, Signals, SIGUSR1
import struct
import sys
import time
from typing import Any

from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus
from forks import BIN, die_with_tests, FORKS
from geometry_msgs.msg import PoseArray, TwistStamped
from rcl_interfaces.msg import Log
from rcl_interfaces.srv import SetParameters
import rclpy
from rclpy.context import Context
from rclpy.executors import SingleThreadedExecutor
from rclpy.node import Node
from rclpy.parameter import Parameter
from rclpy.publisher import Publisher
from rclpy.qos import DurabilityPolicy, QoSProfile, ReliabilityPolicy
from rclpy.serialization import deserialize_message
from rclpy.subscription import Subscription
from rclpy.task import Future
from rosgraph_msgs.msg import Clock
from shepherd_ros.controllers import make_controller
from shepherd_ros.nodes.compose import NODES
from shepherd_ros.ros.node import nanoseconds, ShepherdNode, stamp
from shepherd_ros.sim.env import ShepherdEnv
from shepherd_ros.sim.rollout import EnvConfig
from shepherd_ros.sim.state import WorldState
from std_srvs.srv import Trigger
import torch
from torch import Tensor

EXECUTABLES = tuple(NODES)
DEADLINE = 100.0  # [s] for anything that should happen soon, on a machine that has much to do

RELIABLE = QoSProfile(depth=5000, reliability=ReliabilityPolicy.RELIABLE)
BEST_EFFORT = QoSProfile(depth=5000, reliability=ReliabilityPolicy.BEST_EFFORT)
LATCHED = QoSProfile(
    depth=100,
    reliability=ReliabilityPolicy.RELIABLE,
    durability=DurabilityPolicy.TRANSIENT_LOCAL,
)

PLUGINS = 'SHEPHERD_ROS_PLUGINS'


def until(
    condition: Callable[[], Any],
    what: str | Callable[[], str],
    seconds: float = DEADLINE,
    step: Callable[[], None] = lambda: time.sleep(0.01),
) -> Any:
    """Return what the condition returns once that is true; AssertionError after the deadline."""
    end = time.monotonic() + seconds
    while not (result := condition()):
        if time.monotonic() > end:
            text = what if isinstance(what, str) else what()
            raise AssertionError(f'not within {seconds} s: {text}')
        step()
    return result


def words_of(parameters: dict[str, Any]) -> list[str]:
    """Return parameters as words of a command line; a string is taken as YAML."""
    words = []
    for name, value in parameters.items():
        words += ['-p', f'{name}:={value if isinstance(value, str) else json.dumps(value)}']
    return words


def _run(
    path: Path, words: list[str], output: Path, domain: int, fresh: bool, plugins: str
) -> None:
    """Become the executable, in a process group of its own."""
    os.setsid()
    die_with_tests()
    with output.open('ab', buffering=0) as sink:
        os.dup2(sink.fileno(), 1)
        os.dup2(sink.fileno(), 2)
    os.environ |= {'ROS_DOMAIN_ID': str(domain), PLUGINS: plugins}
    if fresh:
        os.execv(path, [str(path), *words])
    faulthandler.register(SIGUSR1)
    sys.argv = [str(path), *words]
    runpy.run_path(str(path), run_name='__main__')


class Process:
    """An executable of the package; its output goes to a file."""

    def __init__(
        self, executable: str, words: list[str], output: Path, domain: int, fresh: bool
    ) -> None:
        """Start it."""
        self.executable, self.output, self.fresh = executable, output, fresh
        output.touch()
        plugins = os.environ.pop(PLUGINS, '')  # the server of forks would keep them for others
        self._process = FORKS.Process(
            target=_run,
            args=(BIN / executable, words, output, domain, fresh, plugins),
            daemon=True,
        )
        self._process.start()
        if plugins:
            os.environ[PLUGINS] = plugins
        self.pid = int(self._process.pid or 0)

    def __str__(self) -> str:
        """Return name, state and last output."""
        code = self.code
        state = 'running' if code is None else f'exit code {code}'
        return f'{self.executable} ({state}) said:\n{self.text[-2000:]}'

    @property
    def text(self) -> str:
        """Return what it has written so far to stdout and stderr."""
        return self.output.read_text(errors='replace')

    @property
    def code(self) -> int | None:
        """Return its exit code, None while it runs; a signal that killed it is negative."""
        return self._process.exitcode

    def says(self, pattern: str) -> re.Match[str] | None:
        """Return the first match in its output; AssertionError if it ended without one."""
        code = self.code
        found = re.search(pattern, self.text)
        assert found or code is None, f'no {pattern!r} from {self}'
        return found

    def send(self, *signals: Signals) -> None:
        """Send signals to the process alone."""
        for number in signals:
            if self.code is None:
                os.kill(self.pid, number)

    def wait(self, seconds: float = DEADLINE) -> int:
        """Return its exit code once it has ended."""
        self._process.join(seconds)
        if self.code is None and not self.fresh:  # where it hangs comes into its text
            self.send(SIGUSR1)
            self._process.join(1.0)
        assert self.code is not None, f'did not end within {seconds} s: {self}'
        return self.code

    def stop(self, number: Signals = SIGINT) -> int:
        """Signal it to stop and return its exit code."""
        self.send(number)
        return self.wait()

    def kill(self) -> None:
        """End the whole group at once."""
        if self.code is None:
            try:
                os.killpg(self.pid, SIGKILL)
            except ProcessLookupError:  # it has no group yet, or has just ended
                self._process.kill()
            self._process.join(DEADLINE)


@dataclass
class Track:
    """What was said of the world: states as they came, in CDR, by stamp [ns]."""

    halves: dict[str, dict[int, bytes]] = field(
        default_factory=lambda: {'flock': {}, 'shepherds': {}}
    )
    shown: list[int] = field(default_factory=list)  # stamps of flock/poses as they came
    subscriptions: list[Subscription] = field(default_factory=list)

    def take(self, side: str, raw: bytes) -> None:
        """Take one half of a state; when it is shown again, it has to be the same."""
        sec, nanosec = struct.unpack_from('<iI', raw, 4)
        ns = sec * 10**9 + nanosec
        assert self.halves[side].setdefault(ns, raw) == raw, f'{side} at {ns} changed'
        if side == 'flock':
            self.shown.append(ns)

    def poses(self, side: str, ns: int) -> PoseArray:
        """Return one half of a state as rclpy reads it."""
        return deserialize_message(self.halves[side][ns], PoseArray)

    def positions(self, side: str, ns: int) -> Tensor:
        """Return the positions in one half of a state, (K, 2) m."""
        points = [(p.position.x, p.position.y) for p in self.poses(side, ns).poses]
        return torch.tensor(points, dtype=torch.float64).to(torch.float32)

    def sheep(self, ns: int) -> Tensor:
        """Return where the sheep were, (N, 2) m."""
        return self.positions('flock', ns)

    def shepherds(self, ns: int) -> Tensor:
        """Return where the shepherds were, (H, 2) m."""
        return self.positions('shepherds', ns)

    @property
    def stamps(self) -> list[int]:
        """Return the stamps of the states that were heard whole, ascending."""
        return sorted(self.halves['flock'].keys() & self.halves['shepherds'].keys())

    @property
    def last(self) -> int:
        """Return the last stamp, 0 if there is none."""
        return max(self.stamps, default=0)


class Graph:
    """A DDS domain with a probe, nodes in this process and processes."""

    def __init__(self, domain: int, folder: Path) -> None:
        """Start the probe."""
        self.domain, self.folder = domain, folder
        self.context = Context()
        rclpy.init(args=[], context=self.context, domain_id=domain)
        self.node = Node('probe', context=self.context, start_parameter_services=False)
        self.executor = SingleThreadedExecutor(context=self.context)
        self.executor.add_node(self.node)
        self.hosted: list[ShepherdNode] = []
        self.processes: list[Process] = []
        self._received: dict[tuple[str, Any], list[Any]] = {}

    def close(self) -> None:
        """End everything."""
        for process in self.processes:
            process.kill()
        self.executor.shutdown(timeout_sec=1.0)
        for node in [*self.hosted, self.node]:
            node.destroy_node()
        self.context.try_shutdown()

    # ---- who takes part ----

    def start(
        self, executable: str, *words: str, fresh: bool = False, **parameters: Any
    ) -> Process:
        """Start a process; words come after --ros-args."""
        return self.start_words(
            executable, ['--ros-args', *words, *words_of(parameters)], fresh=fresh
        )

    def start_words(self, executable: str, words: list[str], fresh: bool = False) -> Process:
        """Start a process with exactly these words."""
        output = self.folder / f'{len(self.processes)}_{executable}.txt'
        process = Process(executable, words, output, self.domain, fresh)
        self.processes.append(process)
        return process

    def host(self, executable: str, *words: str, **parameters: Any) -> Any:
        """Run the node of an executable in this process."""
        words = ('--ros-args', *words, *words_of(parameters))
        node = NODES[executable](context=self.context, cli_args=words, use_global_arguments=False)
        self.hosted.append(node)
        self.executor.add_node(node)
        return node

    def end(self, node: ShepherdNode) -> None:
        """End a node in this process."""
        self.hosted.remove(node)
        self.executor.remove_node(node)
        node.destroy_node()

    # ---- time ----

    def spin(self) -> None:
        """Run callbacks of this process for a moment."""
        self.executor.spin_once(timeout_sec=0.01)

    def until(
        self,
        condition: Callable[[], Any],
        what: str | Callable[[], str],
        seconds: float = DEADLINE,
    ) -> Any:
        """Spin until the condition is true; AssertionError with all output after the deadline."""

        def story() -> str:
            text = what if isinstance(what, str) else what()
            return '\n'.join([text, *map(str, self.processes)])

        return until(condition, story, seconds, self.spin)

    def idle(self, seconds: float) -> None:
        """Spin for a while, to see that something does not happen."""
        end = time.monotonic() + seconds
        while time.monotonic() < end:
            self.spin()

    def until_says(self, process: Process, pattern: str) -> re.Match[str]:
        """Spin until a process has written a line."""
        return self.until(lambda: process.says(pattern), f'{process.executable}: {pattern}')

    def until_nodes(self, *names: str) -> None:
        """Spin until nodes of these names are in the graph."""
        self.until(
            lambda: set(names) <= set(self.node.get_node_names()), f'nodes {", ".join(names)}'
        )

    # ---- what is said ----

    def collect(self, topic: str, kind: Any, qos: QoSProfile = RELIABLE) -> list[Any]:
        """Return the list into which messages of a topic will come."""
        received: list[Any] = []
        self.node.create_subscription(kind, topic, received.append, qos)
        return received

    def _common(self, topic: str, kind: Any, qos: QoSProfile) -> list[Any]:
        if (topic, kind) not in self._received:
            self._received[topic, kind] = self.collect(topic, kind, qos)
        return self._received[topic, kind]

    def track(self, namespace: str = '') -> Track:
        """Return the track into which states of the world will come."""
        track = Track()
        for side in track.halves:
            track.subscriptions.append(
                self.node.create_subscription(
                    PoseArray,
                    f'{namespace}/{side}/poses',
                    lambda raw, side=side: track.take(side, raw),
                    RELIABLE,
                    raw=True,
                )
            )
        return track

    def forget(self, track: Track) -> None:
        """Let no more states come into a track."""
        while track.subscriptions:
            self.node.destroy_subscription(track.subscriptions.pop())

    def listen_to_logs(self) -> None:
        """Collect /rosout from now on, for warnings()."""
        self._common('/rosout', Log, LATCHED)

    def warnings(self, pattern: str) -> list[str]:
        """Return warnings and errors in /rosout that match."""
        return [
            entry.msg
            for entry in self._common('/rosout', Log, LATCHED)
            if entry.level >= 30 and re.search(pattern, entry.msg)
        ]

    def status(self, part: str) -> DiagnosticStatus | None:
        """Return the last status on /diagnostics whose name has a part, None before."""
        found = None
        for message in self._common('/diagnostics', DiagnosticArray, RELIABLE):
            for status in message.status:
                found = status if part in status.name else found
        return found

    def until_status(self, part: str, pattern: str) -> DiagnosticStatus:
        """Spin until the status of a part has a message that matches; return it."""

        def found() -> DiagnosticStatus | None:
            status = self.status(part)
            return status if status and re.search(pattern, status.message) else None

        return self.until(found, f'{part!r} on /diagnostics says {pattern!r}')

    def clock(self) -> list[int]:
        """Return what /clock has said [ns], as it came."""
        return [nanoseconds(m.clock) for m in self._common('/clock', Clock, BEST_EFFORT)]

    # ---- what the probe says ----

    def publisher(
        self, topic: str, kind: Any, qos: QoSProfile = RELIABLE, readers: int = 1
    ) -> Publisher:
        """Return a publisher once so many subscribers have found it."""
        publisher = self.node.create_publisher(kind, topic, qos)
        self.until(
            lambda: publisher.get_subscription_count() >= readers, f'{topic} has {readers} readers'
        )
        return publisher

    def wait_for_future(self, future: Future, what: str) -> Any:
        """Return the result of a future."""
        self.until(future.done, what)
        return future.result()

    def call(self, name: str, kind: Any, request: Any) -> Any:
        """Return what a service answers."""
        client = self.node.create_client(kind, name)
        self.until(client.service_is_ready, f'service {name}')
        answer = self.wait_for_future(client.call_async(request), f'answer of {name}')
        self.node.destroy_client(client)
        return answer

    def trigger(self, name: str) -> str:
        """Return what a service without arguments answers."""
        answer = self.call(name, Trigger, Trigger.Request())
        assert answer.success, answer.message
        return str(answer.message)

    def set_parameter(self, node: str, name: str, value: Any) -> tuple[bool, str]:
        """Return whether a node has taken a new value of a parameter, and why not."""
        parameter = Parameter(name, value=value).to_parameter_msg()
        request = SetParameters.Request(parameters=[parameter])
        (result,) = self.call(f'{node}/set_parameters', SetParameters, request).results
        return result.successful, result.reason

    def reset(self, seed: int | None = None) -> str:
        """Return what flock_sim answers to a reset, with the next seed or a given one."""
        assert seed is None or self.set_parameter('flock_sim', 'seed', seed) == (True, '')
        return self.trigger('flock_sim/reset')

    def steps(self, n: int) -> str:
        """Return what flock_sim answers when it is asked for so many steps."""
        assert self.set_parameter('flock_sim', 'step_size', n) == (True, '')
        return self.trigger('flock_sim/step')


def twist(ns: int, x: float, y: float, frame_id: str = 'map') -> TwistStamped:
    """Return a command [m/s] that answers the state of a stamp."""
    message = TwistStamped()
    message.header.stamp, message.header.frame_id = stamp(ns), frame_id
    message.twist.linear.x, message.twist.linear.y = x, y
    return message


def rollout(
    controller: str, config: EnvConfig, seed: int = 0, episodes: int = 1, **options: Any
) -> tuple[list[WorldState], list[dict[str, Tensor]]]:
    """Return every state and its metrics, of episodes with seeds in a row, by env.step alone."""
    env = ShepherdEnv(config, 1, lidar=False)
    law = make_controller(controller, config.world, **options)
    states, metrics = [], []
    for episode in range(episodes):
        env.reset(seed + episode)
        memory = law.begin(env.perceived)
        states.append(env.state)
        metrics.append(env.metrics())
        for _ in range(config.world.episode_steps):
            command, memory = law.act(env.perceived, memory)
            info = env.step(command)[-1]
            states.append(info.get('final_state', env.state))
            metrics.append(info.get('final_metrics') or env.metrics())
    return [s.world(0) for s in states], [{k: v[0] for k, v in m.items()} for m in metrics]


def assert_same_states(
    track: Track, expected: list[WorldState], stamps: list[int] | None = None
) -> None:
    """Assert that exactly the expected states were heard (at these stamps), bit by bit."""
    stamps = track.stamps if stamps is None else stamps
    assert len(stamps) == len(expected)
    steps = {b - a for a, b in pairwise(stamps)}
    assert len(steps) <= 1, f'stamps are {steps} ns apart'
    for k, (ns, state) in enumerate(zip(stamps, expected, strict=True)):
        present = state.shepherds[state.shepherd_mask]
        assert torch.equal(track.sheep(ns), state.sheep), f'sheep of state {k}'
        assert torch.equal(track.shepherds(ns), present), f'shepherds of state {k}'
