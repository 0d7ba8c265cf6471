"""What nodes and bags say to each other: topics, the episode, encoding and decoding, schemas."""

__all__ = ['contract', 'decode', 'encode', 'episode', 'schemas', 'topics']
