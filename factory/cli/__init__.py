"""The command line: one file per command, with its options and its help; importing it imports no large package.

The function of a command imports its work when it runs.
"""
