"""Laws in their compiled form: imported by the server of forks, so that no fork loads them."""

from laws import compile_laws

compile_laws()
