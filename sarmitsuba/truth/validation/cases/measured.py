"""Bodies of the Austin RCS Benchmark Suite over azimuth, with default settings, against measurement and full wave."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import partial
from types import MappingProxyType

import numpy as np

from sarmitsuba.loading.build import MaterialLike, SceneMesh, build_scene
from sarmitsuba.radar.description import RadarDescription
from sarmitsuba.scene.materials.material import Material
from sarmitsuba.simulation.execution.turntable import Aspects, RcsSweep, rcs_sweep
from sarmitsuba.truth.validation.cases import CASES, CaseEntry
from sarmitsuba.truth.validation.comparison import Case, Comparison
from sarmitsuba.truth.validation.measured import bodies
from sarmitsuba.truth.validation.measured.azimuth_tables import azimuth_table
from sarmitsuba.truth.validation.targets import Mesh

MESH = "solved currents: edges of a 7th to a 16th of a wavelength at sharp edges, where currents are infinite"
RIMS = "corners of a plate of 2.6 wavelengths and more: with the solved strip for its rims 0.03 to 0.3 dB"
CHANNELS = ("HH", "VV")
# dB below the solver's peak: what is compared and what the plot shows
FLOOR, DRAWN = 20.0, 45.0
# frequency, Hz, and angles of the quick form: one of so many
QUICK, EVERY = 7e9, 2
DIELECTRIC = Material(
    "dielectric", permittivity=bodies.DIELECTRIC_PERMITTIVITY, thickness=bodies.DIELECTRIC_THICKNESS
)


@dataclass(frozen=True)
class Bound:
    """Tolerances of one frequency.

    Parameters
    ----------
    frequency : Hz
    rms_db : dB, HH and VV
    reason : cause of a deviation of this size
    sector : azimuths that are compared, deg; the levels then count from the peak in the sector
    """

    frequency: float
    rms_db: tuple[float, float]
    reason: str
    sector: tuple[float, float] = (0.0, 180.0)

    @property
    def label(self) -> str:
        """For headings."""
        low, high = self.sector
        part = f", {low:g} to {high:g} deg" if self.sector != (0.0, 180.0) else ""
        return f"{self.frequency / 1e9:g} GHz{part}"


@dataclass(frozen=True)
class MeasuredBody:
    """One body with its table.

    Parameters
    ----------
    title : one line
    table : name of its table
    mesh : makes it
    bounds : tolerances
    material : of its surface
    """

    title: str
    table: str
    mesh: Callable[[], Mesh]
    bounds: tuple[Bound, ...]
    material: MaterialLike = "pec"


BODIES = {
    "plate": MeasuredBody(
        "Metal plate without thickness, 0.267 m x 0.152 m",
        "II_A_sx1",
        bodies.plate,
        (
            Bound(2.56e9, (0.2, 0.3), MESH),
            Bound(5.12e9, (0.3, 0.3), RIMS),
            Bound(7e9, (0.1, 0.3), RIMS),
            Bound(10.2e9, (0.25, 0.15), RIMS),
        ),
    ),
    "thick_plate": MeasuredBody(
        "Metal plate 1.6 mm thick",
        "II_B_sx1",
        bodies.thick_plate,
        (
            Bound(2.56e9, (0.3, 0.15), MESH),
            Bound(7e9, (0.25, 0.3), RIMS + "; a thickness of a 26th, to its first order"),
        ),
    ),
    "dielectric_plate": MeasuredBody(
        "Dielectric plate 1.5 mm thick",
        "II_C_sx1",
        bodies.plate,
        (Bound(7e9, (0.35, 0.25), "its rims, which scatter as if black"),),
        DIELECTRIC,
    ),
    "almond": MeasuredBody(
        "NASA almond of 0.252 m",
        "III_A_s1",
        bodies.almond,
        (
            Bound(
                7e9,
                (0.9, 0.7),
                MESH + "; chords in place of a rim of 0.13 wavelengths' radius",
            ),
        ),
    ),
    "prism": MeasuredBody(
        "Hexagonal prism of 0.4 m",
        "IIIS_A_s1",
        bodies.prism,
        (
            Bound(2.56e9, (0.25, 0.15), MESH),
            Bound(7e9, (0.3, 0.2), "diffraction by edges 3 to 9 wavelengths apart"),
        ),
    ),
    "duct": MeasuredBody(
        "Prism with a curved duct",
        "IIIS_B_s1",
        bodies.duct,
        (
            Bound(7e9, (0.35, 0.2), "diffraction by edges 3 to 9 wavelengths apart"),
            Bound(
                7e9,
                (9.0, 9.5),
                "a duct of 2 to 2.6 wavelengths holds a few modes: geometrical optics and its caustics do not",
                (0.0, 60.0),
            ),
        ),
    ),
}


def swept(
    name: str, frequency: float, every: int = 1, settings: Mapping[str, str] = MappingProxyType({})
) -> RcsSweep:
    """Sweep of a body over every so many azimuths of its table, with settings of the scene other than default ones."""
    body = BODIES[name]
    vertices, faces = body.mesh()
    scene = build_scene(
        [SceneMesh(vertices, faces, body.material, name)],
        radar=RadarDescription(center_frequency=frequency),
        name=name,
    )
    azimuth = np.radians(azimuth_table(body.table, frequency, CHANNELS[0]).azimuth[::every])
    scene = scene.replace(**settings)
    return rcs_sweep(scene, Aspects(azimuth, np.zeros_like(azimuth)), channels=CHANNELS)


def body_case(name: str, quick: bool = False) -> Case:
    """One body at all its frequencies; quick: at 7 GHz, every second azimuth."""
    body, every = BODIES[name], EVERY if quick else 1
    comparisons, sweeps = [], {}
    for bound in body.bounds:
        if quick and bound.frequency != QUICK:
            continue
        if bound.frequency not in sweeps:
            sweeps[bound.frequency] = swept(name, bound.frequency, every)
        sweep = sweeps[bound.frequency]
        for channel, tolerance in zip(CHANNELS, bound.rms_db, strict=True):
            table = azimuth_table(body.table, bound.frequency, channel)
            azimuth = table.azimuth[::every]
            inside = (azimuth >= bound.sector[0]) & (azimuth <= bound.sector[1])
            comparisons.append(
                Comparison(
                    f"{bound.label}, {channel}",
                    azimuth[inside],
                    table.solver[::every][inside],
                    sweep.dbsm(channel)[inside],
                    tolerance=tolerance,
                    reason=bound.reason,
                    floor=FLOOR,
                    drawn=DRAWN,
                    judged="rms",
                    reference="solver",
                    measured=table.chamber[::every][inside],
                    stated=sweep.statement.over(inside).total_db[CHANNELS.index(channel)],
                )
            )
    stated = "; ".join(
        f"{f / 1e9:g} GHz {max(sweep.error_db):.0f} dB, {sweep.result.rays_per_direction} rays"
        for f, sweep in sweeps.items()
    )
    return Case(
        name=f"measured_{name}",
        topic="measured",
        title=body.title,
        formula="converged surface-integral solver; measurement in an anechoic chamber",
        source="Austin RCS Benchmark Suite, The University of Texas at Austin (2023)",
        x_label="azimuth (deg)",
        y_label="RCS (dBsm)",
        comparisons=tuple(comparisons),
        note=f"Default settings of `rcs`. Compared where the solver lies within {FLOOR:g} dB of its peak, by the rms "
        "of the difference in dB; beside it the same of the measurement, and what `rcs` states of these directions: "
        "sampling, bounces left out and theory. A row also fails where the rms exceeds the stated error by 2 dB. "
        f"Sampling error and rays per direction: {stated}.",
    )


for _name in BODIES:
    CASES.register(CaseEntry(f"measured_{_name}", "measured", partial(body_case, _name)))
