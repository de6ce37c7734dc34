"""What was assumed while loading: kept in the scene's notes, and said once as a warning."""

import warnings

from sarmitsuba.errors import SarmitsubaWarning


def warn_once(notes: list[str], text: str) -> None:
    """Add a note and give it as a warning, unless it is there already."""
    if text not in notes:
        notes.append(text)
        warnings.warn(text, SarmitsubaWarning, stacklevel=4)
