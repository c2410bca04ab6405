"""The command line: one file per command, with its options and its help; importing it imports no large package.

`factory.commands` has the execution of each command, which a command imports when it runs.
"""
