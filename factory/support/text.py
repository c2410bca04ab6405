"""Writes durations, sizes and times as text for people. Pure functions."""

from __future__ import annotations

from datetime import datetime


def format_duration(seconds: float | None) -> str:
    """Returns a duration as `1 h 05 min`, `4 min 10 s` or `12 s`; a dash when it is unknown."""
    if seconds is None:
        return "-"
    minutes, rest = divmod(round(seconds), 60)
    hours, minutes = divmod(minutes, 60)
    if hours:
        return f"{hours} h {minutes:02d} min"
    return f"{minutes} min {rest:02d} s" if minutes else f"{rest} s"


def format_bytes(size: int) -> str:
    """Returns a size as `3.2 GB`, `1.5 MB` or `20 kB`."""
    for unit, factor in (("TB", 1e12), ("GB", 1e9), ("MB", 1e6)):
        if size >= factor:
            return f"{size / factor:.1f} {unit}"
    return f"{size / 1e3:.0f} kB"


def format_time(at: datetime, now: datetime) -> str:
    """Returns a time in UTC, with its date unless it is on the same day as `now`."""
    return f"{at:%H:%M:%S}" if at.date() == now.date() else f"{at:%Y-%m-%d %H:%M:%S}"
