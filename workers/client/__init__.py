"""Connects a host to its coordinator: leases, heartbeat, spool, worker loops."""
