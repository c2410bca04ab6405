"""Reads the bytes behind an asset path of USD, inside a .usdz or beside a layer.

Never decodes what it reads.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

from pxr import Ar, Sdf

__all__ = ["asset_path", "read_asset"]


def asset_path(value: Any) -> str:
    """Returns the resolved path of an asset value, or the authored one when USD could not resolve it."""
    return str(value.resolvedPath or value.path) if isinstance(value, Sdf.AssetPath) else str(value)


def read_asset(path: str) -> bytes | None:
    """Returns the bytes of a resolved asset, or `None` when there are none."""
    if not Path(path).is_absolute():  # USD could not resolve it; the working directory is none of its business
        return None
    asset = Ar.GetResolver().OpenAsset(Ar.ResolvedPath(path))
    if asset is None:
        return None
    with asset:
        return bytes(asset.GetBuffer())


def sibling(layer_path: str, name: str) -> str:
    """Returns the path of a file named relative to a layer; packages like `a.usdz[b.usda]` stay packages."""
    head, bracket, inner = layer_path.rpartition("[")
    if bracket:
        return f"{head}[{(Path(inner.rstrip(']')).parent / name).as_posix()}]"
    return str(Path(layer_path).parent / name)
