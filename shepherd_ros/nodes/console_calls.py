"""Calls of services from the console's thread, answered there, with a time-out."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from rclpy.task import Future
from shepherd_ros.console.page_server import PageServer
from shepherd_ros.ros.node import ShepherdNode

ANSWER_LIMIT = 5.0  # [s] for an answer
Done = Callable[[Any, str], None]


class ServiceCalls:
    """Clients of services, made once; whoever calls is told the response, or why there is none."""

    def __init__(self, node: ShepherdNode, services: dict[str, Any]) -> None:
        """Create a client for each service by its name."""
        self.node = node
        self.clients: dict[str, Any] = {}
        for name, kind in services.items():
            self.add(name, kind)

    def add(self, name: str, kind: Any) -> None:
        """Create a client for one more service; in the executor's thread."""
        self.clients[name] = self.node.create_client(kind, name)

    def ready(self, name: str) -> bool:
        """Return whether a service is there."""
        return bool(self.clients[name].service_is_ready())

    def call(self, server: PageServer, name: str, request: Any, done: Done) -> None:
        """Call a service; done(response, '') or done(None, why) is called in the server's loop."""
        client = self.clients[name]
        if not client.service_is_ready():
            done(None, f'there is no service {client.srv_name}: start {name.partition("/")[0]}')
            return
        future = client.call_async(request)
        waiting = [done]

        def finish(response: Any, reason: str) -> None:
            if waiting:
                waiting.pop()(response, reason)

        def expire() -> None:
            if waiting:
                client.remove_pending_request(future)
                finish(None, f'{client.srv_name} has not answered within {ANSWER_LIMIT:g} s')

        def answered(future: Future) -> None:
            server.call(finish, future.result(), '')

        future.add_done_callback(answered)
        server.loop.call_later(ANSWER_LIMIT, expire)
