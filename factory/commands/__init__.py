"""What each command does after its options are parsed; results on stdout, logs and progress bars on stderr.

`factory.cli` declares the commands and imports these modules when a command runs.
"""
