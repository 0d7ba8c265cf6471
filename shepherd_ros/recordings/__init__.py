"""The content of bags: episodes, checks, exports, recording and replay without ROS."""

__all__ = [
    'bag_list',
    'check',
    'counterfactual',
    'episode_metrics',
    'episodes',
    'export',
    'grouping',
    'info',
    'record',
    'recording_writer',
    'replay',
    'replay_check',
]
