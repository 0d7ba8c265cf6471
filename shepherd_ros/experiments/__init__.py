"""Experiments on many episodes: settings, cells, campaigns, rows of results, tables."""
