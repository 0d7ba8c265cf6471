"""A setting as arguments of a command line: short names, and --set for everything else."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Annotated, Any

from shepherd_ros.arguments import arguments_of, configured
from shepherd_ros.experiments.setting import Setting
import tyro

ONE_SETTING = arguments_of(Setting.blank())
SEVERAL_SETTINGS = arguments_of(Setting.blank(), hidden=('preset',), several=True)


@dataclass(kw_only=True)
class OneSetting:
    """The options of a verb that works in one setting."""

    world: Annotated[Any, tyro.conf.OmitArgPrefixes, tyro.conf.arg(constructor=ONE_SETTING)] = (
        field(default_factory=ONE_SETTING)
    )

    @property
    def setting(self) -> Setting:
        """Return the setting of the options, or raise ConfigError."""
        return configured(Setting, self.world)


@dataclass(kw_only=True)
class ManySettings:
    """The options of a verb that changes settings; each can have several values."""

    worlds: Annotated[
        Any, tyro.conf.OmitArgPrefixes, tyro.conf.arg(constructor=SEVERAL_SETTINGS)
    ] = field(default_factory=SEVERAL_SETTINGS)
