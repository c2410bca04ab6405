"""State of a running coordinator: health, metrics and HTTP pages."""

from coordinator.status.address import HttpAddress, parse_address
from coordinator.status.server import StatusServer

__all__ = ["HttpAddress", "StatusServer", "parse_address"]
