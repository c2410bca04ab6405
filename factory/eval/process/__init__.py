"""Evaluates on one machine in driver processes."""
