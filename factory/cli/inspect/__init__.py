"""Commands that inspect datasets: `status`, `jobs`, `verify`, `repair`, `replay`, `stats`, `report`, `show`, `view`."""
