"""Exporter to VLN-CE episodes and scenes."""
