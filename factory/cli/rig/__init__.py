"""Command `rig` and its subcommands."""
