"""The command line: one file a verb, arguments in, exit status out. Results on stdout, logs and bars on stderr."""
