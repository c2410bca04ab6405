"""Reads MJCF with MuJoCo: `files` checks what it opens, `models` reads bodies, `pieces` and `surfaces` geoms."""
