"""Address, token and evaluations of the pages that a command serves. Imports nothing, so help pages are shown fast."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from pathlib import Path


@dataclass(frozen=True)
class HttpOptions:
    """Pages to serve. A field has the name of the parameter of its option (`factory.cli.options.http_options`)."""

    http: str | None = None
    """HOST:PORT to serve on; `None` serves no pages."""
    http_token: Path | None = None
    """File whose first line is the token of the pages; `None` serves them without a token."""
    host_names: tuple[str, ...] = ()
    """Names of the server besides its address, for the `Host` header of requests."""
    evaluations: tuple[Path, ...] = ()
    """Output directories of `factory eval` to show on the web page of a run."""
