"""Commands `scene ...`."""
