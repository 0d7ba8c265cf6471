"""Checkpoints: weights and metadata of a policy as safetensors; opening a file runs no code."""

from __future__ import annotations

from collections.abc import Mapping
import json
from pathlib import Path
from typing import Any

from safetensors import safe_open, SafetensorError
from safetensors.torch import save_file
from shepherd_ros import __version__
from shepherd_ros.config import ConfigError
from shepherd_ros.policy.policy import Policy, PolicyConfig
from shepherd_ros.resources import share_file
import torch

CHECKPOINT_FORMAT = 'shepherd_ros policy 1'
MAX_CHECKPOINT_BYTES = 1 << 30  # [bytes] of a file
CHECKPOINT_SUFFIX = '.safetensors'


def save_policy(path: Path, policy: Policy, record: Mapping[str, Any]) -> None:
    """
    Write a policy; record is its provenance: command, seed, wall time, results, all plain data.

    The file is written under another name and renamed, so that a reader never sees half of it.
    Raises OSError where that fails.
    """
    metadata = {
        'format': CHECKPOINT_FORMAT,
        'version': __version__,
        'config': json.dumps(policy.config.to_dict()),
        'record': json.dumps(record),
    }
    path.parent.mkdir(parents=True, exist_ok=True)
    temporary = path.with_suffix('.part')
    state = {name: value.contiguous() for name, value in policy.state_dict().items()}
    try:
        save_file(state, temporary, metadata)
    except SafetensorError as error:  # what it makes of a full disk
        raise OSError(str(error)) from error
    temporary.chmod(0o644)  # it is made for its owner alone, but goes into installations
    temporary.replace(path)


def checkpoint_file(name: str) -> Path:
    """Return the path of a checkpoint, a file or the name of a shipped one; or ConfigError."""
    path = Path(name)
    if path.suffix == CHECKPOINT_SUFFIX or path.exists():
        if path.is_file():
            return path
        raise ConfigError(f'checkpoint is {name!r}: expected a file that exists')
    try:
        return share_file('checkpoints', name + CHECKPOINT_SUFFIX)
    except (FileNotFoundError, ValueError) as error:
        raise ConfigError(
            f'checkpoint is {name!r}: expected a {CHECKPOINT_SUFFIX} file, or one that '
            f'is shipped: {", ".join(shipped_checkpoints()) or "none is"}'
        ) from error


def shipped_checkpoints() -> list[str]:
    """Return the names of the checkpoints that come with the package."""
    try:
        return sorted(
            path.stem for path in share_file('checkpoints').glob('*' + CHECKPOINT_SUFFIX)
        )
    except FileNotFoundError:
        return []


def read_checkpoint_metadata(path: Path) -> tuple[PolicyConfig, dict[str, Any], str]:
    """Return configuration, record and package version of a checkpoint, without its weights."""
    if path.stat().st_size > MAX_CHECKPOINT_BYTES:
        raise ConfigError(
            f'{path} has more than {MAX_CHECKPOINT_BYTES} bytes: not a checkpoint of ours'
        )
    try:
        with safe_open(path, framework='pt') as file:
            metadata = file.metadata() or {}
    except (SafetensorError, MemoryError, OSError, ValueError) as error:
        raise ConfigError(
            f'{path} is no whole safetensors file ({error!s:.200}): copy or train it again'
        ) from error
    if metadata.get('format') != CHECKPOINT_FORMAT:
        raise ConfigError(
            f'{path} has format {metadata.get("format")!r:.60}: '
            f'expected {CHECKPOINT_FORMAT!r}, as shepherd train writes'
        )
    try:
        config, record = (json.loads(metadata[key]) for key in ('config', 'record'))
    except (KeyError, ValueError, RecursionError) as error:
        raise ConfigError(
            f'{path} has damaged metadata ({error!s:.200}): copy it again'
        ) from error
    if not isinstance(config, dict) or not isinstance(record, dict):
        raise ConfigError(f'{path} has damaged metadata: config and record should be objects')
    try:
        return PolicyConfig.from_dict(config), record, str(metadata.get('version', '?'))
    except ConfigError as error:
        raise ConfigError(f'{path}: {error!s:.300}') from error


def load_policy(name: str, device: str = 'cpu') -> Policy:
    """Return the policy of checkpoint_file() in float32, or raise ConfigError."""
    path = checkpoint_file(name)
    config, _, _ = read_checkpoint_metadata(path)
    with torch.device('meta'):
        policy = Policy(config)
    expected = policy.state_dict()
    state = {}
    try:
        with safe_open(path, framework='pt', device=device) as file:
            names = set(file.keys())
            if names != set(expected):
                differing = sorted(names ^ set(expected))[0]
                raise ConfigError(f'{path}: weights {differing!r:.60} are missing or too many')
            for key, tensor in expected.items():
                shape = tuple(file.get_slice(key).get_shape())
                if shape != tuple(tensor.shape):
                    raise ConfigError(
                        f'{path}: weights {key!r} are {shape}, expected {tuple(tensor.shape)}'
                    )
                state[key] = file.get_tensor(key).float()
                if not state[key].isfinite().all():
                    raise ConfigError(f'{path}: weights {key!r} are not all finite')
    except (SafetensorError, MemoryError, OSError, ValueError, RuntimeError) as error:
        if isinstance(error, ConfigError):
            raise
        raise ConfigError(f'{path} cannot be read ({error!s:.200}): copy it again') from error
    policy.load_state_dict(state, assign=True)
    return policy.requires_grad_(False).eval()
