"""Imports USD stages: visible and collision geometry as arrays in metres, z up. Only this package reads USD."""

from factory.scenes.importer.extract import extract_stage
from factory.scenes.importer.model import Extraction, Part, Surface

__all__ = ["Extraction", "Part", "Surface", "extract_stage"]
