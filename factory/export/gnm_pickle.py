"""`traj_data.pkl` as the GNM, ViNT and NoMaD loaders unpickle it: two plain arrays. Writes only; we never unpickle.

An array pickles as a call of `numpy.array` on a list of floats. Numpy's own way names `numpy._core`, which numpy 1.x
as those projects pin it (Python 3.8) does not have.
"""

from __future__ import annotations

import io
import pickle
from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

__all__ = ["pickle_arrays"]

_PROTOCOL = 2


def pickle_arrays(arrays: Mapping[str, NDArray[np.float64]]) -> bytes:
    """Returns the pickle of a dictionary of float64 arrays; equal arrays give equal bytes."""
    buffer = io.BytesIO()
    _PortablePickler(buffer, _PROTOCOL).dump(dict(arrays))
    return buffer.getvalue()


class _PortablePickler(pickle.Pickler):
    def reducer_override(self, item: Any) -> Any:
        if isinstance(item, np.ndarray):
            return np.array, (item.tolist(), "float64")
        return NotImplemented
