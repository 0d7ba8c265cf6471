"""The console: a page in a browser that shows a running graph and drives it; it knows no ROS."""

__all__ = ['access', 'commands', 'desk', 'frames', 'messages', 'page_server']
