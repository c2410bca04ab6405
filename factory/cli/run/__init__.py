"""Commands that generate datasets: `run`, `render`, `plan`, `gate`."""
