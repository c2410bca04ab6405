"""Command `bench` and its subcommands."""
