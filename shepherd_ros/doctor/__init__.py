"""Checks of an installation and of the machine that it is on."""

__all__ = ['checks', 'diagnosis']
