"""Pictures, animations and pages of episodes; neither torch nor ROS is needed."""
