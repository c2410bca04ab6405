"""Exporter to MCAP, with Foxglove or ROS 2 messages."""
