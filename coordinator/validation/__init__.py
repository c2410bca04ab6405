"""Validates bundles in sandboxed child processes. Does not archive them."""
