"""Pictures and animations of episodes; needs numpy and matplotlib, neither torch nor ROS."""
