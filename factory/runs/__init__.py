"""Runs on one machine: scene catalog, gate, replay of episodes."""
