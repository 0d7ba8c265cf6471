"""The error that ends a verb with a sentence instead of a traceback."""


class UserError(Exception):
    """A mistake of the user's or of the machine: what, what was expected, what to do."""
