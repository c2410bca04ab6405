"""Format `mcap`: messages and schemas of Foxglove and ROS 2, and the exporter."""
