"""The content of bags: episodes, checks, exports, replay."""
