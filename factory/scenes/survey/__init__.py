"""Surveys a compiled floor: reachable targets, spawn points and their quality. Pure and deterministic."""
