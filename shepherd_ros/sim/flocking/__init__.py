"""
Flock models. Every module of this folder adds its own to FLOCK_MODELS, as a plug-in does.

A model of your own is one file: a configuration, a function for the first headings, a function for
one step, and FLOCK_MODELS.add(FlockModel(...)). Nodes, environment and command line then know it.
"""

from __future__ import annotations

from importlib import import_module
from pkgutil import iter_modules

from shepherd_ros.sim.flocking.flock_model import FLOCK_MODELS, FlockConfig, FlockModel

__all__ = [
    'PAPER_FLOCKS',
    'flock_model',
    'FLOCK_MODELS',
    'FlockConfig',
    'FlockModel',
    'model_of',
    'strombom_flock',
]

PAPER_FLOCKS = ('strombom', 'reynolds')  # the flock models of the paper
_model_with: dict[type[FlockConfig], FlockModel] = {}

for info in iter_modules(__path__):
    import_module(f'{__name__}.{info.name}')


def model_of(config: FlockConfig) -> FlockModel:
    """Return the model that a flock configuration belongs to."""
    kind = type(config)
    if kind not in _model_with:
        _model_with.update({model.config: model for model in FLOCK_MODELS.values()})
    return _model_with[kind]
