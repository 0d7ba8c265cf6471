"""The reference pages of the manual, made from the code."""
