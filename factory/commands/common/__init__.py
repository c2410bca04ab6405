"""Parts that several commands share: progress bars, tables, the gate, status pages and the begin of a run."""
