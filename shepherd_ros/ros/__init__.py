"""What nodes share of ROS: base class, parameters, executors, transport, subscribers."""
