"""Shared data models: configuration, array specs, protocol messages, and the codecs of bundles and scenes.

Imports no other package of the product. Import from the modules by name.
"""
