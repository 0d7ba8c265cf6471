"""Data for learning from recordings: whole steps, examples, data sets in the form of LeRobot."""
