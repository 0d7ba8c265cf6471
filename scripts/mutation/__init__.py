"""Mutation testing: small changes of the code that tests must notice."""
