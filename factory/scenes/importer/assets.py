"""Reads the bytes of USD assets, inside a .usdz package or relative to a layer.

Does not decode them.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

from pxr import Ar, Sdf


def asset_path(value: Any) -> str:
    """Returns the resolved path of an asset value, or the authored path if USD cannot resolve it."""
    return str(value.resolvedPath or value.path) if isinstance(value, Sdf.AssetPath) else str(value)


def read_asset(path: str) -> bytes | None:
    """Returns the bytes of a resolved asset, or `None` if it cannot be read."""
    if not Path(path).is_absolute():  # unresolved; USD would open it relative to the working directory
        return None
    asset = Ar.GetResolver().OpenAsset(Ar.ResolvedPath(path))
    if asset is None:
        return None
    with asset:
        return bytes(asset.GetBuffer())


def sibling(layer_path: str, name: str) -> str:
    """Returns the path of a file relative to a layer, also inside packages such as `a.usdz[b.usda]`."""
    head, bracket, inner = layer_path.rpartition("[")
    if bracket:
        return f"{head}[{(Path(inner.rstrip(']')).parent / name).as_posix()}]"
    return str(Path(layer_path).parent / name)
