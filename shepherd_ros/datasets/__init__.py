"""Data for learning from recordings: steps, examples, data sets in the form of LeRobot."""

__all__ = ['dataset_report', 'examples', 'lerobot_format', 'steps']
