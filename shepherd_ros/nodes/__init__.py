"""The nodes: they decode messages, call the core and encode what it answers."""
