"""The words all sides share: models, array specs, wire messages and the bundle codec."""
