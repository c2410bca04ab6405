"""The command line: one file per command. Results are printed on stdout, logs and progress bars on stderr."""
