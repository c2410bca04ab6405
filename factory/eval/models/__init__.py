"""Models of the evaluation: specs, requests, messages, results. Does no I/O, except for the file of specs."""
