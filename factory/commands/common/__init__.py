"""Parts that several commands share: progress bars, tables, the gate, status pages and the start of a run."""
