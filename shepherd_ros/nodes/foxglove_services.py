"""Services of the graph, called by clients of the Foxglove protocol."""

from __future__ import annotations

from functools import partial
from threading import Event
from typing import Any

from foxglove import MessageSchema, Schema, Service, ServiceRequest, ServiceSchema
from rclpy.client import Client
from rclpy.node import Node
from rclpy.serialization import deserialize_message, serialize_message
from shepherd_ros.nodes.foxglove_channels import CDR, ROS2MSG
from shepherd_ros.ros.node import message_type
from shepherd_ros.wire.schemas import installed_text, nested_text

CALL_TIMEOUT = 5.0  # [s] for a service to respond
EMPTY = 4  # bytes of a message without fields: the header of CDR


def part_schema(kind: str, part: str) -> MessageSchema:
    """Return the text of a service's Request or Response; kind is such as std_srvs/srv/SetBool."""
    name = f'{kind}_{part}'
    text = nested_text(name, installed_text)
    return MessageSchema(
        encoding=CDR, schema=Schema(name=name, encoding=ROS2MSG, data=text.encode())
    )


class FoxgloveServices:
    """Services that clients may call, as they come and go."""

    def __init__(self, node: Node, server: Any) -> None:
        """Offer none yet; server is a foxglove.WebSocketServer."""
        self.node, self.server = node, server
        self.clients: dict[str, tuple[str, Client]] = {}
        self.refused: set[str] = set()

    def look(self, services: dict[str, str]) -> None:
        """Offer these services, types by name, and no others."""
        removed = [name for name, (kind, _) in self.clients.items() if services.get(name) != kind]
        for name in removed:
            self.node.destroy_client(self.clients.pop(name)[1])
        if removed:
            self.server.remove_services(removed)
        offered = []
        for name, kind in services.items():
            if name in self.clients or name in self.refused:
                continue
            try:
                schema = ServiceSchema(
                    name=kind,
                    request=part_schema(kind, 'Request'),
                    response=part_schema(kind, 'Response'),
                )
                client = self.node.create_client(message_type(kind), name)
            except (AttributeError, ImportError, FileNotFoundError, ValueError) as error:
                self.refused.add(name)
                self.node.get_logger().warning(f'{name} cannot be called: {error}')
                continue
            self.clients[name] = kind, client
            offered.append(Service(name, schema=schema, handler=partial(self.call, client)))
        if offered:
            self.server.add_services(offered)

    def call(self, client: Client, request: ServiceRequest) -> bytes:
        """Return the response of a service, in CDR; RuntimeError in words if there is none."""
        kind: Any = client.srv_type
        payload, done = bytes(request.payload), Event()
        if len(payload) == EMPTY:
            payload += bytes(1)  # rclpy's message without fields has one byte
        try:
            message = deserialize_message(payload, kind.Request)
        except Exception as error:
            raise RuntimeError(
                f'the request has {len(request.payload)} bytes that are no {kind.__name__} '
                f'({error}): expected it in CDR'
            ) from None
        future = client.call_async(message)
        future.add_done_callback(lambda _: done.set())
        if not done.wait(CALL_TIMEOUT):
            client.remove_pending_request(future)
            raise RuntimeError(f'no response within {CALL_TIMEOUT:g} s: is its node running?')
        return bytes(serialize_message(future.result()))
