"""Commands `eval`, `eval compare`, `eval specs`."""
