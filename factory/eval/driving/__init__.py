"""Runs evaluation episodes: simulator, actions, metrics and the policy interface. Starts no processes."""
