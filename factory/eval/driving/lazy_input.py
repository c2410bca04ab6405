"""Observation of a policy whose images are rendered when the policy reads them, because most of the time of a step is
the rendering, and a policy that stands still or answers from memory reads none. Calls no policy.
"""

from __future__ import annotations

import time
from collections.abc import Callable, ItemsView, Iterator, Mapping, ValuesView
from typing import Any

from schemas.frame import Frame

_IMAGES = ("rgb", "depth")


class LazyInput(dict[str, Any]):
    """Dictionary with `rgb` (H, W, 3) and `depth` (H, W), which are rendered at the first access to one of them.

    Copies are ordinary dictionaries. The images are those of the step of the observation, whenever they are read; after
    the end of its episode, images that were not read before raise a `RuntimeError`.
    """

    # C code reads a subclass of dict through its methods only if the subclass overrides `__iter__`

    def __init__(self, values: Mapping[str, Any], render: Callable[[], Frame]) -> None:
        super().__init__(values)
        self._render: Callable[[], Frame] | None = render
        self.seconds = 0.0
        """Time of the rendering, seconds."""
        self.failure: Exception | None = None
        """Error of the renderer; the policy did not cause it."""
        for name in _IMAGES:
            super().__setitem__(name, None)

    def __getitem__(self, key: str) -> Any:
        if key in _IMAGES:
            self._fill()
        return super().__getitem__(key)

    def get(self, key: str, default: Any = None) -> Any:
        """Returns a value, or the default."""
        if key in _IMAGES:
            self._fill()
        return super().get(key, default)

    def __iter__(self) -> Iterator[str]:
        return super().__iter__()

    def items(self) -> ItemsView[str, Any]:  # type: ignore[override]
        """Returns keys and values; renders the images."""
        self._fill()
        return super().items()

    def values(self) -> ValuesView[Any]:  # type: ignore[override]
        """Returns the values; renders the images."""
        self._fill()
        return super().values()

    def copy(self) -> dict[str, Any]:
        """Returns an ordinary dictionary."""
        return dict(self)

    def pop(self, key: str, *default: Any) -> Any:
        """Removes a key and returns its value."""
        self._fill()
        return super().pop(key, *default)

    def popitem(self) -> tuple[str, Any]:
        """Removes and returns the last key and value."""
        self._fill()
        return super().popitem()

    def setdefault(self, key: str, default: Any = None) -> Any:
        """Returns a value, after setting it to the default if it is absent."""
        self._fill()
        return super().setdefault(key, default)

    def __setitem__(self, key: str, value: Any) -> None:
        self._fill()
        super().__setitem__(key, value)

    def update(self, *others: Any, **values: Any) -> None:
        """Sets several values."""
        self._fill()
        super().update(*others, **values)

    def __or__(self, other: dict[str, Any]) -> dict[str, Any]:  # type: ignore[override]
        return {**self, **other}

    def __ror__(self, other: dict[str, Any]) -> dict[str, Any]:  # type: ignore[override]
        return {**other, **self}

    def __repr__(self) -> str:
        return repr(dict(self))

    def __reduce__(self) -> tuple[Any, ...]:
        return dict, (dict(self),)

    def __reduce_ex__(self, protocol: Any) -> tuple[Any, ...]:
        return self.__reduce__()

    def _fill(self) -> None:
        if self._render is None:
            return
        start_s = time.monotonic()
        try:
            frame = self._render()
        except Exception as error:
            self.failure = error
            raise
        finally:
            self.seconds += time.monotonic() - start_s
        self._render = None
        super().__setitem__("rgb", frame.rgb)
        super().__setitem__("depth", frame.depth)
