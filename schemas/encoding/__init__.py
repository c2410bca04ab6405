"""Encodings of recorded data: array specs, npy, PNG, the bundle container and content digests."""
