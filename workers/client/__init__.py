"""Connection of a host to its coordinator: leases, heartbeat, spool, worker loops."""
