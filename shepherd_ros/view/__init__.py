"""Pictures, animations and pages of episodes; neither torch nor ROS is needed."""

__all__ = ['animation', 'assets', 'page', 'picture', 'scene', 'track', 'video']
