"""Drives evaluation episodes: simulator, actions, measures, the policy interface."""
