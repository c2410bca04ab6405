"""File access in directories and in object storage, with one interface for readers."""
