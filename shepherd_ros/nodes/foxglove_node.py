"""The foxglove node: the graph over the protocol that Foxglove and Lichtblick speak."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable
from functools import partial
import re
from typing import Any

from diagnostic_msgs.msg import DiagnosticStatus
import foxglove
from foxglove.websocket import Capability, ClientChannel, ServerListener, StatusLevel
from rclpy.publisher import Publisher
from shepherd_ros.config import ConfigError
from shepherd_ros.nodes.foxglove_channels import CDR, FoxgloveChannels
from shepherd_ros.nodes.foxglove_services import FoxgloveServices
from shepherd_ros.ros.node import message_type, OK, ShepherdNode, WARN
from shepherd_ros.ros.runtime import run
from shepherd_ros.wire.contract import known

GRAPH_LOOK_PERIOD = 0.5  # [s] between two looks at the graph
WORK_PERIOD = 0.02  # [s] after which what a client asks for is done at the latest
LOOPBACK = ('127.0.0.1', 'localhost', '::1')
INTERNAL = re.compile(r'/_|/.*/_')  # hidden names, as ros2cli hides them
PARAMETER_TYPES = 'rcl_interfaces/'  # types of services of parameters, which are not offered


class FoxgloveNode(ShepherdNode):
    """Serves topics as they are, in CDR; what clients may do beside looking is a parameter."""

    def __init__(self, **kwargs: Any) -> None:
        """Read what is shown and allowed."""
        super().__init__('foxglove', **kwargs)
        self.host = self.option('host', '127.0.0.1', 'address to listen at; all have 0.0.0.0')
        self.port = self.option('port', 8765, 'port; 0 takes a free one', low=0, high=65535)
        topics = self.option('topics', '.*', 'regular expression of the topics that are shown')
        services = self.option(
            'services', False, 'whether clients may call services: any web page could, too'
        )
        publish = self.option(
            'publish', False, 'whether clients may publish what topics.yaml leaves to users'
        )
        try:
            self.shown = re.compile(topics)
        except re.error as error:
            raise ConfigError(
                f'topics is {topics!r} ({error}): expected a regular expression'
            ) from None
        timed = self.get_parameter('use_sim_time').value
        allowed = {'ConnectionGraph': True, 'Services': services, 'ClientPublish': publish}
        self.allowed = [name for name, on in (allowed | {'Time': timed}).items() if on]
        self.jobs: deque[Callable[[], None]] = deque()  # of the server's threads, for ours
        self.outputs: dict[tuple[int, int], Publisher] = {}  # by client and channel of the client
        self.graph_shown = False  # whether a client asks for the graph
        self.context_of_server = foxglove.Context()
        self.channels = FoxgloveChannels(self, self.context_of_server)

    def serve(self) -> None:
        """Start the server; ConfigError where the address is not to be had."""
        try:
            self.server = foxglove.start_server(
                name=f'shepherd_ros {self.get_fully_qualified_name()}',
                host=self.host, port=self.port, server_listener=FoxgloveListener(self),
                capabilities=[getattr(Capability, name) for name in self.allowed],
                supported_encodings=[CDR], context=self.context_of_server,
            )  # fmt: skip
        except Exception as error:
            raise ConfigError(
                f'host {self.host}, port {self.port} cannot be listened at ({error}): expected '
                'an address of this host and a free port; port 0 takes a free one'
            ) from None
        self.callable = FoxgloveServices(self, self.server)
        if 'Time' in self.allowed:
            self.listen('/clock', self.server.broadcast_time)
        address = f'ws://{self.host}:{self.server.port}'
        self.get_logger().info(f'serving {address}: open it in Foxglove or Lichtblick')
        if self.host not in LOOPBACK:
            self.get_logger().warning(f'{address} is open to all that reach this host')
        self.timer(WORK_PERIOD, self.work)
        self.timer(GRAPH_LOOK_PERIOD, self.look)

    def work(self) -> None:
        """Do what clients have asked for since the last time, in their order."""
        while self.jobs:
            self.jobs.popleft()()

    def look(self) -> None:
        """Show what is in the graph now."""
        found = self.get_topic_names_and_types()
        names = [name for name, _ in found if self.shown.search(name) and not INTERNAL.match(name)]
        self.channels.look(names)
        if self.graph_shown:
            self.server.publish_connection_graph(self.connections())
        if 'Services' in self.allowed:
            offered = {
                name: kinds[0]
                for name, kinds in self.get_service_names_and_types()
                if not INTERNAL.match(name) and not kinds[0].startswith(PARAMETER_TYPES)
            }
            self.callable.look(offered)

    def connections(self) -> foxglove.ConnectionGraph:
        """Return who publishes and who subscribes to the topics that are shown."""
        graph = foxglove.ConnectionGraph()
        for name in self.channels.topics:
            graph.set_published_topic(name, self.publishers_of(name))
            ends = self.get_subscriptions_info_by_topic(name)
            readers = {f'{end.node_namespace.rstrip("/")}/{end.node_name}' for end in ends}
            graph.set_subscribed_topic(name, sorted(readers))
        return graph

    def advertise_client(self, client: int, channel: int, topic: str, kind: str) -> None:
        """Publish for a client, if the topic is one that users may publish."""
        row = known(topic)
        if row is None or 'user' not in row.topic.publisher or kind not in row.types:
            words = f'{topic} ({kind}) is not for clients: expected a topic that users publish'
            self.get_logger().warning(words)
            self.server.publish_status(words, StatusLevel.Error)
            return
        self.outputs[client, channel] = self.create_publisher(message_type(kind), topic, 1)

    def unadvertise_client(self, client: int, channel: int) -> None:
        """Publish for a client no more."""
        publisher = self.outputs.pop((client, channel), None)
        if publisher is not None:
            self.destroy_publisher(publisher)

    def publish_for(self, client: int, channel: int, data: bytes) -> None:
        """Publish what a client says, in CDR."""
        publisher = self.outputs.get((client, channel))
        if publisher is not None:
            publisher.publish(data)

    def diagnose(self) -> list[DiagnosticStatus]:
        """Return what is shown, and to how many."""
        topics = self.channels.topics
        refused = self.channels.refused
        clients = {client for topic in topics.values() for client in topic.clients}
        level, message = OK, f'{len(topics)} topics, {len(clients)} clients'
        if refused:
            level, message = WARN, 'not shown: ' + ', '.join(sorted(refused))
        counts = {'topics': len(topics), 'clients': len(clients)}
        return [self.status('server', level, message, **counts, forwarded=self.channels.forwarded)]

    def end(self) -> int:
        """Close the server."""
        self.server.stop()
        return 0


class FoxgloveListener(ServerListener):
    """Hands what clients ask for from the server's threads to that of the node."""

    def __init__(self, node: FoxgloveNode) -> None:
        """Hear the clients of a node's server."""
        self.node = node

    def on_subscribe(self, client: Any, channel: Any) -> None:
        """Forward a topic to a client from now on."""
        self.node.jobs.append(partial(self.node.channels.subscribe, channel.topic, client.id))

    def on_unsubscribe(self, client: Any, channel: Any) -> None:
        """Forward a topic to a client no more."""
        self.node.jobs.append(partial(self.node.channels.unsubscribe, channel.topic, client.id))

    def on_client_advertise(self, client: Any, channel: ClientChannel) -> None:
        """Let a client publish a topic."""
        about = channel.id, channel.topic, channel.schema_name
        self.node.jobs.append(partial(self.node.advertise_client, client.id, *about))

    def on_client_unadvertise(self, client: Any, client_channel_id: int) -> None:
        """End what a client publishes."""
        self.node.jobs.append(partial(self.node.unadvertise_client, client.id, client_channel_id))

    def on_message_data(self, client: Any, client_channel_id: int, data: bytes) -> None:
        """Publish a message of a client."""
        self.node.jobs.append(partial(self.node.publish_for, client.id, client_channel_id, data))

    def on_connection_graph_subscribe(self) -> None:
        """Show who publishes and who subscribes from now on."""
        self.node.graph_shown = True

    def on_connection_graph_unsubscribe(self) -> None:
        """Show who publishes and who subscribes no more."""
        self.node.graph_shown = False


def main() -> int:
    """Serve the graph to Foxglove and Lichtblick, read-only unless parameters say otherwise."""
    return run(FoxgloveNode, 'foxglove', main.__doc__ or '')
