"""The paper: statements, quantities, verdicts, figures."""
