"""State of a running coordinator: health, metrics and HTTP pages; the pages need the extra `metrics`."""
