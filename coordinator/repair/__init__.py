"""Making files, ledger and tables agree: at every start, and when an operator asks for it."""
