"""The world and its laws, in torch, batch first; nothing here knows of ROS or of files."""
