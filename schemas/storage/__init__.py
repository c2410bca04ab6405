"""Paths of files in directories and in object storage; readers treat both alike."""
