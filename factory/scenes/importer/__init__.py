"""Imports USD stages: visible and collision geometry as arrays in metres, z up. Only this package reads USD."""

from factory.scenes.importer.extract import Extraction, Part, extract_stage

__all__ = ["Extraction", "Part", "extract_stage"]
