"""Corrections: a policy drives, and the planner's action is recorded at every pose that it visits."""
