"""Distributes evaluation episodes to workers of the data factory, and collects and checks their results."""
