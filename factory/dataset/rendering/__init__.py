"""Frames and measurements that are rendered when an episode is read: appearance, sensors and shared renderers."""
