"""Experiments: settings, cells, results."""
