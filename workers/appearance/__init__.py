"""Appearance of an episode: draws light, materials, camera and clutter, and applies them to a compiled scene.

Pure functions.
"""

from workers.appearance.apply import apply_appearance, clutter_instances
from workers.appearance.cameras import ShiftedRenderer, changed_camera, changed_sensor, recorded_camera
from workers.appearance.draw import AppearanceScene, draw_appearance

__all__ = [
    "AppearanceScene",
    "ShiftedRenderer",
    "apply_appearance",
    "changed_camera",
    "changed_sensor",
    "clutter_instances",
    "draw_appearance",
    "recorded_camera",
]
