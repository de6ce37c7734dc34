"""sarmitsuba: a synthetic aperture radar simulator on Mitsuba 3.

The names below are loaded on first use: importing the package imports neither Mitsuba, Dr.Jit nor matplotlib.
"""

import importlib
from typing import TYPE_CHECKING, Any

from sarmitsuba.version import __version__

if TYPE_CHECKING:
    from sarmitsuba.analysis.interferometry import height_map, interferogram
    from sarmitsuba.analysis.polarimetry import cloude_pottier, pauli_rgb, polarimetry_report
    from sarmitsuba.analysis.quality import error_budget, image_quality, spectral_looks
    from sarmitsuba.echo.raw_data import RawData
    from sarmitsuba.errors import (
        BackendError,
        ClusterError,
        DataError,
        ExtensionError,
        OutputError,
        RadarError,
        ResourceError,
        SarmitsubaError,
        SarmitsubaWarning,
        SceneError,
    )
    from sarmitsuba.focusing import focus
    from sarmitsuba.focusing.operator import FocusingOperator, focusing_operator
    from sarmitsuba.gradients.fit import Fit, fit
    from sarmitsuba.gradients.jacobian import Jacobian, jacobian
    from sarmitsuba.gradients.least_squares import Prior
    from sarmitsuba.gradients.losses import MultilookDifference, SquaredDifference
    from sarmitsuba.gradients.reverse import Gradient, Objective, gradient
    from sarmitsuba.image.labels import Labels
    from sarmitsuba.image.sar_image import ImageGrid, SarImage
    from sarmitsuba.io import read_image, read_raw, write_image, write_raw
    from sarmitsuba.labelling import labels
    from sarmitsuba.link import LinkBudget, link_budget
    from sarmitsuba.loader.build import SceneMesh, SceneVolume, build_scene
    from sarmitsuba.loader.load import load_scene
    from sarmitsuba.loader.plugins import register_plugins
    from sarmitsuba.materials.material import Material
    from sarmitsuba.radar.description import RadarDescription
    from sarmitsuba.radar.film import FilmDescription
    from sarmitsuba.radar.geodesy import Anchor
    from sarmitsuba.radar.image_request import ImageRequest
    from sarmitsuba.radar.track import Track
    from sarmitsuba.registry import load_extension
    from sarmitsuba.scene.geometry import PointTarget
    from sarmitsuba.scene.motion import Motion
    from sarmitsuba.scene.scene import Scene
    from sarmitsuba.scene.settings import TraceSettings
    from sarmitsuba.scene.wires import WireTarget
    from sarmitsuba.simulation.path_table import PathTable, trace_paths
    from sarmitsuba.simulation.prediction.explanation import explain
    from sarmitsuba.simulation.rcs import monostatic_rcs
    from sarmitsuba.simulation.refinement.passes import refine
    from sarmitsuba.simulation.render import render, simulate

_HOME = {
    "Anchor": "sarmitsuba.radar.geodesy",
    "BackendError": "sarmitsuba.errors",
    "ClusterError": "sarmitsuba.errors",
    "DataError": "sarmitsuba.errors",
    "ExtensionError": "sarmitsuba.errors",
    "FilmDescription": "sarmitsuba.radar.film",
    "Fit": "sarmitsuba.gradients.fit",
    "Gradient": "sarmitsuba.gradients.reverse",
    "ImageGrid": "sarmitsuba.image.sar_image",
    "ImageRequest": "sarmitsuba.radar.image_request",
    "Jacobian": "sarmitsuba.gradients.jacobian",
    "Labels": "sarmitsuba.image.labels",
    "LinkBudget": "sarmitsuba.link",
    "Material": "sarmitsuba.materials.material",
    "Motion": "sarmitsuba.scene.motion",
    "MultilookDifference": "sarmitsuba.gradients.losses",
    "Objective": "sarmitsuba.gradients.reverse",
    "OutputError": "sarmitsuba.errors",
    "PathTable": "sarmitsuba.simulation.path_table",
    "Prior": "sarmitsuba.gradients.least_squares",
    "WireTarget": "sarmitsuba.scene.wires",
    "PointTarget": "sarmitsuba.scene.geometry",
    "RadarDescription": "sarmitsuba.radar.description",
    "RadarError": "sarmitsuba.errors",
    "RawData": "sarmitsuba.echo.raw_data",
    "ResourceError": "sarmitsuba.errors",
    "SarImage": "sarmitsuba.image.sar_image",
    "SarmitsubaError": "sarmitsuba.errors",
    "SarmitsubaWarning": "sarmitsuba.errors",
    "Scene": "sarmitsuba.scene.scene",
    "SceneError": "sarmitsuba.errors",
    "SceneMesh": "sarmitsuba.loader.build",
    "SceneVolume": "sarmitsuba.loader.build",
    "SquaredDifference": "sarmitsuba.gradients.losses",
    "TraceSettings": "sarmitsuba.scene.settings",
    "Track": "sarmitsuba.radar.track",
    "build_scene": "sarmitsuba.loader.build",
    "cloude_pottier": "sarmitsuba.analysis.polarimetry",
    "error_budget": "sarmitsuba.analysis.quality",
    "explain": "sarmitsuba.simulation.prediction.explanation",
    "FocusingOperator": "sarmitsuba.focusing.operator",
    "fit": "sarmitsuba.gradients.fit",
    "focus": "sarmitsuba.focusing",
    "focusing_operator": "sarmitsuba.focusing.operator",
    "gradient": "sarmitsuba.gradients.reverse",
    "height_map": "sarmitsuba.analysis.interferometry",
    "image_quality": "sarmitsuba.analysis.quality",
    "interferogram": "sarmitsuba.analysis.interferometry",
    "jacobian": "sarmitsuba.gradients.jacobian",
    "labels": "sarmitsuba.labelling",
    "link_budget": "sarmitsuba.link",
    "load_extension": "sarmitsuba.registry",
    "load_scene": "sarmitsuba.loader.load",
    "monostatic_rcs": "sarmitsuba.simulation.rcs",
    "pauli_rgb": "sarmitsuba.analysis.polarimetry",
    "polarimetry_report": "sarmitsuba.analysis.polarimetry",
    "read_image": "sarmitsuba.io",
    "read_raw": "sarmitsuba.io",
    "refine": "sarmitsuba.simulation.refinement.passes",
    "register_plugins": "sarmitsuba.loader.plugins",
    "render": "sarmitsuba.simulation.render",
    "simulate": "sarmitsuba.simulation.render",
    "spectral_looks": "sarmitsuba.analysis.quality",
    "trace_paths": "sarmitsuba.simulation.path_table",
    "write_image": "sarmitsuba.io",
    "write_raw": "sarmitsuba.io",
}


def __getattr__(name: str) -> Any:
    """Import the home of a public name on first use (PEP 562)."""
    if name not in _HOME:
        raise AttributeError(f"module 'sarmitsuba' has no attribute {name!r}")
    value = globals()[name] = getattr(importlib.import_module(_HOME[name]), name)
    return value


def __dir__() -> list[str]:
    """Public names, loaded or not."""
    return sorted(__all__)


__all__ = [
    "Anchor",
    "BackendError",
    "ClusterError",
    "DataError",
    "ExtensionError",
    "FilmDescription",
    "Fit",
    "FocusingOperator",
    "Gradient",
    "ImageGrid",
    "ImageRequest",
    "Jacobian",
    "Labels",
    "LinkBudget",
    "Material",
    "Motion",
    "MultilookDifference",
    "Objective",
    "OutputError",
    "PathTable",
    "PointTarget",
    "Prior",
    "RadarDescription",
    "RadarError",
    "RawData",
    "ResourceError",
    "SarImage",
    "SarmitsubaError",
    "SarmitsubaWarning",
    "Scene",
    "SceneError",
    "SceneMesh",
    "SceneVolume",
    "SquaredDifference",
    "TraceSettings",
    "Track",
    "WireTarget",
    "__version__",
    "build_scene",
    "cloude_pottier",
    "error_budget",
    "explain",
    "fit",
    "focus",
    "focusing_operator",
    "gradient",
    "height_map",
    "image_quality",
    "interferogram",
    "jacobian",
    "labels",
    "link_budget",
    "load_extension",
    "load_scene",
    "monostatic_rcs",
    "pauli_rgb",
    "polarimetry_report",
    "read_image",
    "read_raw",
    "refine",
    "register_plugins",
    "render",
    "simulate",
    "spectral_looks",
    "trace_paths",
    "write_image",
    "write_raw",
]
