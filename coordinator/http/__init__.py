"""What a coordinator tells those who watch over it: `/healthz`, `/readyz` and `/metrics`, read-only."""

from coordinator.http.address import HttpAddress, parse_address
from coordinator.http.server import StatusServer

__all__ = ["HttpAddress", "StatusServer", "parse_address"]
