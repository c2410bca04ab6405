"""Domain-independent helpers: child processes, optional packages, context managers, rate-limited log events."""
