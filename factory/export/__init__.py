"""Exports datasets to training formats. Each format is one module with an exporter class, listed in a registry.

Reads datasets through `factory.dataset.reader`. Does not simulate and does not change the dataset.
"""
