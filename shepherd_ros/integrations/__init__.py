"""The environment in the terms of Gymnasium, PettingZoo and Stable-Baselines3."""

__all__ = ['environments', 'sb3']
