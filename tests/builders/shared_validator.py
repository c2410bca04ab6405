"""A validator that several coordinators and repairs use one after another."""

from __future__ import annotations

from coordinator.validation.validator import Validator


class SharedValidator:
    """Validator whose sandboxed child is used by all tests, because starting a child takes longer than most tests."""

    def __init__(self, validator: Validator) -> None:
        self.check, self.check_all = validator.check, validator.check_all

    def close(self) -> None:
        """Does nothing, so the shared child keeps running."""
