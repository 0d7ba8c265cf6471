"""Whole episodes, many at a time, and what came of them."""
