"""Multi-robot shepherding for ROS 2: simulate, sense, herd, learn."""

__version__ = '0.1.0'
