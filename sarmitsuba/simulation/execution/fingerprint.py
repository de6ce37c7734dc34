"""Run hash: a hash of everything on which raw data depend; equal hashes mean equal results."""

import dataclasses
import hashlib
import importlib.metadata
import os
from collections.abc import Mapping, Sequence
from dataclasses import replace
from functools import cache
from pathlib import Path

import numpy as np

from sarmitsuba.scene.scene import Scene

# packages whose arithmetic affects the result
_PACKAGES = ("mitsuba", "drjit", "numpy", "scipy")


def fingerprint(scene: Scene, extensions: Sequence[str] = ()) -> str:
    """Run hash of a scene with its radar and settings, and of the program.

    The effects plan is not included: it follows from the scene, the settings and the program.

    Parameters
    ----------
    scene : as it will be simulated
    extensions : loaded modules and ``.py`` files of the user; files count by their text

    Notes
    -----
    A wanted error and a time limit are left out: they only set the number of passes. Modules that an extension imports,
    and extensions registered by installed packages, count by name and not by text.
    """
    settings = replace(scene.settings, target_error_db=0.0, time_limit=0.0)
    texts = [Path(name).read_bytes() if os.path.isfile(name) else name for name in extensions]
    return _hash(
        (shapes_hash(scene), scene.radar, settings, scene.image, scene.offset, program_hash(), texts)
    )


def shapes_hash(scene: Scene) -> str:
    """Hash of the parts of a scene that the radar sees: geometry, materials, points, scatterers."""
    return _hash((scene.geometry, scene.materials, scene.points, scene.scatterers, scene.offset))


def _hash(content: object) -> str:
    digest = hashlib.sha256()

    def feed(value: object) -> None:
        digest.update(type(value).__name__.encode())
        if dataclasses.is_dataclass(value) and not isinstance(value, type):
            for item in dataclasses.fields(value):
                digest.update(item.name.encode())
                feed(getattr(value, item.name))
        elif isinstance(value, np.ndarray):
            digest.update(str(value.dtype).encode() + str(value.shape).encode())
            digest.update(np.ascontiguousarray(value).tobytes())
        elif isinstance(value, (tuple, list)):
            digest.update(str(len(value)).encode())
            for item in value:
                feed(item)
        elif isinstance(value, Mapping):
            feed(sorted(value.items()))
        else:
            digest.update(repr(value).encode() + b";")

    feed(content)
    return digest.hexdigest()


@cache
def program_hash() -> str:
    """Hash of the package's source text (its version does not change during development) and of versions it uses."""
    digest = hashlib.sha256(repr([importlib.metadata.version(name) for name in _PACKAGES]).encode())
    package = Path(__file__).parents[2]
    for path in sorted(package.rglob("*.py")):
        digest.update(path.relative_to(package).as_posix().encode() + path.read_bytes())
    return digest.hexdigest()
