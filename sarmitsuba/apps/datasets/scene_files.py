"""Scene files that a recipe may draw: what they hold."""

import warnings
from dataclasses import dataclass
from pathlib import Path

from sarmitsuba.analysis.labels.classes import shape_names
from sarmitsuba.analysis.labels.owners import material_names
from sarmitsuba.core.errors import SarmitsubaError, SarmitsubaWarning
from sarmitsuba.loading.load import load_scene
from sarmitsuba.simulation.execution.fingerprint import fingerprint


@dataclass(frozen=True)
class SceneFile:
    """Names in a scene file.

    Parameters
    ----------
    digest : hash of all that belongs to the scene; "" where it cannot be read: its draws fail, and say why
    shapes, materials : names
    """

    digest: str
    shapes: tuple[str, ...] = ()
    materials: tuple[str, ...] = ()

    @staticmethod
    def of(file: Path | str) -> "SceneFile":
        """Names in a file, or in a shipped scene."""
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", SarmitsubaWarning)
            try:
                scene = load_scene(file)
            except SarmitsubaError:
                return SceneFile("")
        return SceneFile(fingerprint(scene), shape_names(scene), tuple(material_names(scene.materials)))
