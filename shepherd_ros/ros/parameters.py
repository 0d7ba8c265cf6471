"""ROS parameters made of the options of configurations, checked before they are declared."""

from __future__ import annotations

from array import array
from collections.abc import Callable, Mapping
from dataclasses import fields
import difflib
from typing import Any, TypeVar

from rcl_interfaces.msg import FloatingPointRange, IntegerRange, ParameterDescriptor
from rclpy.node import Node
from shepherd_ros.config import checked, choices_of, Config, ConfigError

_C = TypeVar('_C', bound=Config)
_MAX_INT = 2**62
_MAX_FLOAT = 1e12


class ParameterNode(Node):
    """A node that keeps its parameter overrides, so that they are checked before declaration."""

    overrides: dict[str, Any] | None = None  # by name; None for an empty list

    def __init__(self, name: str, **kwargs: Any) -> None:
        """Create the node; the arguments are those of rclpy's Node."""
        super().__init__(name, automatically_declare_parameters_from_overrides=True, **kwargs)

    def declare_parameters(
        self, namespace: str, parameters: list[Any], ignore_override: bool = False
    ) -> list[Any]:
        """Declare parameters; the first call, which rclpy makes, stores the overrides."""
        if self.overrides is None:
            self.overrides = {
                name: list(value) if isinstance(value, array) else value
                for name, value, _ in parameters
            }
            return []
        return list(super().declare_parameters(namespace, parameters, ignore_override))


def descriptor(default: Any, option: Mapping[str, Any], read_only: bool) -> ParameterDescriptor:
    """Return description and range of a parameter, shown by `ros2 param describe`."""
    result = ParameterDescriptor(description=option['doc'], read_only=read_only)
    low, high = option.get('low'), option.get('high')
    if choices := choices_of(option):
        result.additional_constraints = 'one of ' + ', '.join(choices)
    bounded = low is not None or high is not None
    if bounded and isinstance(default, float):
        low = -_MAX_FLOAT if low is None else float(low)
        high = _MAX_FLOAT if high is None else float(high)
        result.floating_point_range = [FloatingPointRange(from_value=low, to_value=high, step=0.0)]
    elif bounded and isinstance(default, int):
        low = -_MAX_INT if low is None else int(low)
        high = _MAX_INT if high is None else int(high)
        result.integer_range = [IntegerRange(from_value=low, to_value=high, step=0)]
    return result


def _checked_list(name: str, value: Any, default: Any) -> Any:
    """Return the value; ConfigError if it is empty, or a list of another type than the default."""
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
    node: ParameterNode, name: str, default: Any, option: Mapping[str, Any], read_only: bool = True
) -> Any:
    """Declare one parameter and return its value, or raise ConfigError for a bad one."""
    value = default
    if node.overrides and name in node.overrides:
        value = checked(name, _checked_list(name, node.overrides[name], default), default, option)
    described = descriptor(default, option, read_only)
    node.declare_parameter(name, value, described, ignore_override=True)
    return value


def declare_config(
    node: ParameterNode, config: _C, prefix: str = '', read_only: bool = True
) -> _C:
    """Declare a parameter for each option of a configuration; return it as the user wants it."""
    return _mapped(
        config,
        lambda name, value, metadata: declare(node, prefix + name, value, metadata, read_only),
    )


def present_config(node: ParameterNode, config: _C, prefix: str, changes: Mapping[str, Any]) -> _C:
    """Return a configuration with what its parameters are now; changes are others by full name."""

    def present(name: str, value: Any, metadata: Mapping[str, Any]) -> Any:
        full = prefix + name
        return changes[full] if full in changes else node.get_parameter(full).value

    return _mapped(config, present)


def _mapped(config: _C, value_of: Callable[[str, Any, Mapping[str, Any]], Any]) -> _C:
    """Return a configuration with value_of(name, value, metadata) for each of its options."""
    values = {f.name: getattr(config, f.name) for f in fields(config)}
    for f in fields(config):
        if 'doc' in f.metadata:
            values[f.name] = value_of(f.name, values[f.name], f.metadata)
    if added := config.added():
        values['others'] = tuple(
            (name, value_of(name, value, metadata)) for name, (value, metadata) in added.items()
        )
    return type(config)(**values)


def warn_of_unknown(node: ParameterNode) -> None:
    """Log a warning for overrides of parameters that this node does not have."""
    known = node.list_parameters([], 0).names
    for name in node.overrides or ():
        if name not in known:
            matches = difflib.get_close_matches(name, known, n=1)
            hint = f'; did you mean {matches[0]}?' if matches else ''
            node.get_logger().warning(f'parameter {name} is not known to this node{hint}')
