"""The ledger: database and tables, states of a job, leases and outcomes, and the single writer."""
