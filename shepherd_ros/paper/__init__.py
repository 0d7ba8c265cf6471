"""The paper's statements, the quantities and verdicts on them, its figures and its presets."""

__all__ = [
    'claims',
    'curves',
    'drawing',
    'figure_pages',
    'figures',
    'judging',
    'preset_scores',
    'preset_search',
    'primary',
    'protection_page',
    'report',
    'stopping',
    'summary',
    'value_picture',
    'value_verdicts',
    'verdict_picture',
    'verdict_tables',
    'verdicts',
]
