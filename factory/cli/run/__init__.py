"""Commands that generate datasets: `run`, `plan`, `gate`."""
