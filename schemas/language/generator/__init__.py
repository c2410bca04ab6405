"""Finds expressions that fit a target. The verifier does not import it."""
