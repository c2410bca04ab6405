"""Evaluates on many machines through the coordinator."""
