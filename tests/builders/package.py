"""Builds a package of a scene for tests that transfer it and do not read its arrays."""

from __future__ import annotations

import io

from schemas.encoding.container import ContainerWriter
from schemas.scene import SceneInfo


def package_without_arrays(info: SceneInfo, filler: bytes) -> bytes:
    """Returns a package with the metadata of a scene, which workers read to find its textures, and other bytes."""
    buffer = io.BytesIO()
    with ContainerWriter(buffer) as package:
        package.add("scene.json", info.model_dump_json().encode())
        package.add("filler", filler)
    return buffer.getvalue()
