"""Truth: plan expansion, the ledger, the lease protocol, validation and the archive."""
