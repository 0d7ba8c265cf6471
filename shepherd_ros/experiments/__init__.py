"""Experiments on many episodes: settings, cells, campaigns, rows of results, tables."""

__all__ = [
    'bootstrap',
    'campaign',
    'catalog',
    'cells',
    'criteria',
    'methods',
    'results',
    'runner',
    'samples',
    'setting',
    'setting_arguments',
    'table',
    'value_map',
]
