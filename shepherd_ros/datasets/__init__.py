"""Steps and examples of recordings, and LeRobot data sets."""
