"""The face: command line, one-machine runs, scenes, the dataset reader."""
