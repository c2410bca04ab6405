"""Gateways: routers with pullers and a directory of their own, and what they and their core say to each other."""
