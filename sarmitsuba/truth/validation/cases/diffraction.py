"""Edges of metal: physical optics with fringe currents against wedges and plates in closed form."""

import numpy as np

from sarmitsuba.core.arrays import C128, F64
from sarmitsuba.core.units import db_from_power
from sarmitsuba.scene.geometry import Geometry
from sarmitsuba.simulation.execution.rcs import RcsResult, monostatic_rcs
from sarmitsuba.tracing.kernel.source import PointSource
from sarmitsuba.tracing.scatterers.edges.diffraction import FringeCurrents, edges_of
from sarmitsuba.truth import theory
from sarmitsuba.truth.validation import targets
from sarmitsuba.truth.validation.band_sampling import BANDS, bands, wavelength
from sarmitsuba.truth.validation.cases import CASES, CaseEntry
from sarmitsuba.truth.validation.comparison import Case, Comparison

# sides of the plate and of the prisms' cross-sections, and lengths of their edges, wavelengths; no two bands alike
WIDTH = {"L": 4.0, "C": 5.0, "X": 6.3, "Ka": 7.5}
HEIGHT = {"L": 40.0, "C": 50.0, "X": 63.0, "Ka": 75.0}
# angles between the sides of prisms, deg: edges of N = 1.5, of 5/3 and of 11/6
PRISMS = {"square edges": (90.0, 90.0), "edges of 60 deg": (60.0, 60.0), "edges of 30 deg": (30.0, 75.0)}
EDGE_FLOOR, PRISM_FLOOR = 25.0, 35.0
# up to where the multiply diffracted plate holds, deg off the normal
ROSS_UP_TO = 60.0


def edge_plate(quick: bool = False) -> Case:
    """Plate from 5 degrees off its normal to edge-on."""
    comparisons, notes = [], []
    for band in bands(quick):
        lam = wavelength(band)
        width, height = WIDTH[band] * lam, HEIGHT[band] * lam
        degrees = np.linspace(5.0, 90.0, 35 if quick else 171)
        angle = np.radians(degrees)
        look = np.stack([np.sin(angle), np.zeros_like(angle), np.cos(angle)], axis=1)
        result = _trace_with_edges(targets.plate(width, height), look, band)
        closed = theory.plate_along_its_sheet(width, height, lam, angle)
        for channel, want in zip(("HH", "VV"), closed, strict=True):
            comparisons.append(
                Comparison(
                    f"{band}, {WIDTH[band]:g} wavelengths, {channel}",
                    degrees,
                    db_from_power(np.maximum(want, 1e-30)),
                    result.rcs_dbsm(channel),
                    tolerance=0.2,
                    reason="the two rims that the tilt does not part, a wavelength of edge each; widths of the "
                    "sheet found by bisection",
                    floor=EDGE_FLOOR,
                    canonical=True,
                    shown=-1 if channel == "HH" else None,
                )
            )
        both = [np.abs(result.amplitude[:, 0, i]) for i in (0, 1)]
        here = degrees <= ROSS_UP_TO
        ross = theory.plate_with_edges(width, height, lam, angle[here], order=2)
        off = [np.abs(np.sqrt(w) - a[here]).max() for w, a in zip(ross, both, strict=True)]
        share = np.array(off) / float(np.sqrt(theory.edge_on_rcs(height)))
        notes.append(f"{band}: HH {share[0]:.2f}, VV {share[1]:.2f}")
    return Case(
        name="edge_plate",
        topic="canonical",
        title="Plate towards edge-on: physical optics and fringe currents",
        formula="(b^2 / pi) |cos(k a sin t) - j sin(k a sin t) / sin t|^2 in HH, b^2 / pi edge-on; in VV the far "
        "rim's coefficient less 2 (T - 1) / cos(g / 2) + (T - 1)^2, T = F(w) - F(-w), w = sqrt(2 k a) sin(g / 2), "
        "g = 90 deg - t",
        source="Ross, IEEE TAP 14 (1966), singly diffracted; Knott, Shaeffer and Tuley, Radar Cross Section (1993); "
        "Sommerfeld, Optics (1954)",
        x_label="angle off the normal (deg)",
        y_label="RCS (dBsm)",
        comparisons=tuple(comparisons),
        note="Physical optics alone falls without bound, to nothing edge-on, the same in HH and VV. Off Ross's "
        f"multiply diffracted plate, up to {ROSS_UP_TO:g} degrees, in shares of the edge-on amplitude (its waves "
        f"between the rims are those far from grazing): {'; '.join(notes)}.",
    )


def edge_wedges(quick: bool = False) -> Case:
    """Prisms over azimuth: every edge that is seen returns the exact coefficient of its wedge."""
    band, comparisons = "X", []
    lam = wavelength(band)
    side, height = 7.3 * lam, 250.0 * lam
    for name, (apex, base) in list(PRISMS.items())[:: 2 if quick else 1]:
        corners = _square(side) if base == apex == 90.0 else _isosceles(side, apex)
        n = 24 if quick else 160
        # 6 mrad off the planes of all sides: Keller's sum jumps there, where the simulation lets the far edge fade
        azimuth = np.linspace(0.0, 2.0 * np.pi, n, endpoint=False) + 0.0065
        result = _trace_with_edges(_prism(corners, height), targets.from_azimuth(azimuth), band)
        exact = _keller(corners, height, lam, azimuth)
        for i, channel in enumerate(("VV", "HH")):
            comparisons.append(
                Comparison(
                    f"{name}, {channel}",
                    np.degrees(azimuth),
                    db_from_power(np.abs(exact[i]) ** 2),
                    result.rcs_dbsm(channel),
                    tolerance=0.3,
                    reason="far edges of the caps, which the wave grazes: 7.3 wavelengths of edge, next to 250",
                    floor=PRISM_FLOOR,
                    canonical=True,
                )
            )
    return Case(
        name="edge_wedges",
        topic="canonical",
        title="Prisms of three wedges: physical optics and fringe currents add up to the exact diffraction coefficient",
        formula="sum over the edges seen of (j / sqrt(pi)) L D_s,h(N, p, p) e^(2 j k r), "
        "D = sin(pi/N)/N [1/(cos(pi/N) - 1) -+ 1/(cos(pi/N) - cos(2 p/N))]",
        source="Keller, J. Opt. Soc. Am. 52 (1962); Ufimtsev (1962)",
        x_label="azimuth (deg)",
        y_label="RCS (dBsm)",
        comparisons=tuple(comparisons),
        note="VV has the field along the edges. The coefficient is infinite where a side faces the radar; the sum of "
        "two edges there is the side's return.",
    )


def _trace_with_edges(geometry: Geometry, look: F64, band: str) -> RcsResult:
    source = PointSource(FringeCurrents(edges_of(geometry, targets.PEC, wavelength(band))))
    return monostatic_rcs(geometry, targets.PEC, look, BANDS[band], max_depth=1, sources=(source,))


def _square(side: float) -> F64:
    """(4, 2) corners, counter-clockwise, about their middle."""
    return 0.5 * side * np.array([[-1.0, -1.0], [1.0, -1.0], [1.0, 1.0], [-1.0, 1.0]])


def _isosceles(side: float, apex: float) -> F64:
    """(3, 2) corners of a triangle with two equal sides and the angle between them, deg, counter-clockwise."""
    half = 0.5 * np.radians(apex)
    corners = side * np.array([[0.0, 0.0], [np.cos(half), -np.sin(half)], [np.cos(half), np.sin(half)]])
    return np.asarray(corners - corners.mean(axis=0))


def _prism(corners: F64, height: float) -> Geometry:
    """Upright prism, centred in height, with its caps."""
    n = len(corners)
    low, high = (np.column_stack([corners, np.full(n, z)]) for z in (-0.5 * height, 0.5 * height))
    i = np.arange(n)
    j = np.roll(i, -1)
    fan = np.column_stack([np.zeros(n - 2, dtype=int), i[1:-1], i[2:]])
    faces = np.concatenate(
        [np.column_stack([i, j, j + n]), np.column_stack([i, j + n, i + n]), fan[:, ::-1], fan + n]
    )
    return targets.geometry([(np.concatenate([low, high]), faces.astype(np.int32))])


def _keller(corners: F64, height: float, lam: float, azimuth: F64) -> C128:
    """(2, n) amplitudes, field along and across the upright edges, phase about the middle of the bounds."""
    look = np.stack([np.cos(azimuth), np.sin(azimuth)], axis=1)
    total = np.zeros((2, azimuth.size), dtype=np.complex128)
    middle = 0.5 * (corners.min(axis=0) + corners.max(axis=0))
    for before, here, after in zip(
        np.roll(corners, 1, axis=0), corners, np.roll(corners, -1, axis=0), strict=True
    ):
        into, on = (np.arctan2(*(x - here)[::-1]) for x in (before, after))
        # from the side that comes after, through the outside, to the side before
        exterior = (into - on) % (2.0 * np.pi)
        exterior, start, turn = (
            (exterior, on, 1.0) if exterior > np.pi else (2.0 * np.pi - exterior, on, -1.0)
        )
        phi = (turn * (azimuth - start)) % (2.0 * np.pi)
        seen = phi < exterior
        phase = np.exp(4j * np.pi / lam * (look @ (here - middle)))
        for i, d in enumerate(theory.wedge_coefficients(exterior / np.pi, phi, phi)):
            total[i] += np.where(seen, 1j / np.sqrt(np.pi) * height * d * phase, 0.0)
    return total


CASES.register(CaseEntry("edge_plate", "canonical", edge_plate))
CASES.register(CaseEntry("edge_wedges", "canonical", edge_wedges))
