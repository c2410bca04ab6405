"""The ledger: its database and tables, the life of a job, leases and outcomes, and the one writer."""
