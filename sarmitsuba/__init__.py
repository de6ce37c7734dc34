"""sarmitsuba: a synthetic aperture radar simulator on Mitsuba 3.

The names below are loaded on first use: importing the package imports neither Mitsuba, Dr.Jit nor matplotlib.
"""

import importlib
import importlib.util
from typing import TYPE_CHECKING, Any

from sarmitsuba.version import __version__

if TYPE_CHECKING:
    from sarmitsuba.analysis.error_budget import error_budget
    from sarmitsuba.analysis.image_quality import image_quality, spectral_looks
    from sarmitsuba.analysis.interferometry import height_map, interferogram
    from sarmitsuba.analysis.labels import labels
    from sarmitsuba.analysis.link_budget import LinkBudget, link_budget
    from sarmitsuba.analysis.polarimetry import cloude_pottier, pauli_rgb, polarimetry_report
    from sarmitsuba.apps.fit.fit import Fit, fit
    from sarmitsuba.apps.fit.jacobian import Jacobian, jacobian
    from sarmitsuba.apps.fit.least_squares import Prior
    from sarmitsuba.apps.fit.losses import MultilookDifference, SquaredDifference
    from sarmitsuba.apps.fit.reverse import Gradient, Objective, gradient
    from sarmitsuba.core.errors import (
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
    from sarmitsuba.core.registry import load_extension
    from sarmitsuba.files import read_image, read_raw, write_image, write_raw
    from sarmitsuba.loading.build import SceneMesh, SceneVolume, build_scene
    from sarmitsuba.loading.load import load_scene
    from sarmitsuba.loading.plugins import register_plugins
    from sarmitsuba.radar.description import RadarDescription
    from sarmitsuba.radar.film import FilmDescription
    from sarmitsuba.radar.geodesy import Anchor
    from sarmitsuba.radar.image_request import ImageRequest
    from sarmitsuba.radar.track import Track
    from sarmitsuba.scene.geometry import PointTarget
    from sarmitsuba.scene.materials.material import Material
    from sarmitsuba.scene.motion import Motion
    from sarmitsuba.scene.scene import Scene
    from sarmitsuba.scene.settings import TraceSettings
    from sarmitsuba.signal.focusing import focus
    from sarmitsuba.signal.focusing.operator import FocusingOperator, focusing_operator
    from sarmitsuba.signal.image import ImageGrid, SarImage
    from sarmitsuba.signal.pixel_labels import Labels
    from sarmitsuba.signal.raw_data import RawData
    from sarmitsuba.simulation.execution.passes import refine
    from sarmitsuba.simulation.execution.path_table import PathTable, trace_paths
    from sarmitsuba.simulation.execution.rcs import monostatic_rcs
    from sarmitsuba.simulation.execution.render import render, simulate
    from sarmitsuba.simulation.planning.prediction.prediction import explain
    from sarmitsuba.tracing.scatterers.wires.kind import WireTarget

_HOME = {
    "Anchor": "sarmitsuba.radar.geodesy",
    "BackendError": "sarmitsuba.core.errors",
    "ClusterError": "sarmitsuba.core.errors",
    "DataError": "sarmitsuba.core.errors",
    "ExtensionError": "sarmitsuba.core.errors",
    "FilmDescription": "sarmitsuba.radar.film",
    "Fit": "sarmitsuba.apps.fit.fit",
    "Gradient": "sarmitsuba.apps.fit.reverse",
    "ImageGrid": "sarmitsuba.signal.image",
    "ImageRequest": "sarmitsuba.radar.image_request",
    "Jacobian": "sarmitsuba.apps.fit.jacobian",
    "Labels": "sarmitsuba.signal.pixel_labels",
    "LinkBudget": "sarmitsuba.analysis.link_budget",
    "Material": "sarmitsuba.scene.materials.material",
    "Motion": "sarmitsuba.scene.motion",
    "MultilookDifference": "sarmitsuba.apps.fit.losses",
    "Objective": "sarmitsuba.apps.fit.reverse",
    "OutputError": "sarmitsuba.core.errors",
    "PathTable": "sarmitsuba.simulation.execution.path_table",
    "Prior": "sarmitsuba.apps.fit.least_squares",
    "WireTarget": "sarmitsuba.tracing.scatterers.wires.kind",
    "PointTarget": "sarmitsuba.scene.geometry",
    "RadarDescription": "sarmitsuba.radar.description",
    "RadarError": "sarmitsuba.core.errors",
    "RawData": "sarmitsuba.signal.raw_data",
    "ResourceError": "sarmitsuba.core.errors",
    "SarImage": "sarmitsuba.signal.image",
    "SarmitsubaError": "sarmitsuba.core.errors",
    "SarmitsubaWarning": "sarmitsuba.core.errors",
    "Scene": "sarmitsuba.scene.scene",
    "SceneError": "sarmitsuba.core.errors",
    "SceneMesh": "sarmitsuba.loading.build",
    "SceneVolume": "sarmitsuba.loading.build",
    "SquaredDifference": "sarmitsuba.apps.fit.losses",
    "TraceSettings": "sarmitsuba.scene.settings",
    "Track": "sarmitsuba.radar.track",
    "build_scene": "sarmitsuba.loading.build",
    "cloude_pottier": "sarmitsuba.analysis.polarimetry",
    "error_budget": "sarmitsuba.analysis.error_budget",
    "explain": "sarmitsuba.simulation.planning.prediction.prediction",
    "FocusingOperator": "sarmitsuba.signal.focusing.operator",
    "fit": "sarmitsuba.apps.fit.fit",
    "focus": "sarmitsuba.signal.focusing",
    "focusing_operator": "sarmitsuba.signal.focusing.operator",
    "gradient": "sarmitsuba.apps.fit.reverse",
    "height_map": "sarmitsuba.analysis.interferometry",
    "image_quality": "sarmitsuba.analysis.image_quality",
    "interferogram": "sarmitsuba.analysis.interferometry",
    "jacobian": "sarmitsuba.apps.fit.jacobian",
    "labels": "sarmitsuba.analysis.labels",
    "link_budget": "sarmitsuba.analysis.link_budget",
    "load_extension": "sarmitsuba.core.registry",
    "load_scene": "sarmitsuba.loading.load",
    "monostatic_rcs": "sarmitsuba.simulation.execution.rcs",
    "pauli_rgb": "sarmitsuba.analysis.polarimetry",
    "polarimetry_report": "sarmitsuba.analysis.polarimetry",
    "read_image": "sarmitsuba.files",
    "read_raw": "sarmitsuba.files",
    "refine": "sarmitsuba.simulation.execution.passes",
    "register_plugins": "sarmitsuba.loading.plugins",
    "render": "sarmitsuba.simulation.execution.render",
    "simulate": "sarmitsuba.simulation.execution.render",
    "spectral_looks": "sarmitsuba.analysis.image_quality",
    "trace_paths": "sarmitsuba.simulation.execution.path_table",
    "write_image": "sarmitsuba.files",
    "write_raw": "sarmitsuba.files",
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

# public names of a kind of scatterers leave with the folder of the kind
for _name in [name for name, home in _HOME.items() if home.endswith(".kind")]:
    if importlib.util.find_spec(_HOME[_name].rpartition(".")[0]) is None:
        del _HOME[_name]
        __all__.remove(_name)
