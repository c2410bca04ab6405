"""Commands that make datasets: `run`, `plan`, `gate`."""
