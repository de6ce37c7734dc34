"""Mean sigma0 of diffuse ground, end to end: from traced echoes to calibrated pixels."""

from collections.abc import Mapping
from typing import Any, Literal

import numpy as np

from sarmitsuba.scene.settings import TraceSettings
from sarmitsuba.units import db_from_power
from sarmitsuba.validation.cases import CASES, CaseEntry
from sarmitsuba.validation.chain import METHODS, WINDOWS, chain, ground_scene
from sarmitsuba.validation.comparison import Case, Comparison

# what a series does not change
BASE: dict[str, Any] = {
    "look": 35.0,
    "cell": 1.0,
    "range": 10e3,
    "window": "rectangular",
    "method": METHODS[0],
    "rays": 0.0,
}


def ground_sigma0(quick: bool = False) -> Case:
    """Mean sigma0 of diffuse ground over look angle, resolution, range, window and focuser."""
    level, n_cells = -10.0, 128.0 if quick else 192.0
    sweeps: dict[str, tuple[str, list[Any]]] = {
        "look angle (deg)": ("look", [35.0] if quick else [20.0, 35.0, 50.0, 60.0]),
        "log10(cell / m)": ("cell", [0.3, 3.0] if quick else [0.1, 0.3, 1.0, 3.0, 10.0]),
        "log10(range / m)": ("range", [700e3] if quick else [1e3, 10e3, 100e3, 1000e3]),
        "window": ("window", ["hamming"] if quick else list(WINDOWS)),
        "focuser (0 backprojection, 1 omega-k)": ("method", [METHODS[1]] if quick else list(METHODS)),
    }
    return Case(
        name="ground_sigma0",
        topic="radiometry",
        title="Mean sigma0 of diffuse ground, end to end",
        formula="sigma0 = -10 dB (constant law)",
        source="what the material was given",
        x_label="see the legend",
        y_label="sigma0 (dB)",
        comparisons=_swept(BASE, sweeps, level, n_cells),
        note=f"X band; {n_cells:g} x {n_cells:g} resolution cells, mean over the inner three quarters; "
        "rays as the simulator spaces them.",
    )


def ground_rays(quick: bool = False) -> Case:
    """Mean sigma0 of diffuse ground whatever the rays: dense, as many as scatterer cells, fewer."""
    level, n_cells = -10.0, 128.0 if quick else 192.0
    sweeps = {
        "ray spacing over scatterer cell": ("rays", [0.5, 1.3] if quick else [0.3, 0.6, 0.8, 1.0, 1.3, 1.6])
    }
    return Case(
        name="ground_rays",
        topic="radiometry",
        title="Mean sigma0 of diffuse ground over the ray spacing",
        formula="sigma0 = -10 dB (constant law)",
        source="what the material was given",
        x_label="see the legend",
        y_label="sigma0 (dB)",
        comparisons=_swept(BASE, sweeps, level, n_cells),
        note="X band, 10 km, look angle 35 degrees: on the ground a tube is 1.22 times as long in range as in azimuth.",
    )


def _swept(
    base: Mapping[str, Any], sweeps: Mapping[str, tuple[str, list[Any]]], level: float, n_cells: float
) -> tuple[Comparison, ...]:
    """One comparison a series of scenes that differ in one parameter."""
    comparisons = []
    for label, (name, values) in sweeps.items():
        got, errors = [], []
        for value in values:
            mean, error = _ground_level(**({**base, name: value}), level=level, n_cells=n_cells)
            got.append(mean)
            errors.append(error)
        numbers = [float(i) if isinstance(v, str) else float(v) for i, v in enumerate(values)]
        x = np.log10(numbers) if label.startswith("log10") else np.asarray(numbers)
        comparisons.append(
            Comparison(
                label,
                np.asarray(x),
                np.full(len(values), level),
                np.asarray(got),
                tolerance=float(0.1 + 3.0 * max(errors)),
                reason=f"0.1 dB asked for, and 3 standard errors of speckle's mean ({max(errors):.3f} dB)",
                unit="dB",
                shown=0,
            )
        )
    return tuple(comparisons)


def _ground_level(
    *,
    look: float,
    cell: float,
    range: float,
    window: str,
    method: Literal["backprojection", "omega_k"],
    rays: float,
    level: float,
    n_cells: float,
) -> tuple[float, float]:
    """Mean sigma0 of an image of flat ground and its standard error, dB."""
    scatterer = 0.95 * cell
    settings = TraceSettings(max_depth=1, scatterer_cell=scatterer, ray_spacing=rays * scatterer)
    scene = ground_scene(look, cell, range, level, n_cells, settings=settings)
    image = chain(scene, window=window, method=method)
    sigma0 = image.sigma0()
    n_a, n_r = sigma0.shape
    inner = sigma0[n_a // 8 : -(n_a // 8), n_r // 8 : -(n_r // 8)]
    area = inner.size * image.grid.azimuth_spacing * image.grid.range_spacing
    looks = area / (image.azimuth_resolution_cell * image.range_resolution_cell)
    return float(db_from_power(inner.mean())), float(10.0 / np.log(10.0) / np.sqrt(looks))


CASES.register(CaseEntry("ground_sigma0", "radiometry", ground_sigma0))
CASES.register(CaseEntry("ground_rays", "radiometry", ground_rays))

__all__ = ["ground_rays", "ground_sigma0"]
