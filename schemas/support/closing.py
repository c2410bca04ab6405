"""Base class of context managers that call `close` on exit. Opens no resource."""

from __future__ import annotations

from abc import ABC, abstractmethod
from types import TracebackType
from typing import Self


class Closing(ABC):
    """Context manager that calls `close` when the block ends, also after an exception."""

    @abstractmethod
    def close(self) -> None:
        """Releases the resources."""

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()
