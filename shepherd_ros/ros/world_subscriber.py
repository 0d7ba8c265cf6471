"""Subscriber of the world: poses of flock and shepherds paired by stamp, with goal and episode."""

from __future__ import annotations

from collections.abc import Callable
from functools import lru_cache, partial

import numpy as np
from shepherd_ros.ros.episode_subscriber import listen_to_episodes
from shepherd_ros.ros.node import ShepherdNode
from shepherd_ros.sim.state import WorldState
from shepherd_ros.sim.world import WorldConfig
from shepherd_ros.wire.decode import decode_poses, Vector
from shepherd_ros.wire.episode import Episode
from shepherd_ros.wire.topics import GOAL, GOAL_POSES, SHEEP_POSES, SHEPHERD_POSES
import torch
from torch import Tensor

LOCKSTEP_SILENCE_TIMEOUT = 3.0  # [s] without a state after which a world in lockstep is gone


def episode_and_world(text: str) -> tuple[Episode, WorldConfig]:
    """Return a message of the topic episode and its world; ConfigError if one is refused."""
    episode = Episode.from_json(text)
    return episode, WorldConfig.from_dict(episode.world)


@lru_cache(maxsize=4)  # nodes in one process receive the same bytes
def _decode_poses(raw: bytes) -> tuple[int, str, Tensor, Tensor, bool]:
    """Return stamp [ns], frame, positions (K, 2) m, headings (K, 2), whether they are finite."""
    ns, frame_id, xy, direction = decode_poses(raw)
    with np.errstate(all='ignore'):  # what float32 cannot hold is not finite
        position, heading = xy.astype(np.float32), direction.astype(np.float32)
    finite = bool(np.isfinite(position).all() and np.isfinite(heading).all())
    return ns, frame_id, torch.from_numpy(position), torch.from_numpy(heading), finite


class Listener:
    """
    Calls on_state(stamp_ns, true state, episode) for every complete state of the world.

    on_episode(episode, its world) comes before its first state. A state may come again with the
    same stamp: flock_sim repeats one without a response. A state older than the last one means
    that the simulator or a bag has restarted, and is passed on.
    """

    def __init__(
        self,
        node: ShepherdNode,
        on_state: Callable[[int, WorldState, Episode], None],
        on_episode: Callable[[Episode, WorldConfig], None] = lambda episode, world: None,
    ) -> None:
        """Subscribe; latched topics first, so that they are served before states."""
        self.node = node
        self.on_state, self.on_episode = on_state, on_episode
        self.episode: Episode | None = None
        self.goal: Tensor | None = None
        self.goal_moves = False  # a state then needs the goal of its stamp
        self.states = 0
        self.last_state_time = node.wall()  # when the last state came
        self._poses: dict[str, tuple[int, Tensor, Tensor]] = {}
        self._constants: dict[str, Tensor] = {}  # what all states of the episode share
        listen_to_episodes(node, episode_and_world, self._on_episode)
        node.listen(GOAL, self._on_goal)
        for topic in (GOAL_POSES, SHEEP_POSES, SHEPHERD_POSES):
            node.listen(topic, partial(self._on_poses, topic), decode=_decode_poses)

    def silence(self) -> str:
        """Return a message if no state arrives, with the topic's publishers, else ''."""
        if self.states == 0:
            return 'no state of the world heard yet'
        waited = self.node.wall() - self.last_state_time
        lockstep = self.episode is not None and self.episode.mode == 'lockstep'
        if (
            not lockstep or waited < LOCKSTEP_SILENCE_TIMEOUT
        ):  # in lockstep it is shown again each second at least
            return ''
        return f'no state of the world for {waited:.0f} s: {self.node.sourced(SHEEP_POSES)}'

    def _on_episode(self, content: tuple[Episode, WorldConfig]) -> None:
        episode, world = content
        self.episode = episode
        self._constants = {
            'seed': torch.tensor(episode.seed),
            'sheep_mask': torch.ones(episode.n_sheep, dtype=torch.bool),
            'shepherd_mask': torch.ones(episode.n_shepherds, dtype=torch.bool),
            'goal_radius': torch.tensor(episode.goal_radius, dtype=torch.float32),
        }
        self.goal_moves = world.goal_speed > 0
        self.on_episode(episode, world)
        self._pair()

    def _on_goal(self, pose: Vector) -> None:
        if self._known_frame(GOAL, pose.frame_id):
            goal = torch.tensor(pose.xy, dtype=torch.float32)
            if goal.isfinite().all():
                self.goal = goal
                self._pair()
            else:
                self.node.get_logger().warning(
                    f'{GOAL} is {pose.x}, {pose.y}: expected finite numbers, ignored',
                    throttle_duration_sec=5.0,
                )

    def _on_poses(self, topic: str, poses: tuple[int, str, Tensor, Tensor, bool]) -> None:
        ns, frame_id, position, heading, finite = poses
        if not self._known_frame(topic, frame_id):
            return
        if not finite:
            self.node.get_logger().warning(
                f'{topic} at {ns * 1e-9:.3f} s has a NaN or infinite pose: state ignored',
                throttle_duration_sec=5.0,
            )
            return
        self._poses[topic] = (ns, position, heading)
        self._pair()

    def _known_frame(self, topic: str, frame_id: str) -> bool:
        if frame_id == self.node.frame_id:
            return True
        self.node.get_logger().warning(
            f'{topic} is in frame {frame_id!r}, expected {self.node.frame_id!r}: ignored; '
            'set parameter frame_id of both nodes to the same name',
            throttle_duration_sec=5.0,
        )
        return False

    def _pair(self) -> None:
        """Call on_state() if all poses have the same stamp and its episode is known."""
        episode, goal = self.episode, self.goal
        needed = {SHEEP_POSES, SHEPHERD_POSES} | ({GOAL_POSES} if self.goal_moves else set())
        if not needed <= self._poses.keys() or episode is None or goal is None:
            return
        ns, sheep, heading = self._poses[SHEEP_POSES]
        _, shepherds, _ = self._poses[SHEPHERD_POSES]
        if any(self._poses[topic][0] != ns for topic in needed) or not episode.has(ns):
            return
        destination = goal
        if self.goal_moves:
            if len(self._poses[GOAL_POSES][1]) != 2:
                return
            goal, destination = self._poses[GOAL_POSES][1]
        if len(sheep) != episode.n_sheep or len(shepherds) != episode.n_shepherds:
            return
        self._poses.clear()
        self.states, self.last_state_time = self.states + 1, self.node.wall()
        state = WorldState(
            step=torch.tensor(episode.step_of(ns)),
            sheep=sheep,
            heading=heading,
            shepherds=shepherds,
            goal=goal,
            destination=destination,
            **self._constants,
        )
        self.on_state(ns, state, episode)
