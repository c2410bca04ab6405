"""Gateways: zenoh routers with pullers and a local archive directory, and their communication with the core."""
