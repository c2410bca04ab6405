"""Command `scene` and its subcommands."""
