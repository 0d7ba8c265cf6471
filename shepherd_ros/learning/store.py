"""Store of the observations of a rollout, each reading kept once for all frames that show it."""

from __future__ import annotations

from typing import Any

from shepherd_ros.learning.state_critic import FEATURES, state_features
from shepherd_ros.policy.policy import Policy
from shepherd_ros.sim.frames import Frames
from shepherd_ros.sim.rollout import Moment
import torch
from torch import Tensor


class Store:
    """
    Readings of groups of worlds, a row for each decision; windows of frames move over the rows.

    Readings are scaled, in the dtype of the computation; stacks of frames are assembled when they
    are read, and do not reach over the start of an episode.
    """

    STATE = ('store', 'first', 'begun', 'mask', 'features')

    def __init__(
        self,
        policy: Policy,
        frames: Frames,
        groups: int,
        worlds: int,
        team: int,
        decisions: int,
        dtype: torch.dtype,
        features: bool = False,
    ) -> None:
        """
        Create an empty store for a number of decisions, on the device of the policy.

        features: with those of a critic on the true state.
        """
        self.policy, self.decisions, device = policy, decisions, policy.device
        self.stack = frames
        self.before = frames.window - 1  # rows kept from earlier decisions
        shape = (groups, self.before + decisions + 1, worlds, team)
        scan = policy.config.lidar.layout.shape
        self.store = torch.zeros(*shape, *scan, dtype=dtype, device=device)
        self.first = torch.zeros(shape, dtype=torch.int64, device=device)
        # row in which the episode of a world began
        self.begun = torch.zeros(shape[:3], dtype=torch.int64, device=device)
        self.mask = torch.zeros(shape, dtype=torch.bool, device=device)
        width = len(FEATURES) if features else 0
        self.features = torch.zeros(*shape, width, device=device)

    def put(self, group: int, row: int, moment: Moment, starts: bool | Tensor = False) -> None:
        """Store the observations of a group in a row; starts (B,): episodes begin there."""
        self.store[group, row] = self.policy.scale(moment.ranges).to(self.store.dtype)
        self.first[group, row] = self.policy.first_ray(moment.ranges)
        starting = torch.as_tensor(starts, device=self.begun.device)
        self.begun[group, row] = torch.where(starting, row, self.begun[group, row - 1])
        self.mask[group, row] = moment.state.shepherd_mask
        if self.features.shape[-1]:
            self.features[group, row] = state_features(moment)

    def present(self, row: int, groups: Tensor) -> tuple[Tensor, Tensor, Tensor, Tensor]:
        """Return four indices (n,) of the present shepherds of some groups in a row."""
        g, world, shepherd = self.mask[groups, row].nonzero().unbind(dim=-1)
        return groups[g], torch.full_like(g, row), world, shepherd

    def rows_of(self, g: Tensor, row: Tensor, world: Tensor, shepherd: Tensor) -> Tensor:
        """Return the rows (n, K) of the flat store that hold the frames of n decisions."""
        frame_rows = self.stack.rows(row, self.begun[g, row, world])
        _, rows, worlds, team = self.mask.shape
        return ((g[:, None] * rows + frame_rows) * worlds + world[:, None]) * team + shepherd[
            :, None
        ]

    def frames(self, rows: Tensor) -> Tensor:
        """Return the frames (n, K, C, R) in rows (n, K) of the flat store."""
        return self.store.flatten(0, 3)[rows]

    def inputs(self, rows: Tensor, first: Tensor) -> Tensor:
        """Return the network's input (n, D, L) for rows (n, K) of the flat store."""
        return self.policy.arrange(self.frames(rows), first)

    def features_at(self, rows: Tensor) -> Tensor:
        """Return the features (n, F) of decisions with their frames in rows (n, K)."""
        return self.features.flatten(0, 3)[rows[:, -1]]

    def roll(self) -> None:
        """Make room for the next decisions; rows of the last ones are invalid afterwards."""
        for tensor in (self.store, self.first, self.mask, self.features):
            tensor[:, : self.before + 1] = tensor[:, self.decisions :].clone()
        begun = self.begun[:, self.decisions :] - self.decisions
        self.begun[:, : self.before + 1] = begun.clamp(min=0)

    def state_dict(self) -> dict[str, Any]:
        """Return the rows that later decisions read, after roll()."""
        return {name: getattr(self, name)[:, : self.before + 1].clone() for name in self.STATE}

    def load_state_dict(self, state: dict[str, Any]) -> None:
        """Restore the state that state_dict() returned."""
        for name in self.STATE:
            getattr(self, name)[:, : self.before + 1] = state[name]
