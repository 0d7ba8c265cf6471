"""The ROS nodes, a file for each executable: decode messages, call the core, encode results."""

__all__ = [
    'compose',
    'controller_probe',
    'episode_probe',
    'executables',
    'foxglove_node',
    'herd_node',
    'mux_requests',
    'player_node',
    'recorder_options',
    'world_client',
]
