"""Wire format of nodes and bags: topics, episode, encoding, decoding, schemas."""

__all__ = ['contract', 'decode', 'drivers', 'encode', 'episode', 'schemas', 'topics']
