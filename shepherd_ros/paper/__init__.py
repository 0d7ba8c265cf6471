"""The paper's statements, the quantities and verdicts on them, its figures and its presets."""
