"""Commands that inspect and maintain datasets: `status`, `jobs`, `verify`, `repair`, `pack`, `replay`, `stats`,
`report`, `show`, `serve`, `view`."""
