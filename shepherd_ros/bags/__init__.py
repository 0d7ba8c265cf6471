"""Bags: MCAP files in the format of rosbag2, without a ROS installation."""
