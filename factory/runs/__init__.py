"""Generates datasets on one machine: scene catalog, acceptance gate, local runs, replay of episodes."""
