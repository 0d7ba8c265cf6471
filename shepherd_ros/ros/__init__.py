"""Parts of nodes: base class, parameters, executors, transport, subscribers."""

__all__ = [
    'episode_subscriber',
    'intra_process',
    'markers',
    'node',
    'parameters',
    'polling',
    'reader_quality',
    'runtime',
    'scan_subscriber',
    'topic_types',
    'transforms',
    'world_subscriber',
]
