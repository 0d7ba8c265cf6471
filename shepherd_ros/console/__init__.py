"""The console: a page in a browser that shows a running graph and drives it; it knows no ROS."""

__all__ = [
    'access',
    'archive',
    'commands',
    'metric_history',
    'desk',
    'frame_pace',
    'state_frames',
    'live_values',
    'messages',
    'page_server',
]
