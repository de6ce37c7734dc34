"""Draws of a test: a few with the quick tests, the others with the slow ones."""

from collections.abc import Iterable

import pytest


def few_of(values: Iterable[object], quick: int = 1) -> list[object]:
    """Values of a parameter, those after the first ``quick`` marked slow."""
    return [
        value if i < quick else pytest.param(value, marks=pytest.mark.slow) for i, value in enumerate(values)
    ]
