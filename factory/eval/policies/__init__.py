"""Registry of the policies for `--policy`: built-in policies, user classes, policy servers. Runs no episodes."""
