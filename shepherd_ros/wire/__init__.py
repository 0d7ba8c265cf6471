"""The wire: topics, the episode description, encoding and decoding of messages."""
