"""Stores, scores, compares and publishes evaluation results."""
