"""Teachers: controllers whose commands are labels, each that of the very step of its state."""

from __future__ import annotations

from dataclasses import replace
from functools import partial

from shepherd_ros.controllers.composite import CompositeController
from shepherd_ros.controllers.controller import Controller, Memory
from shepherd_ros.controllers.policy_controller import LearnedController
from shepherd_ros.experiments.methods import full_name, method_in
from shepherd_ros.policy.warm_start import drive_mode
from shepherd_ros.sim.rollout import EnvConfig
from shepherd_ros.sim.state import WorldState
from shepherd_ros.sim.world import WorldConfig
from torch import Tensor


class TeachingPolicy(LearnedController):
    """A policy that decides at every step, by its mean, and sees no goal wider than it knows."""

    widest_goal = 0.0  # [m], 0: as wide as it is

    def act(self, state: WorldState, memory: Memory) -> tuple[Tensor, Memory]:
        """Return commands (..., H, 2) m/s, and memory."""
        if self.widest_goal:
            radius = state.goal_radius.clamp(max=self.widest_goal)
            state = replace(state, goal_radius=radius)
        return super().act(state, memory)


def make_teacher(word: str, world: WorldConfig, widest_goal: float = 0.0) -> Controller:
    """
    Return the controller of a name, in which a policy decides at every step, by its mean.

    A policy that drives in a composite has its drive mode alone: the composite says when to hold.
    widest_goal [m] is that of a policy, which leads a flock into the middle of a wider one, too.
    """
    controller = method_in(EnvConfig(world=world), full_name(word))
    return _teaching(controller, widest_goal=widest_goal)


def _teaching(
    controller: Controller, drives: bool = False, widest_goal: float = 0.0
) -> Controller:
    """Return the controller; its policies, which hold no command between decisions."""
    teaching = partial(_teaching, widest_goal=widest_goal)
    if isinstance(controller, CompositeController):
        drive, hold = teaching(controller.drive, drives=True), teaching(controller.hold)
        return CompositeController(controller.config, controller.world, drive, hold)
    if isinstance(controller, LearnedController):
        config, policy = controller.config, controller.policy
        config = replace(config, sample_std=0.0) if config.sample_std < 0 else config
        policy = drive_mode(policy) if drives else policy
        every_step = TeachingPolicy(config, controller.world, policy, controller.dtype)
        every_step.timing = replace(controller.timing, asked_decision=controller.world.dt)
        every_step.widest_goal = widest_goal
        return every_step
    return controller
