"""The world and its laws, in torch, batch first; start with rollout.py."""
