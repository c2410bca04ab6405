"""Appearance of an episode: draws light, materials, camera and clutter, and applies them to a compiled scene. Pure."""

from workers.appearance.cameras import changed_camera, changed_sensor, recorded_camera
from workers.appearance.draw import AppearanceScene, draw_appearance
from workers.appearance.dress import clutter_instances, dress_scene
from workers.appearance.shifted import ShiftedRenderer

__all__ = [
    "AppearanceScene",
    "ShiftedRenderer",
    "changed_camera",
    "changed_sensor",
    "clutter_instances",
    "draw_appearance",
    "dress_scene",
    "recorded_camera",
]
