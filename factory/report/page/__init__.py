"""Composes the HTML page of a report. Pure; markup is in `factory.html`."""
