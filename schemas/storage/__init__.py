"""File access in directories and in object storage, with one interface for readers; names of a dataset's files."""
