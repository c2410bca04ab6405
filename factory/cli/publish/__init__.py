"""Commands that convert, relabel and upload datasets: `export`, `relabel`, `push`."""
