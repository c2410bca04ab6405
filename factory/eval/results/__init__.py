"""Stores, scores, compares and publishes evaluation results. Runs no episodes."""
