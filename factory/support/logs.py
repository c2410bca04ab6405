"""Configures structlog: one event name and its fields on each stderr line. Only entry points call it."""

from __future__ import annotations

import logging
import sys
from collections.abc import MutableMapping
from typing import Any, TextIO, cast

import structlog

MAX_FIELD_CHARS = 1000
"""Maximum length of a log field, characters; text from a peer can be longer."""
_CONTROLS = {code: f"\\x{code:02x}" for code in (*range(32), *range(127, 160))} | {10: "\\n", 9: "\\t"}


def configure_logs(verbose: bool = False) -> None:
    """Sends structlog events to stderr: level `warning` and above, or `info` and above when `verbose` is set."""
    level = logging.INFO if verbose else logging.WARNING
    structlog.configure(
        processors=[
            structlog.contextvars.merge_contextvars,
            structlog.processors.add_log_level,
            structlog.processors.TimeStamper(fmt="iso", utc=True),
            bound_fields,
            # the default formatter prints local variables of every frame: keys, tokens, megabytes of messages
            structlog.dev.ConsoleRenderer(
                colors=sys.stderr.isatty(), exception_formatter=structlog.dev.plain_traceback
            ),
        ],
        wrapper_class=structlog.make_filtering_bound_logger(level),
        logger_factory=structlog.PrintLoggerFactory(cast("TextIO", _CurrentStderr())),
        cache_logger_on_first_use=False,
    )


class _CurrentStderr:
    """Stream that writes to the current `sys.stderr`, which can be replaced or closed during the life of a logger."""

    def write(self, text: str) -> int:
        return sys.stderr.write(text)

    def flush(self) -> None:
        sys.stderr.flush()


def bound_fields(_logger: Any, _method: str, event: MutableMapping[str, Any]) -> MutableMapping[str, Any]:
    """Escapes control characters in every field and truncates long fields to `MAX_FIELD_CHARS`."""
    for name, value in event.items():
        if isinstance(value, str):
            event[name] = _bounded(value)
        elif isinstance(value, bytes | list | tuple | dict | set | frozenset):
            event[name] = _bounded(repr(value))
    return event


def _bounded(text: str) -> str:
    if len(text) > MAX_FIELD_CHARS:
        text = f"{text[:MAX_FIELD_CHARS]}... ({len(text)} characters)"
    return text.translate(_CONTROLS)
