"""Simulation of one job: start pose, closed loop, end of the episode, bundle."""
