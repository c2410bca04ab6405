"""Keeps results of functions of a grid together with the grid, so they are freed with it.

A cache outside the grid would keep the grids, path graphs and pose tables of scenes that are no longer loaded.
"""

from __future__ import annotations

import functools
from collections.abc import Callable
from typing import Any, TypeVar, TypeVarTuple, Unpack

from workers.geometry.grid import Grid

Key = TypeVarTuple("Key")
Result = TypeVar("Result")


def kept_with_grid(
    most: int,
) -> Callable[[Callable[[Grid, Unpack[Key]], Result]], Callable[[Grid, Unpack[Key]], Result]]:
    """Returns a decorator that keeps the `most` most recently used results of a function for each grid.

    Args:
        most: number of results of a grid, at least 1. The oldest is freed before a new one is computed.

    The first argument of the function is a grid; its other arguments are hashable. Results must not refer to the grid:
    such a cycle is freed only by the garbage collector.
    """

    def decorate(function: Callable[[Grid, Unpack[Key]], Result]) -> Callable[[Grid, Unpack[Key]], Result]:
        def kept(grid: Grid, *key: *Key) -> Result:
            results: dict[Any, Result] = grid.results.setdefault(function, {})
            if key in results:
                results[key] = result = results.pop(key)
                return result
            while len(results) >= most:
                del results[next(iter(results))]
            results[key] = result = function(grid, *key)
            return result

        return functools.update_wrapper(kept, function)

    return decorate
