"""Format `mcap`: messages, schemas of Foxglove and ROS 2, and the exporter."""
