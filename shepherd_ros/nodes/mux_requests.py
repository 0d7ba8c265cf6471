"""Requests to mux: services and topics that select a source, and locks."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
import re
from typing import Any

from shepherd_ros.config import ConfigError
from shepherd_ros.nodes.command_mux import AUTO, CommandMux
from shepherd_ros.nodes.mux_parameters import MuxOptions
from shepherd_ros.ros.node import ShepherdNode
from shepherd_ros.wire.topics import lock_topic, SELECT, SHEPHERD
from std_srvs.srv import SetBool, Trigger


class MuxRequests:
    """
    Offers the services, hears mux/select and the locks, and calls on_change() after each.

    mux/select/SOURCE and mux/lock are for all shepherds, shepherd_<h>/mux/SOURCE and
    shepherd_<h>/mux/lock for one.
    """

    def __init__(
        self,
        node: ShepherdNode,
        mux: CommandMux,
        options: MuxOptions,
        on_change: Callable[[], None],
    ) -> None:
        """Create the services for all shepherds; begin() creates those for single ones."""
        self.node, self.mux, self.on_change = node, mux, on_change
        self.names = [AUTO, *mux.by_name]
        self.services: list[list[Any]] = []  # by shepherd
        self._create('mux/select', 'mux/lock', None)
        node.listen(SELECT, self.on_select)
        for name, topic in options.lock_topics.items():
            taker = partial(self.on_lock, name)
            node.listen(lock_topic(name), taker, name=topic)

    def begin(self, n_shepherds: int) -> None:
        """Make ready for the team of an episode."""
        while len(self.services) > n_shepherds:
            for service in self.services.pop():
                self.node.destroy_service(service)
        for h in range(len(self.services), n_shepherds):
            room = f'{SHEPHERD.format(h=h)}/mux'
            self.services.append(self._create(room, f'{room}/lock', h))

    def _create(self, room: str, lock: str, shepherd: int | None) -> list[Any]:
        """Return the services of one shepherd, or of all."""
        made = [
            self.node.create_service(
                Trigger, f'{room}/{name}', partial(self.select, name, shepherd)
            )
            for name in self.names
        ]
        locker = partial(self.lock, shepherd)
        return [*made, self.node.create_service(SetBool, lock, locker)]

    def select(self, name: str, shepherd: int | None, request: Any, response: Any) -> Any:
        """Let a source drive from the next state on; auto: that of highest priority."""
        return self._answer(
            response,
            lambda: self.mux.select(name, shepherd, self.node.wall()),
            f'{name} is selected for {_target(shepherd)}',
        )

    def lock(self, shepherd: int | None, request: Any, response: Any) -> Any:
        """Publish zero until it is called with false."""
        return self._answer(
            response,
            lambda: self.mux.lock(request.data, shepherd),
            f'{_target(shepherd)}: {"locked" if request.data else "not locked"}',
        )

    def _answer(self, response: Any, change: Callable[[], None], text: str) -> Any:
        """Return the response to a request that changes what drives."""
        try:
            self._require_episode()
            change()
        except ConfigError as error:
            response.success, response.message = False, str(error)
            return response
        response.success, response.message = True, text
        self.node.get_logger().info(text)
        self.on_change()
        return response

    def _require_episode(self) -> None:
        if not self.mux.n_shepherds:
            raise ConfigError('no episode has been heard yet: start flock_sim')

    def on_select(self, text: str) -> None:
        """Take a text such as keys, 1 keys or 1 auto."""
        match = re.fullmatch(r'\s*(?:(?:shepherd_)?(\d{1,6})\s+)?(\w+)\s*', text)
        try:
            if match is None:
                raise ConfigError(
                    f'{SELECT} is {text!r:.60}: expected a source or auto, such as keys, or with '
                    'a shepherd before it, such as 1 keys'
                )
            self._require_episode()
            shepherd = None if match[1] is None else int(match[1])
            self.mux.select(match[2], shepherd, self.node.wall())
        except ConfigError as error:
            self.node.get_logger().warning(f'{error}: ignored')
            return
        self.node.get_logger().info(f'{match[2]} is selected for {_target(shepherd)}')
        self.on_change()

    def on_lock(self, name: str, on: bool) -> None:
        """Take a message of a lock."""
        self.mux.receive_lock(name, on, self.node.wall())
        self.on_change()


def _target(shepherd: int | None) -> str:
    """Return the name of one shepherd, or of all."""
    return 'all shepherds' if shepherd is None else SHEPHERD.format(h=shepherd)
