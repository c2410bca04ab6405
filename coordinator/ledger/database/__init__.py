"""Database of a ledger: engines, the writing thread, prepared statements and the digest of a closed ledger. Defines no table."""
