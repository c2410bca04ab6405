"""Builds the package of a scene for tests that only transfer the package and do not read its arrays."""

from __future__ import annotations

import io

from schemas.encoding.container import ContainerWriter
from schemas.scene import SceneInfo


def package_without_arrays(info: SceneInfo, filler: bytes) -> bytes:
    """Returns a package of filler bytes and the metadata of a scene, which workers read to find its textures."""
    buffer = io.BytesIO()
    with ContainerWriter(buffer) as package:
        package.add("scene.json", info.model_dump_json().encode())
        package.add("filler", filler)
    return buffer.getvalue()
