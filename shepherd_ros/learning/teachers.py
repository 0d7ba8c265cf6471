"""Teachers: controllers whose commands are labels, each that of the very step of its state."""

from __future__ import annotations

from dataclasses import replace

from shepherd_ros.controllers.composite import CompositeController
from shepherd_ros.controllers.controller import Controller
from shepherd_ros.controllers.policy_controller import LearnedController
from shepherd_ros.experiments.methods import full_name, method_in
from shepherd_ros.sim.rollout import EnvConfig
from shepherd_ros.sim.world import WorldConfig


def make_teacher(word: str, world: WorldConfig) -> Controller:
    """Return the controller of a name, in which a policy decides at every step, by its mean."""
    return _never_holding(method_in(EnvConfig(world=world), full_name(word)))


def _never_holding(controller: Controller) -> Controller:
    """Return the controller; its policies, which hold no command between decisions."""
    if isinstance(controller, CompositeController):
        drive, hold = map(_never_holding, (controller.drive, controller.hold))
        return CompositeController(controller.config, controller.world, drive, hold)
    if isinstance(controller, LearnedController):
        config = controller.config
        config = replace(config, sample_std=0.0) if config.sample_std < 0 else config
        settled = config, controller.world, controller.policy, controller.dtype
        every_step = LearnedController(*settled)
        every_step.timing = replace(controller.timing, asked_decision=controller.world.dt)
        return every_step
    return controller
