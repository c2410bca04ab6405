"""Database of a ledger: engines, the writing thread, prepared statements, digest of a closed file. Defines no table."""
