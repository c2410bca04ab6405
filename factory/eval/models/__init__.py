"""Models of evaluation: specs, requests, messages, results. No I/O except the spec file."""
