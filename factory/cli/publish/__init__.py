"""Commands that write other formats and upload: `export`, `push`."""
