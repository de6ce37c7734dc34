"""Mean sigma0 of diffuse ground, end to end: from traced echoes to calibrated pixels."""

from dataclasses import dataclass

import numpy as np

from sarmitsuba.core.units import db_from_power
from sarmitsuba.scene.settings import TraceSettings
from sarmitsuba.truth.validation.cases import CASES, CaseEntry
from sarmitsuba.truth.validation.chain import METHODS, WINDOWS, Method, chain, ground_scene
from sarmitsuba.truth.validation.comparison import Case, Comparison


@dataclass(frozen=True)
class Setup:
    """One image of flat ground.

    Parameters
    ----------
    look : angle, deg
    cell : of resolution, m
    slant_range : m
    window : of both axes
    method : focuser
    rays : spacing over the scatterer cell, 0 = the simulator's choice
    """

    look: float = 35.0
    cell: float = 1.0
    slant_range: float = 10e3
    window: str = "rectangular"
    method: Method = METHODS[0]
    rays: float = 0.0


# label -> x, setup
Sweeps = dict[str, list[tuple[float, Setup]]]


def ground_sigma0(quick: bool = False) -> Case:
    """Mean sigma0 of diffuse ground over look angle, resolution, range, window and focuser."""
    level, n_cells = -10.0, 128.0 if quick else 192.0
    looks = [35.0] if quick else [20.0, 35.0, 50.0, 60.0]
    cells = [0.3, 3.0] if quick else [0.1, 0.3, 1.0, 3.0, 10.0]
    ranges = [700e3] if quick else [1e3, 10e3, 100e3, 1000e3]
    windows = ["hamming"] if quick else list(WINDOWS)
    methods = [METHODS[1]] if quick else list(METHODS)
    sweeps: Sweeps = {
        "look angle (deg)": [(x, Setup(look=x)) for x in looks],
        "log10(cell / m)": [(np.log10(x), Setup(cell=x)) for x in cells],
        "log10(range / m)": [(np.log10(x), Setup(slant_range=x)) for x in ranges],
        "window": [(i, Setup(window=x)) for i, x in enumerate(windows)],
        "focuser (0 backprojection, 1 omega-k)": [(i, Setup(method=x)) for i, x in enumerate(methods)],
    }
    return Case(
        name="ground_sigma0",
        topic="radiometry",
        title="Mean sigma0 of diffuse ground, end to end",
        formula="sigma0 = -10 dB (constant law)",
        source="what the material was given",
        x_label="see the legend",
        y_label="sigma0 (dB)",
        comparisons=_swept(sweeps, level, n_cells),
        note=f"X band; {n_cells:g} x {n_cells:g} resolution cells, mean over the inner three quarters; "
        "rays as the simulator spaces them.",
    )


def ground_rays(quick: bool = False) -> Case:
    """Mean sigma0 of diffuse ground whatever the rays: dense, as many as scatterer cells, fewer."""
    level, n_cells = -10.0, 128.0 if quick else 192.0
    shares = [0.5, 1.3] if quick else [0.3, 0.6, 0.8, 1.0, 1.3, 1.6]
    sweeps: Sweeps = {"ray spacing over scatterer cell": [(x, Setup(rays=x)) for x in shares]}
    return Case(
        name="ground_rays",
        topic="radiometry",
        title="Mean sigma0 of diffuse ground over the ray spacing",
        formula="sigma0 = -10 dB (constant law)",
        source="what the material was given",
        x_label="see the legend",
        y_label="sigma0 (dB)",
        comparisons=_swept(sweeps, level, n_cells),
        note="X band, 10 km, look angle 35 degrees: on the ground a tube is 1.22 times as long in range as in azimuth.",
    )


def _swept(sweeps: Sweeps, level: float, n_cells: float) -> tuple[Comparison, ...]:
    """One comparison per series of images that differ in one parameter."""
    comparisons = []
    for label, series in sweeps.items():
        measured = [_ground_level(setup, level, n_cells) for _, setup in series]
        got, errors = zip(*measured, strict=True)
        comparisons.append(
            Comparison(
                label,
                np.asarray([x for x, _ in series], dtype=np.float64),
                np.full(len(series), level),
                np.asarray(got),
                tolerance=float(0.1 + 3.0 * max(errors)),
                reason=f"0.1 dB asked for, and 3 standard errors of speckle's mean ({max(errors):.3f} dB)",
                unit="dB",
                shown=0,
            )
        )
    return tuple(comparisons)


def _ground_level(setup: Setup, level: float, n_cells: float) -> tuple[float, float]:
    """Mean sigma0 of an image of flat ground and its standard error, dB."""
    scatterer = 0.95 * setup.cell
    settings = TraceSettings(max_depth=1, scatterer_cell=scatterer, ray_spacing=setup.rays * scatterer)
    scene = ground_scene(setup.look, setup.cell, setup.slant_range, level, n_cells, settings=settings)
    image = chain(scene, window=setup.window, method=setup.method)
    sigma0 = image.sigma0()
    n_a, n_r = sigma0.shape
    inner = sigma0[n_a // 8 : -(n_a // 8), n_r // 8 : -(n_r // 8)]
    area = inner.size * image.grid.azimuth_spacing * image.grid.range_spacing
    looks = area / (image.azimuth_resolution_cell * image.range_resolution_cell)
    return float(db_from_power(inner.mean())), float(10.0 / np.log(10.0) / np.sqrt(looks))


CASES.register(CaseEntry("ground_sigma0", "radiometry", ground_sigma0))
CASES.register(CaseEntry("ground_rays", "radiometry", ground_rays))
