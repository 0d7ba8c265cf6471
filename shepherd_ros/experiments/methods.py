"""Methods of an experiment: controllers by name, such as policy:CHECKPOINT, composite:A,B."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from functools import cache
import hashlib
from typing import Any

from shepherd_ros.config import ConfigError
from shepherd_ros.controllers import CONTROLLERS, make_controller
from shepherd_ros.controllers.composite import CompositeConfig, CompositeController, ROLES
from shepherd_ros.controllers.controller import Controller
from shepherd_ros.controllers.policy_controller import LearnedConfig, LearnedController
from shepherd_ros.experiments.setting import env_config, Setting
from shepherd_ros.policy.checkpoint import checkpoint_file, load_policy, read_checkpoint_metadata
from shepherd_ros.policy.policy import Policy
from shepherd_ros.sim.lidar import LidarConfig, scan
from shepherd_ros.sim.presets import PRESETS
from shepherd_ros.sim.rollout import EnvConfig
from shepherd_ros.sim.state import WorldState
from torch import Tensor

POLICY = LearnedController.name


def split_name(word: str) -> tuple[str, dict[str, Any]]:
    """Return controller and options, such as a checkpoint, of a name; or raise ConfigError."""
    kind, colon, text = word.partition(':')
    known = CONTROLLERS[kind]
    options = known.options_of(text) if colon else {}
    if 'checkpoint' in options:
        checkpoint_file(options['checkpoint'])
    for part in _parts(kind, options):
        split_name(part)
    return kind, options


def full_name(word: str) -> str:
    """Return a name with its checkpoints: policy is policy:general; or raise ConfigError."""
    kind, options = split_name(word)
    if kind == POLICY:
        learned = LearnedConfig(**options)
        spread = f'@{learned.sample_std:g}' if learned.sample_std >= 0 else ''
        return f'{POLICY}:{learned.checkpoint}{spread}'
    parts = [full_name(part) for part in _parts(kind, options)]
    distances = word.split(',')[len(parts) :]
    return f'{kind}:{",".join([*parts, *distances])}' if parts else kind


def _parts(kind: str, options: Mapping[str, Any]) -> list[str]:
    """Return the names of the controllers that the options of a composite name."""
    is_composite = kind == CompositeController.name
    return [options[key] for key in ROLES if key in options] if is_composite else []


def checkpoint_of(name: str) -> str:
    """Return the checkpoint in the full name of a policy, empty for the others."""
    kind, _, text = name.partition(':')
    return LearnedController.options_of(text).get('checkpoint', '') if kind == POLICY else ''


def label(name: str) -> str:
    """Return the label of a method in pictures and pages; those of this project are marked."""
    kind, _, text = name.partition(':')
    return f'policy {text} (ours)' if kind == POLICY else kind_of(name).label or name


def kind_of(name: str) -> type[Controller]:
    """Return the class of a method; the base, with its defaults, if no controller has its name."""
    kind = name.partition(':')[0]
    return CONTROLLERS.get(kind, Controller)


def sorted_methods(names: list[str]) -> list[str]:
    """Return methods in the order of pictures: policies, the paper's baselines, the others."""
    return sorted(names, key=lambda n: (kind_of(n).order, n))


def checkpoint_hash(name: str) -> str:
    """
    Return the SHA-256 of the file of a policy's checkpoint, empty for other controllers.

    Those of a composite of policies are joined by +.
    """
    checkpoint = checkpoint_of(name)
    if not checkpoint:
        return '+'.join(filter(None, map(checkpoint_hash, _parts(*split_name(name)))))
    return _read(checkpoint, _written(checkpoint))[1]


def loaded(checkpoint: str) -> Policy:
    """Return the policy of a checkpoint, the same object for each call."""
    return _read(checkpoint, _written(checkpoint))[0]


def _written(checkpoint: str) -> int:
    """Return the time of modification of a checkpoint [ns]."""
    return checkpoint_file(checkpoint).stat().st_mtime_ns


@cache
def _read(checkpoint: str, written: int) -> tuple[Policy, str]:
    """Return the policy of a checkpoint, and the SHA-256 of its file."""
    content = checkpoint_file(checkpoint).read_bytes()
    return load_policy(checkpoint), hashlib.sha256(content).hexdigest()


def how_made(name: str) -> str:
    """Return the command that trained a policy, from its checkpoint."""
    return str(_record(name).get('command', 'the checkpoint does not say'))


def training_of(name: str) -> dict[str, Any]:
    """Return the configuration of a policy's training, empty where its checkpoint has none."""
    config = _record(name).get('config')
    run = config.get('run') if isinstance(config, dict) else None
    return run if isinstance(run, dict) else {}


def _record(name: str) -> dict[str, Any]:
    """Return the provenance of a policy from its checkpoint."""
    return read_checkpoint_metadata(checkpoint_file(checkpoint_of(name)))[1]


class FaultyLidarController(LearnedController):
    """A policy with a faulty lidar, or with one of fewer rays than in its training."""

    lidar: LidarConfig

    def read_ranges(self, state: WorldState) -> Tensor:
        """Return ranges (..., H, C, R) m, with fewer rays repeated for their neighbours."""
        n_rays = self.policy.config.lidar.n_rays
        ranges = scan(self.world.task.observed(state), self.lidar)
        return ranges.repeat_interleave(n_rays // self.lidar.n_rays, dim=-1).roll(
            -(n_rays // self.lidar.n_rays // 2), dims=-1
        )


def timing_note(name: str, dt: float) -> str:
    """Return which times a policy uses where a time step [s] cannot keep its own; else empty."""
    checkpoint = checkpoint_of(name)
    if not checkpoint:
        parts = (timing_note(full_name(part), dt) for part in _parts(*split_name(name)))
        return '; '.join(filter(None, parts))
    deviation = loaded(checkpoint).config.timing(dt).deviation
    return f'{name} {deviation}' if deviation else ''


def make_method(name: str, setting: Setting) -> Controller:
    """Return the controller of a full name in a setting, or raise ConfigError."""
    return method_in(env_config(setting), name, setting.preset)


def method_in(config: EnvConfig, name: str, preset: str = 'default') -> Controller:
    """Return the controller of a full name in an environment, or raise ConfigError."""
    checkpoint = checkpoint_of(name)
    if not checkpoint:
        kind, own = split_name(name)
        options = {**PRESETS[preset].controllers.get(kind, {}), **own}
        if kind != CompositeController.name:
            return make_controller(kind, config.world, **options)
        chosen = CompositeConfig(**options)

        def part(word: str) -> Controller:
            return method_in(config, full_name(word), preset)

        return CompositeController.made_of(chosen, config.world, part)
    policy = loaded(checkpoint)
    learned = LearnedConfig(**split_name(name)[1])
    faults, rays = config.lidar.changes(), config.lidar.n_rays
    if not faults:
        return LearnedController(learned, config.world, policy)
    if 'n_rays' in faults and policy.config.lidar.n_rays % rays:
        raise ConfigError(
            f'rays is {rays}: expected a divisor of {policy.config.lidar.n_rays}, which {name} '
            'was trained with'
        )
    controller = FaultyLidarController(learned, config.world, policy)
    controller.lidar = lidar_in(config, name)
    return controller


def lidar_in(config: EnvConfig, name: str) -> LidarConfig:
    """Return the lidar of an environment, for a policy that of its training with these faults."""
    checkpoint = checkpoint_of(name)
    if not checkpoint:
        return config.lidar
    return replace(loaded(checkpoint).config.lidar, **config.lidar.changes())
