"""Three small metal scenes on a perfectly conducting ground whose exact scattering is stored.

The stored amplitudes come from the boundary-element solver of ``benchmarks/suite/full_wave.py``; see there. Lengths
are in wavelengths: the scenes are simulated at a wavelength of 1 m.
"""

import json
from dataclasses import dataclass
from functools import cache
from itertools import pairwise
from pathlib import Path

import numpy as np

from sarmitsuba.core.arrays import C128, F64
from sarmitsuba.core.constants import SPEED_OF_LIGHT
from sarmitsuba.core.errors import OutputError
from sarmitsuba.core.units import db_from_amplitude, db_from_power
from sarmitsuba.effects.catalog.max_depth import DEFAULT_DEPTH
from sarmitsuba.scene.geometry import Geometry
from sarmitsuba.simulation.execution.rcs import monostatic_rcs
from sarmitsuba.tracing.kernel.source import PointSource, Source
from sarmitsuba.tracing.scatterers.edges.diffraction import FringeCurrents, edges_of
from sarmitsuba.truth.validation import targets

CHANNELS = ("HH", "HV", "VV")
# level ranges below a scene's peak, dB, for the comparison
BELOW_PEAK = (0.0, 3.0, 10.0, 20.0, 30.0, 80.0)
REMAKE = "python -m benchmarks.suite.full_wave --compute FILE"
STORED = Path(__file__).parent / "full_wave.json"
WAVELENGTH = 1.0
ALL = slice(None)
# margin of the finite ground, which represents an infinite one, beyond the shadows and mirror images of the bodies;
# rotated so that its rim has no specular return towards the bodies' normals
GROUND_MARGIN = 8.0
GROUND_TURN = np.radians(17.0)

# plates of the corner, along x and along y
CORNER_WIDTH, CORNER_HEIGHT = 6.0, 5.0
BOX_X, BOX_Y, BOX_HEIGHT = 6.0, 4.0, 4.0
# upright cylinder in front of a plate in y = 0
PLATE_WIDTH, PLATE_HEIGHT = 6.0, 5.0
CYLINDER_RADIUS, CYLINDER_HEIGHT, CYLINDER_Y = 1.25, 5.0, 2.75
HIGHEST = 5.0
CYLINDER_SAGITTA = WAVELENGTH / 512.0


@dataclass(frozen=True)
class DirectionCut:
    """Directions towards the radar along one circle, degrees; azimuth from +x to +y.

    Parameters
    ----------
    axis : ``azimuth`` or ``elevation``, the angle that runs from ``first`` to ``last`` in steps of 1 degree
    fixed : the other angle
    glint : whether it contains a glint or a double bounce of flat parts; else all returns are from edges, corners and
        curved parts
    """

    axis: str
    fixed: float
    first: float
    last: float
    glint: bool = True

    @property
    def name(self) -> str:
        """For headings."""
        other = "elevation" if self.axis == "azimuth" else "azimuth"
        return f"over {self.axis}, {other} {self.fixed:g} deg"

    @property
    def angle(self) -> F64:
        """(n,) float64, deg."""
        return np.arange(self.first, self.last + 0.5)

    @property
    def looks(self) -> F64:
        """(n, 3) unit vectors."""
        a, b = np.radians(self.angle), np.radians(self.fixed)
        return targets.from_azimuth(a, b) if self.axis == "azimuth" else targets.from_azimuth(b, a)


@dataclass(frozen=True)
class FullWaveScene:
    """A scene of the stored reference."""

    name: str
    title: str
    cuts: tuple[DirectionCut, ...]


SCENES = {
    s.name: s
    for s in (
        FullWaveScene(
            "corner",
            f"Corner of two plates {CORNER_WIDTH:g} x {CORNER_HEIGHT:g} wavelengths on ground",
            (
                DirectionCut("azimuth", 20.0, -30.0, 45.0),
                DirectionCut("azimuth", 45.0, -30.0, 45.0),
                DirectionCut("elevation", 45.0, 10.0, 80.0),
                DirectionCut("elevation", 20.0, 10.0, 80.0),
            ),
        ),
        FullWaveScene(
            "box",
            f"Box {BOX_X:g} x {BOX_Y:g} x {BOX_HEIGHT:g} wavelengths on ground",
            (
                DirectionCut("azimuth", 20.0, 0.0, 90.0),
                DirectionCut("azimuth", 45.0, 0.0, 90.0),
                DirectionCut("elevation", 0.0, 10.0, 80.0),
                DirectionCut("elevation", 35.0, 10.0, 80.0, glint=False),
            ),
        ),
        FullWaveScene(
            "cylinder",
            f"Cylinder of radius {CYLINDER_RADIUS:g} beside a plate {PLATE_WIDTH:g} x {PLATE_HEIGHT:g} wavelengths "
            "on ground",
            (
                DirectionCut("azimuth", 20.0, -30.0, 90.0),
                DirectionCut("azimuth", 45.0, -30.0, 90.0),
                DirectionCut("elevation", 90.0, 10.0, 80.0),
                DirectionCut("elevation", 55.0, 10.0, 80.0, glint=False),
            ),
        ),
    )
}


def bodies(name: str) -> list[targets.Mesh]:
    """Meshes of a scene's body, without its ground."""
    if name == "corner":
        up = [0.0, 0.0, CORNER_HEIGHT]
        return [targets.parallelogram([0, 0, 0], edge, up) for edge in (np.eye(3)[:2] * CORNER_WIDTH)]
    if name == "box":
        x, y, z = np.diag([BOX_X, BOX_Y, BOX_HEIGHT])
        low, top = np.array([-BOX_X / 2, -BOX_Y / 2, 0.0]), np.array([-BOX_X / 2, -BOX_Y / 2, BOX_HEIGHT])
        sides = [(low, x, z), (low, y, z), (low + y, x, z), (low + x, y, z), (top, x, y)]
        return [targets.parallelogram(*side) for side in sides]
    plate = targets.parallelogram([-PLATE_WIDTH / 2, 0, 0], [PLATE_WIDTH, 0, 0], [0, 0, PLATE_HEIGHT])
    upright = targets.cylinder(CYLINDER_RADIUS, CYLINDER_HEIGHT, CYLINDER_SAGITTA)
    lift = np.array([0.0, CYLINDER_Y, 0.5 * CYLINDER_HEIGHT])
    # without its lower cap, which lies on the ground
    faces = upright.faces[~(upright.vertices[upright.faces][..., 2] < 0.0).all(axis=1)]
    return [plate, (upright.vertices + lift, faces)]


def ground(lowest: float) -> targets.Mesh:
    """Square of conducting ground for looks from an elevation, rad, upwards."""
    side = 2.0 * (GROUND_MARGIN + HIGHEST / np.tan(lowest))
    c, s = side * np.cos(GROUND_TURN), side * np.sin(GROUND_TURN)
    a, b = np.array([c, s, 0.0]), np.array([-s, c, 0.0])
    return targets.parallelogram(-0.5 * (a + b), a, b)


def simulate_amplitudes(name: str, cut: DirectionCut, pick: slice = ALL, *, edges: bool = False) -> C128:
    """Return the simulator's amplitudes with automatic settings, minus those of the bare ground.

    Parameters
    ----------
    name : of the scene
    cut : directions
    pick : which of them
    edges : with the fringe currents of sharp edges

    Returns
    -------
    (n, 3) complex128 : of ``CHANNELS``, root of the radar cross section in metres, phase referred to the origin
    """
    looks = cut.looks[pick]
    elevation = np.arcsin(looks[:, 2])
    out = np.empty((looks.shape[0], len(CHANNELS)), dtype=np.complex128)
    # shadows that differ by less than a factor of two share a ground
    reach = np.maximum(0.0, np.floor(-np.log2(np.tan(elevation))))
    for group in np.unique(reach):
        here = reach == group
        floor = ground(float(elevation[here].min()))
        out[here] = _trace_looks(targets.geometry([floor, *bodies(name)]), looks[here], edges)
        out[here] -= _trace_looks(targets.geometry([floor]), looks[here], edges)
    return out


def _trace_looks(geometry: Geometry, looks: F64, edges: bool) -> C128:
    sources: tuple[Source, ...] = ()
    if edges:
        sources = (PointSource(FringeCurrents(edges_of(geometry, targets.PEC, WAVELENGTH)), 3),)
    result = monostatic_rcs(
        geometry,
        targets.PEC,
        looks,
        SPEED_OF_LIGHT / WAVELENGTH,
        channels=CHANNELS,
        max_depth=DEFAULT_DEPTH,  # what an image of the scene follows
        sources=sources,
    )
    low, high = geometry.bounds
    # phases are referred to the centre of the bounds
    shift = np.exp(4j * np.pi / WAVELENGTH * (looks @ (0.5 * (low + high))))
    total: C128 = result.amplitude.sum(axis=1) * shift[:, None]
    return total


@cache
def read_stored(path: Path = STORED) -> dict[str, dict[str, C128]]:
    """Exact amplitudes per scene and cut, (n, 3) complex128 of ``CHANNELS``, phase referred to the origin.

    Raises
    ------
    OutputError
        The file lacks a scene or a cut, or holds another number of directions.
    """
    given = json.loads(path.read_text(encoding="utf-8"))
    out: dict[str, dict[str, C128]] = {}
    for name, scene in SCENES.items():
        out[name] = {}
        for cut in scene.cuts:
            rows = np.asarray(given.get(name, {}).get("amplitude", {}).get(cut.name, []), dtype=np.float64)
            if rows.shape != (cut.angle.size, 2 * len(CHANNELS)):
                raise OutputError(
                    f"{path}: scene {name!r}, {cut.name}: {rows.shape} numbers instead of "
                    f"{(cut.angle.size, 2 * len(CHANNELS))}; make it again with `{REMAKE}`"
                )
            out[name][cut.name] = rows.view(np.complex128)
    return out


@dataclass(frozen=True)
class LevelBand:
    """Accuracy for directions with the exact level in a range below the scene's peak.

    Parameters
    ----------
    near, far : dB below the peak of all cuts
    n : directions
    mean_db : simulated over exact mean power
    rms_db : of the levels' difference, direction by direction
    """

    near: float
    far: float
    n: int
    mean_db: float
    rms_db: float


def bands(exact: C128, simulated: C128) -> list[LevelBand]:
    """Accuracy of the simulation by level below the peak; one channel, (n,) each."""
    want, got = np.abs(exact), np.maximum(np.abs(simulated), 1e-12)
    below = db_from_amplitude(want.max() / want)
    out = []
    for near, far in pairwise(BELOW_PEAK):
        here = (below >= near) & (below < far)
        if here.any():
            ratio = db_from_amplitude(got[here] / want[here])
            mean = db_from_power(np.sum(got[here] ** 2) / np.sum(want[here] ** 2))
            out.append(LevelBand(near, far, int(here.sum()), float(mean), float(np.sqrt(np.mean(ratio**2)))))
    return out
