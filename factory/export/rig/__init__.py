"""Sensors of a rig in exports: measurements step by step, calibration, and the description `rig.json`."""
