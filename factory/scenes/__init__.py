"""Builds scene packages from built-in layouts and from the user's scene files. Workers read the packages only.

Import from the modules by name; only `factory.scenes.importer` and `factory.scenes.author` load USD.
"""
