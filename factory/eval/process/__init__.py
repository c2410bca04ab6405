"""Evaluates policies on one machine in driver processes. Does not use the network."""
