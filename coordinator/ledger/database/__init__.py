"""Database of a ledger: engines, the writing thread, prepared statements and the seal. Knows no table."""
