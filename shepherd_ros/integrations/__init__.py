"""The environment in the terms of Gymnasium, PettingZoo and Stable-Baselines3."""
