"""The learned controller's network and its checkpoints, for the trainer and the node alike."""
