"""Environments in the terms of other libraries."""
