"""
Flock models. Every module of this folder that defines MODEL is one, under its own name.

A model of your own is one new file here: a configuration, a function for the first headings, a
function for one step, and MODEL = FlockModel(...). Nodes, environment and command line then know
it.
"""

from __future__ import annotations

from importlib import import_module
from pkgutil import iter_modules

from shepherd_ros.config import unknown_name
from shepherd_ros.sim.flocking.base import FlockConfig, FlockModel

FLOCK_MODELS: dict[str, FlockModel] = {
    model.name: model
    for info in iter_modules(__path__)
    for model in [getattr(import_module(f'{__name__}.{info.name}'), 'MODEL', None)]
    if model is not None
}


def flock_model(name: str) -> FlockModel:
    """Return the model of that name, or raise ConfigError."""
    if name not in FLOCK_MODELS:
        raise unknown_name('flock', name, sorted(FLOCK_MODELS))
    return FLOCK_MODELS[name]


def model_of(config: FlockConfig) -> FlockModel:
    """Return the model that a flock configuration belongs to."""
    return next(m for m in FLOCK_MODELS.values() if type(config) is m.config)
