"""Where episodes lie: the archive's contract, as a directory and in object storage, and durable files."""
