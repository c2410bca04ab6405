"""The protocol between coordinator, gateways and workers: key expressions, messages, host identities, status."""
