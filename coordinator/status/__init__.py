"""State of a running coordinator: health, metrics and HTTP pages."""

from coordinator.status.address import parse_address
from coordinator.status.server import StatusServer

__all__ = ["StatusServer", "parse_address"]
