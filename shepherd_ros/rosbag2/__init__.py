"""The files of bags as rosbag2 has them: records of MCAP, readers, writers, recovery."""

__all__ = ['bag', 'diff', 'errors', 'metadata', 'qos', 'reader', 'recover', 'writer']
