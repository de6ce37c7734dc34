"""Shipped scenes that several tests look at, loaded once in a process."""

import warnings
from functools import cache

from sarmitsuba.loader.load import load_scene
from sarmitsuba.scene.scene import Scene


@cache
def shipped(name: str) -> Scene:
    """A shipped scene under its own radar; a warning is an error."""
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        return load_scene(name)
