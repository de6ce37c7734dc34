"""Assumptions made while loading: kept in the scene's notes, and given once as a warning."""

import warnings

from sarmitsuba.core.errors import SarmitsubaWarning


def warn_once(notes: list[str], text: str, category: type[SarmitsubaWarning] = SarmitsubaWarning) -> None:
    """Add a note and give it as a warning, unless the notes have it already."""
    if text not in notes:
        notes.append(text)
        warnings.warn(text, category, stacklevel=4)
