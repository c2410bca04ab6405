"""Validates bundles in a sandboxed child process. Never archives one."""
