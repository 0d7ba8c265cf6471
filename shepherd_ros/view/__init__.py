"""Pictures, animations and pages of episodes; neither torch nor ROS is needed."""

__all__ = ['animation', 'page', 'picture', 'scene', 'track']
