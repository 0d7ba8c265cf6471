"""ROS parameters from the same options as everything else, checked before rclpy sees them."""

from __future__ import annotations

from array import array
from collections.abc import Mapping
from dataclasses import fields
import difflib
from typing import Any, TypeVar

from rcl_interfaces.msg import FloatingPointRange, IntegerRange, ParameterDescriptor
from rclpy.node import Node
from shepherd_ros.config import checked, choices_of, Config, ConfigError

_C = TypeVar('_C', bound=Config)
_LARGEST_INT = 2**62
_LARGEST_FLOAT = 1e12


def descriptor(default: Any, option: Mapping[str, Any], read_only: bool) -> ParameterDescriptor:
    """Return description and range of a parameter, as `ros2 param describe` shows them."""
    result = ParameterDescriptor(description=option['doc'], read_only=read_only)
    low, high = option.get('low'), option.get('high')
    if choices := choices_of(option):
        result.additional_constraints = 'one of ' + ', '.join(choices)
    bounded = low is not None or high is not None
    if bounded and isinstance(default, float):
        low = -_LARGEST_FLOAT if low is None else float(low)
        high = _LARGEST_FLOAT if high is None else float(high)
        result.floating_point_range = [FloatingPointRange(from_value=low, to_value=high, step=0.0)]
    elif bounded and isinstance(default, int):
        low = -_LARGEST_INT if low is None else int(low)
        high = _LARGEST_INT if high is None else int(high)
        result.integer_range = [IntegerRange(from_value=low, to_value=high, step=0)]
    return result


def given(node: Node, name: str) -> Any:
    """Return what the user set a parameter to, None if nothing."""
    parameter = node._parameter_overrides.get(name)
    if parameter is None:
        return None
    return list(parameter.value) if isinstance(parameter.value, array) else parameter.value


def _listed(name: str, value: Any, default: Any) -> Any:
    """Return the value; ConfigError if it is empty or a list of another type than the default."""
    if value is None:  # what rcl makes of []
        raise ConfigError(f'{name} is empty: expected a value, such as {default!r}')
    if isinstance(value, list) and isinstance(default, list):
        kind = type(default[0])
        if not all(type(item) is kind for item in value):
            raise ConfigError(
                f'{name} is {value!r}: expected a list of {kind.__name__}, such as {default!r}'
            )
    return value


def declare(
    node: Node, name: str, default: Any, option: Mapping[str, Any], read_only: bool = True
) -> Any:
    """Declare one parameter and return its value; ConfigError names a bad one and the fix."""
    if name not in node._parameter_overrides:
        value = default
    else:
        value = checked(name, _listed(name, given(node, name), default), default, option)
    described = descriptor(default, option, read_only)
    node.declare_parameter(name, value, described, ignore_override=True)
    return value


def declare_config(
    node: Node, config: _C, prefix: str = '', skip: tuple[str, ...] = (), read_only: bool = True
) -> _C:
    """Declare a parameter for each option of a configuration; return it as the user wants it."""
    values = {f.name: getattr(config, f.name) for f in fields(config)}
    for f in fields(config):
        if 'doc' in f.metadata and f.name not in skip:
            values[f.name] = declare(node, prefix + f.name, values[f.name], f.metadata, read_only)
    if added := config.added():
        values['others'] = tuple(
            (name, declare(node, prefix + name, value, metadata, read_only))
            for name, (value, metadata) in added.items()
        )
    return type(config)(**values)


def warn_of_unknown(node: Node) -> None:
    """Warn of parameters that were given but that this node does not have: most likely typos."""
    known = list(node._parameters)
    for name in node._parameter_overrides:
        if name not in node._parameters:
            near = difflib.get_close_matches(name, known, n=1)
            hint = f'; did you mean {near[0]}?' if near else ''
            node.get_logger().warning(f'parameter {name} is not known to this node{hint}')
