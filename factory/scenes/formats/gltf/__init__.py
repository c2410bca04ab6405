"""Reads glTF 2.0 files: `nodes` reads the scene, `buffers` the binary data, `materials` the appearance."""
