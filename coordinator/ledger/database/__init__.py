"""Database of a ledger: engines, the writing thread, prepared statements and the seal. Defines no table."""
