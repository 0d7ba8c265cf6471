"""The paper's statements, the quantities and verdicts on them, its figures and its presets."""

__all__ = [
    'claims',
    'curves',
    'drawing',
    'figures',
    'preset_scores',
    'preset_search',
    'report',
    'summary',
    'verdicts',
]
