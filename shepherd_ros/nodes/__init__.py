"""The ROS nodes, a file for each executable: decode messages, call the core, encode its answer."""
