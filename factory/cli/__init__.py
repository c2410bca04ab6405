"""The command line: one file per command, with its options and its help; importing it imports no large package.

The code that executes a command is in `factory.commands`; the command imports it when it runs.
"""
