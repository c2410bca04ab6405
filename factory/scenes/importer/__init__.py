"""The one door to USD: what a stage shows and collides with, as arrays in metres, z up."""

from factory.scenes.importer.extract import Extraction, Part, extract_stage

__all__ = ["Extraction", "Part", "extract_stage"]
