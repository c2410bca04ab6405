"""Storage of archived episodes: the archive interface, with a directory and an object storage implementation."""
