"""Commands that convert and upload datasets: `export`, `push`."""
