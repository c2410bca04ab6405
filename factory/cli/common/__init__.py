"""Parts that several commands share: options, types of values, and groups."""
