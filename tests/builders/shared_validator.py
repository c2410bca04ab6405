"""A validator that several coordinators and repairs use one after another."""

from __future__ import annotations

from coordinator.validation.validator import Validator


class SharedValidator:
    """One sandboxed child for all tests, because starting one takes longer than most tests."""

    def __init__(self, validator: Validator) -> None:
        self.check, self.check_all = validator.check, validator.check_all

    def close(self) -> None:
        """Keeps the shared child open."""
