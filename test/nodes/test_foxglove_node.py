"""The foxglove node against Foxglove's own decoders, and what its clients may do."""

from __future__ import annotations

import asyncio
from collections.abc import Awaitable, Callable, Iterator
import json
from pathlib import Path
import shutil
import struct
import subprocess
import sys
from threading import Thread
from typing import Any

from nodes.process import DEADLINE, Graph, LATCHED, Process
import pytest
from rclpy.serialization import deserialize_message, serialize_message
from shepherd_ros.ros.node import message_type
from std_msgs.msg import String
from std_srvs.srv import SetBool, Trigger
from tornado.websocket import websocket_connect, WebSocketClientConnection

SOURCES = Path(__file__).parent / 'foxglove_decoders'
PROTOCOL = 'foxglove.sdk.v1'
TEAM, SHEEP, RAYS = 2, 5, 512
pytestmark = [
    pytest.mark.system,
    pytest.mark.xdist_group('foxglove'),  # one stack for all
]


class Client:
    """A client of the protocol: what it was told, by kind, and how to ask."""

    def __init__(self, connection: WebSocketClientConnection) -> None:
        """Read in the background until the server closes."""
        self.connection = connection
        self.channels: dict[str, dict[str, Any]] = {}
        self.services: dict[str, dict[str, Any]] = {}
        self.replies: list[dict[str, Any]] = []
        self.messages: dict[str, list[bytes]] = {}
        self.responses: list[bytes] = []
        self.reading = asyncio.ensure_future(self.read())

    async def read(self) -> None:
        """Sort what comes."""
        while (message := await self.connection.read_message()) is not None:
            if isinstance(message, str):
                reply = json.loads(message)
                self.replies.append(reply)
                self.channels |= {c['topic']: c for c in reply.get('channels', ())}
                if reply['op'] == 'advertiseServices':
                    self.services |= {s['name']: s for s in reply['services']}
            elif message[0] == 1:
                (number,) = struct.unpack_from('<I', message, 1)
                self.messages[list(self.channels)[number]].append(message[13:])
            elif message[0] == 3:
                self.responses.append(message[1:])

    def ask(self, **request: Any) -> None:
        """Send a request."""
        self.connection.write_message(json.dumps(request))

    def subscribe(self, topic: str) -> None:
        """Ask for a topic; the number of the subscription is its place in the list."""
        number = list(self.channels).index(topic)
        self.messages[topic] = []
        channel = self.channels[topic]['id']
        self.ask(op='subscribe', subscriptions=[{'id': number, 'channelId': channel}])

    def call(self, service: str, request: Any) -> None:
        """Call a service in CDR."""
        head = struct.pack('<BIII', 2, self.services[service]['id'], 7, 3)
        self.connection.write_message(head + b'cdr' + serialize_message(request), binary=True)

    def response(self, kind: Any) -> Any:
        """Return the first response."""
        (size,) = struct.unpack_from('<I', self.responses[0], 8)
        return deserialize_message(self.responses[0][12 + size :], kind.Response)

    def ops(self, op: str) -> list[dict[str, Any]]:
        """Return what was told of a kind."""
        return [reply for reply in self.replies if reply['op'] == op]


async def connected(address: str) -> Client:
    """Return a client of a server."""
    return Client(await websocket_connect(address, subprotocols=[PROTOCOL]))


async def until(condition: Callable[[], Any], what: str) -> None:
    """Wait for a condition; AssertionError after the deadline."""
    for _ in range(int(DEADLINE / 0.02)):
        if condition():
            return
        await asyncio.sleep(0.02)
    raise AssertionError(f'not within {DEADLINE} s: {what}')


def talk(graph: Graph, conversation: Callable[[], Awaitable[Any]]) -> Any:
    """Return what a conversation with servers returns, while the probe goes on."""
    results: list[Any] = []

    def converse() -> None:
        try:
            results.append(asyncio.run(conversation()))
        except BaseException as error:
            results.append(error)

    thread = Thread(target=converse)
    thread.start()
    graph.until(lambda: not thread.is_alive(), 'the conversation ends', 3 * DEADLINE)
    if isinstance(results[0], BaseException):
        raise results[0]
    return results[0]


def address_of(graph: Graph, server: Process) -> str:
    """Return where a server listens."""
    return graph.until_says(server, r'serving (ws://\S+):')[1]


@pytest.fixture(scope='module')
def servers(shared_graph: Graph) -> Iterator[dict[str, str]]:
    """Return the addresses of two servers of one stack: read-only, and with all allowed."""
    graph = shared_graph
    everything = {'services': True, 'publish': True}
    started = {
        'closed': graph.start('foxglove', '-r', '__node:=closed', port=0),
        'open': graph.start('foxglove', '-r', '__node:=open', port=0, **everything),
    }
    graph.start('lidar', shepherd_ids=list(range(TEAM)))
    graph.start('metrics')
    graph.start('pierson')
    graph.start('flock_sim', n_sheep=SHEEP, n_shepherds=TEAM, episode_steps=10**5, rate=50.0)
    track = graph.track()
    graph.until(lambda: len(track.stamps) > 2, 'the world moves')
    graph.forget(track)
    yield {name: address_of(graph, server) for name, server in started.items()}
    for server in started.values():
        assert server.stop() == 0, server


@pytest.fixture(scope='module')
def decoders() -> Path:
    """Return the folder with Foxglove's decoders, installed beside the other packages once."""
    folder = Path(sys.prefix) / 'foxglove_decoders'
    wanted = (SOURCES / 'package.json').read_text(encoding='utf-8')
    stored = folder / 'package.json'
    if not (folder / 'done').is_file() or stored.read_text(encoding='utf-8') != wanted:
        shutil.rmtree(folder, ignore_errors=True)
        folder.mkdir()
        stored.write_text(wanted, encoding='utf-8')
        words = ['npm', 'install', '--no-package-lock', '--no-audit', '--no-fund']
        subprocess.run(words, cwd=folder, check=True, capture_output=True, timeout=100)
        (folder / 'done').touch()
    shutil.copy(SOURCES / 'read.cjs', folder)
    return folder


def test_foxgloves_decoders_read_every_topic(
    shared_graph: Graph, servers: dict[str, str], decoders: Path
) -> None:
    topics = [
        '/clock', '/diagnostics', '/episode', '/flock/poses', '/goal', '/markers',
        '/metrics/flock_spread', '/metrics/fraction_in_goal', '/rosout', '/shepherds/poses',
        *(f'/shepherd_{h}/cmd_vel' for h in range(TEAM)),
        *(f'/shepherd_{h}/scan/{c}' for h in range(TEAM) for c in ('goal', 'sheep', 'shepherds')),
    ]  # fmt: skip
    command = ['node', 'read.cjs', servers['closed'], *topics]
    done = subprocess.run(command, cwd=decoders, capture_output=True, text=True, timeout=150)
    read = json.loads(done.stdout)
    assert (read['error'], read['missing']) == ('', []), shared_graph.processes[0]
    result = {topic: about['message'] for topic, about in read['topics'].items()}
    assert len(result['/flock/poses']['poses']) == SHEEP
    assert len(result['/shepherds/poses']['poses']) == TEAM
    assert len(result['/shepherd_1/scan/sheep']['ranges']) == RAYS
    assert json.loads(result['/episode']['data'])['n_sheep'] == SHEEP
    assert result['/shepherd_0/cmd_vel']['header']['frame_id'] == 'map'
    graph = dict(shared_graph.node.get_topic_names_and_types())
    shown = {topic: [about['type']] for topic, about in read['topics'].items()}
    assert {topic: graph[topic] for topic in shown} == shown


def test_a_latched_topic_reaches_the_second_and_the_late_client_once(
    shared_graph: Graph, servers: dict[str, str]
) -> None:
    received = shared_graph.collect('/episode', String, LATCHED)

    async def conversation() -> list[list[bytes]]:
        clients = []
        for _ in range(3):
            client = await connected(servers['closed'])
            await until(lambda c=client: '/episode' in c.channels, 'the topic is shown')
            client.subscribe('/episode')
            await until(lambda c=client: c.messages['/episode'], 'the episode comes')
            clients.append(client)
        await asyncio.sleep(0.3)  # a second one would come by then
        return [client.messages['/episode'] for client in clients]

    counts = talk(shared_graph, conversation)
    shared_graph.until(lambda: received, 'the probe hears the episode')
    for messages in counts:
        (raw,) = messages
        assert deserialize_message(raw, String) == received[0]


def test_services_are_called_where_allowed_and_refused_elsewhere(
    shared_graph: Graph, servers: dict[str, str]
) -> None:
    pause = '/flock_sim/pause'

    async def conversation() -> tuple[Client, Client]:
        allowed, refused = [await connected(servers[name]) for name in ('open', 'closed')]
        await until(lambda: pause in allowed.services, 'the service is offered')
        allowed.call(pause, SetBool.Request(data=True))
        await until(lambda: allowed.responses, 'the response comes')
        allowed.call('/flock_sim/step', Trigger.Request())
        await until(lambda: len(allowed.responses) == 2, 'a request without fields is taken')
        refused.services = allowed.services
        refused.call(pause, SetBool.Request(data=False))
        await until(lambda: refused.ops('serviceCallFailure'), 'the refusal is told')
        allowed.call(pause, SetBool.Request(data=False))
        await until(lambda: len(allowed.responses) == 3, 'the world goes on')
        return allowed, refused

    allowed, refused = talk(shared_graph, conversation)
    assert allowed.response(SetBool).success
    assert not refused.responses
    assert 'services' not in refused.ops('serverInfo')[0]['capabilities']
    assert 'services' in allowed.ops('serverInfo')[0]['capabilities']
    assert not [name for name in allowed.services if 'set_parameters' in name]


def test_clients_publish_what_the_contract_leaves_to_users(
    shared_graph: Graph, servers: dict[str, str]
) -> None:
    kind = message_type('geometry_msgs/msg/PoseStamped')
    goal = kind()
    goal.header.frame_id = 'map'
    goal.pose.position.x = 3.0
    goal.pose.orientation.w = 1.0
    shown = shared_graph.collect('/goal', kind, LATCHED)

    def advertised(number: int, topic: str) -> dict[str, Any]:
        schema = {'schemaName': 'geometry_msgs/msg/PoseStamped', 'schema': ''}
        return {'id': number, 'topic': topic, 'encoding': 'cdr', **schema}

    async def conversation() -> Client:
        client = await connected(servers['open'])
        await until(lambda: client.channels, 'topics are shown')
        client.ask(op='advertise', channels=[advertised(1, '/goal_pose')])
        client.ask(op='advertise', channels=[advertised(2, '/goal')])
        await until(lambda: client.ops('status'), 'the second is refused')
        for _ in range(50):
            if any(message.pose.position.x == 3.0 for message in shown):
                break
            data = b'\1' + struct.pack('<I', 1) + serialize_message(goal)
            client.connection.write_message(data, binary=True)
            await asyncio.sleep(0.2)
        return client

    client = talk(shared_graph, conversation)
    assert shown[-1].pose.position.x == 3.0
    (status,) = client.ops('status')
    assert '/goal (geometry_msgs/msg/PoseStamped) is not for clients' in status['message']


@pytest.mark.parametrize(
    ('parameters', 'words'),
    [({'topics': '('}, r"topics is '\('"), ({'host': '203.0.113.1'}, 'host 203.0.113.1, port')],
)
def test_what_cannot_be_served_ends_in_words(
    shared_graph: Graph, parameters: dict[str, Any], words: str
) -> None:
    process = shared_graph.start('foxglove', '-r', '__node:=wrong', **parameters)
    assert process.wait() == 2
    assert process.says(words), process
    assert 'Traceback' not in process.text
