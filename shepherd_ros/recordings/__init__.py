"""The content of bags: episodes, checks, exports, recording and replay without ROS."""
