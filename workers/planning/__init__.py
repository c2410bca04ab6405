"""Planning on the occupancy grid: forward-only paths, path following, and geodesic distances."""

from __future__ import annotations

from workers.planning.distance import geodesic_field, geodesic_m, is_way_straight
from workers.planning.lattice import Waypoint, pose_table
from workers.planning.search import GoalFields, plan_path

__all__ = ["GoalFields", "Waypoint", "geodesic_field", "geodesic_m", "is_way_straight", "plan_path", "pose_table"]
