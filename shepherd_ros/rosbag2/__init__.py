"""The files of bags as rosbag2 has them: records of MCAP, readers, writers, recovery."""

__all__ = ['diff', 'errors', 'metadata', 'qos', 'reader', 'recover', 'writer']
