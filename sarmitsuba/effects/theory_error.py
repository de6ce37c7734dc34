"""Expected error of physical optics and edge waves in dB, and its causes, for a pattern of radar cross sections."""

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
import scipy
from numpy.typing import NDArray

from sarmitsuba.core.arrays import C128, F64
from sarmitsuba.core.units import power_from_db
from sarmitsuba.core.witness import Witness
from sarmitsuba.effects.fold_sections import (
    Folds,
    coplanar_parts,
    find_folds,
    fold_error,
    fold_grids,
)
from sarmitsuba.effects.omitted_waves import (
    AS_EDGE,
    BENT,
    BETWEEN,
    CURVED,
    EDGES_OFF,
    ONE_RIM,
    ROUNDED,
    MetalLines,
    SimulatedWaves,
    metal_lines,
    omitted_energy,
)
from sarmitsuba.effects.waves_between import MetalFaces, gaps, metal_faces, waves_between
from sarmitsuba.scene.geometry import Geometry
from sarmitsuba.scene.materials.fresnel import fresnel
from sarmitsuba.scene.materials.map_materials import list_with_parts
from sarmitsuba.scene.materials.material import Material
from sarmitsuba.scene.mesh.double_faces import double_faces
from sarmitsuba.scene.mesh.sharp_edges import ONE_EDGE
from sarmitsuba.scene.visible_faces import VisibleFaces

# dB below the peak down to which the error is stated
STRONG_DB = 20.0
# most flat facets that are examined, triangles before those of a plane are joined, and directions
MOST_FACES, MOST_TRIANGLES, MOST_DIRECTIONS = 60_000, 1_000_000, 360
# most metal faces that an image's account examines, and between which folds are followed
MOST_IMAGE_FACES = 20_000
# wavelengths: largest extent of a body in the Rayleigh region, and second largest of one that resonates as a wire does
LEAST_SIZE, LEAST_WIDTH = 0.5, 0.2
# a cause is named where its part of the mean square error is above this
_NAMED = 0.15
_LOG = 20.0 / math.log(10.0)
# ratio of energies beyond which a level counts as absent
_ABSENT = 1e4
REPEATED, BODIES, FOLDED = "repeated bounces", "between bodies", "folds"
CROSS = ("HV", "VH")


def expected_square(ratio: F64) -> F64:
    r"""Mean square of the error in dB of a level to which a wave of unknown phase is missing.

    .. math:: \langle (20 \lg |1 + \rho e^{j \phi}|)^2 \rangle = \left(\frac{20}{\ln 10}\right)^2 \left[
        \tfrac12 \mathrm{Li}_2(\min(\rho^2, \rho^{-2})) + \max(0, \ln \rho)^2 \right]

    from the series of :math:`\ln |1 + z|`, whose terms are orthogonal over the phase.

    Parameters
    ----------
    ratio : energy of the missing wave over that of the others, :math:`\rho^2`, any shape
    """
    r = np.maximum(np.asarray(ratio, dtype=np.float64), 1e-300)
    inner = scipy.special.spence(1.0 - np.minimum(r, 1.0 / r))
    return np.asarray(_LOG**2 * (0.5 * inner + np.square(np.maximum(0.5 * np.log(r), 0.0))))


def rms_db(missing: F64, power: F64) -> F64:
    """Expected rms error, dB, (n_channels,), where the level with the missing waves lies near its peak.

    The strong part lies within ``STRONG_DB`` of the peak.

    Parameters
    ----------
    missing, power : (n_directions, n_channels) float64, m^2, energy of missing waves and simulated RCS
    """
    both = missing + power
    strong = (both >= both.max(axis=0, initial=0.0) * power_from_db(-STRONG_DB)) & (both > 0.0)
    square = expected_square(np.minimum(missing / np.maximum(power, 1e-300), _ABSENT)) * strong
    return np.asarray(np.sqrt(square.sum(axis=0) / np.maximum(strong.sum(axis=0), 1)))


def reflection_of(material: Material, wavelength: float) -> float:
    """Modulus of the amplitude that a surface reflects at normal incidence."""
    if material.metallic:
        return 1.0
    (part,) = list_with_parts([material])[:1]
    gamma = complex(fresnel(1.0, part.permittivity)[0])
    if part.thickness > 0.0:
        phase = np.exp(-4j * np.pi * np.sqrt(complex(part.permittivity)) * part.thickness / wavelength)
        gamma = gamma * (1.0 - phase) / (1.0 - gamma**2 * phase)
    return min(abs(gamma), 1.0)


@dataclass(frozen=True)
class TheoryCause:
    """One cause of the error of the theory: its text, and the rms error that it alone would have, dB."""

    text: str
    rms_db: float


@dataclass(frozen=True, eq=False)
class TheoryError:
    """Energy of the waves that the theory leaves out, by direction, and its causes.

    Parameters
    ----------
    missing : (n_directions, n_channels) float64, m^2, energy of the waves left out
    rms_db : (n_channels,) float64, dB, expected rms error in the strong part of the pattern; infinite: not known
    causes : the largest first
    unknown : reason why the error is not known; empty where it is
    counted : (n_channels,) bool, channels that the text is of: not cross-polar ones beside others, which metal returns
        weakly, in physical optics often not at all
    doubtful : whether the reason calls for a warning: a body outside the theory, rather than one it says nothing of
    witness : error of a drawn pair of faces, measured; None without one
    """

    missing: F64
    rms_db: F64
    causes: tuple[TheoryCause, ...]
    counted: NDArray[np.bool_]
    unknown: str = ""
    doubtful: bool = False
    witness: Witness | None = None

    @property
    def worst_db(self) -> float:
        """Largest expected error of the counted channels, dB."""
        return float(self.rms_db[self.counted].max(initial=0.0))

    @property
    def text(self) -> str:
        """Statement such as ``theory about 0.4 dB (waves between edges 2.3 wavelengths apart)``."""
        if self.unknown:
            return f"theory not known ({self.unknown})"
        named = [c for c in self.causes if c.rms_db**2 > _NAMED * sum(x.rms_db**2 for x in self.causes)]
        why = f" ({'; '.join(c.text for c in named)})" if named else ""
        return f"theory {state_error(self.worst_db)}{why}"


def state_error(error_db: float) -> str:
    """Text of an expected error, dB: ``about 0.4 dB``, ``not better than 8 dB``."""
    if not math.isfinite(error_db):
        return "not known"
    if error_db > 3.0:
        return f"not better than {error_db:.0f} dB"
    return f"about {max(error_db, 0.01):.1g} dB" if error_db < 1.0 else f"about {error_db:.1f} dB"


def theory_error(
    geometry: Geometry,
    materials: Sequence[Material],
    directions: F64,
    amplitude: C128,
    channels: Sequence[str],
    wavelength: float,
    waves: SimulatedWaves,
) -> TheoryError:
    """Expected error of a simulated pattern by waves beyond physical optics and edge waves.

    Parameters
    ----------
    geometry, materials : the target
    directions : (n, 3) float64, unit vectors to the radar
    amplitude : (n, n_orders, n_channels) complex128, m, simulated, by bounce order
    channels : such as HH
    wavelength : m
    waves : that are simulated beyond physical optics

    Notes
    -----
    Missing waves count by the laws of :mod:`sarmitsuba.effects.omitted_waves`, repeated bounces by a share of the echo
    that they return; their energies add. Not known: bodies smaller than half a wavelength or thinner than a fifth both
    ways, bodies of a dielectric (waves inside are not simulated), and targets of more than ``MOST_FACES`` triangles.
    """
    shape = (len(directions), len(channels))
    counted = np.array([channel not in CROSS for channel in channels])
    counted |= not counted.any()
    seen = VisibleFaces.of(geometry, materials)
    corners = seen.corners
    if not len(corners):
        return TheoryError(np.zeros(shape), np.zeros(shape[1]), (), counted)
    used = [materials[i] for i in np.unique(geometry.face_material[seen.face])]
    unknown, doubtful = _outside(corners, used, wavelength)
    if unknown:
        return TheoryError(np.full(shape, np.inf), np.full(shape[1], np.inf), (), counted, unknown, doubtful)
    # faces that another shape gives again count once, as in what is simulated
    once = ~double_faces(corners, seen.shape)
    corners, face = corners[once], seen.face[once]
    by_material = np.array([reflection_of(m, wavelength) for m in materials])
    power = np.square(np.abs(amplitude.sum(axis=1)))
    some = _some(power)
    reflection = by_material[geometry.face_material[face]]
    left = waves_left(corners, reflection, directions, some, channels, wavelength, waves)
    missing = dict(left.energy)
    share = left.repeated_share(wavelength, amplitude.shape[1])
    missing[REPEATED] = np.einsum("noc,o->nc", np.square(np.abs(amplitude[some])), share)
    total = np.sum(list(missing.values()), axis=0)
    causes = [
        TheoryCause(left.text(name, wavelength), float(rms_db(part, power[some])[counted].max()))
        for name, part in missing.items()
        if part.any()
    ]
    whole = np.zeros(shape)
    order = np.argsort(some)
    for i in range(shape[1]):
        whole[:, i] = np.interp(np.arange(shape[0]), some[order], total[order, i])
    ordered = tuple(sorted(causes, key=lambda c: -c.rms_db))
    return TheoryError(whole, rms_db(total, power[some]), ordered, counted, witness=left.witness)


@dataclass(frozen=True, eq=False)
class WavesLeft:
    """Waves that the theory leaves out.

    Parameters
    ----------
    energy : (n, n_channels) float64 each, m^2, as an RCS, by cause
    lines, faces, folds : of the surface
    gap : m, mean way between bodies
    fold : row of the fold with most; -1 without one
    extent : m, largest of the surface
    witness : measured error of a fold's section; None without one
    """

    energy: dict[str, F64]
    lines: MetalLines
    faces: MetalFaces
    folds: Folds
    gap: float
    fold: int
    extent: float
    witness: Witness | None

    @property
    def sectioned(self) -> bool:
        """Whether all bounces are those of sections by moments: of folds with two faces each, and no others."""
        return bool(
            self.folds.n
            and self.folds.plain.all()
            and not self.folds.square.any()
            and np.isinf(gaps(self.faces)).all()
        )

    def repeated_share(self, wavelength: float, n_orders: int) -> F64:
        """Share of the energy of 1, 2, ... bounces by which ray optics is wrong, beyond that of sections."""
        if self.sectioned:
            return np.zeros(n_orders)
        width = min(self.lines.face_width, self.extent) / wavelength
        return repeated_share(self.faces, width, wavelength, n_orders)

    def text(self, name: str, wavelength: float) -> str:
        """Text of a cause with the sizes that matter."""
        if name != FOLDED or self.fold < 0:
            return cause_text(name, self.lines, wavelength, self.gap)
        first, second = np.sort(self.folds.width[self.fold]) / wavelength
        angle = np.degrees(self.folds.angle[self.fold])
        return f"the fold of {angle:.0f} deg between faces {first:.2g} and {second:.2g} wavelengths wide"


def waves_left(
    corners: F64,
    reflection: F64,
    directions: F64,
    some: NDArray[np.intp],
    channels: Sequence[str],
    wavelength: float,
    waves: SimulatedWaves,
) -> WavesLeft:
    """Waves of a surface that are left out in some of the directions.

    Parameters
    ----------
    corners : (n, 3, 3) float64, m
    reflection : (n,) float64, amplitude at normal incidence, 1 for metal
    directions : (n_directions, 3) float64, unit vectors to the radar, all that are simulated
    some : numbers of those that are examined
    channels, wavelength, waves : see :func:`theory_error`
    """
    lines, faces = metal_lines(corners, reflection, wavelength), metal_faces(corners)
    folds = find_folds(corners[reflection > 1.0 - 1e-9], wavelength)
    grids = fold_grids(folds, wavelength, directions) if waves.folds else []
    folded = fold_error(folds, grids, directions[some], channels, wavelength, edges=waves.edges)
    between = waves_between(lines, faces, directions[some], channels, wavelength)
    energy = omitted_energy(remove_folds(lines, folds), directions[some], channels, wavelength, waves)
    energy |= {BODIES: between.energy, FOLDED: folded.energy}
    extent = float(np.ptp(corners.reshape(-1, 3), axis=0).max())
    return WavesLeft(energy, lines, faces, folds, between.gap, folded.row, extent, folded.witness)


def remove_folds(lines: MetalLines, folds: Folds) -> MetalLines:
    """Lines without the waves that a fold's section has: those across its faces, of edges parallel to it."""
    chosen = folds.of(folds.plain & ~folds.square)
    width, onward = lines.width.copy(), lines.onward.copy()
    for i in range(chosen.n):
        off = lines.middle - chosen.middle[i]
        parallel = np.abs(lines.along @ chosen.along[i]) > 1.0 - 1e-6
        beside = np.abs(off @ chosen.along[i]) < 0.5 * chosen.length[i]
        for arm, reach in zip(chosen.arms[i], chosen.width[i], strict=True):
            across = off @ arm
            level = np.abs(off @ np.cross(arm, chosen.along[i])) < 1e-3 * reach
            on = parallel & beside & level & (across > -1e-3 * reach) & (across < 1.001 * reach)
            width[on], onward[on] = np.inf, 0.0
    return replace(lines, width=width, onward=onward)


def _outside(corners: F64, materials: Sequence[Material], wavelength: float) -> tuple[str, bool]:
    """Reason why the theory's error is not known, and whether to warn of it."""
    bodies = [m for m in materials if not m.metallic and m.thickness <= 0.0]
    if bodies:
        return f"surfaces of {bodies[0].name}: only metal and thin sheets are judged", False
    if too_many(corners, MOST_FACES):
        return f"{len(corners)} faces are too many to examine", False
    points = corners.reshape(-1, 3)
    points = points - points.mean(axis=0)
    _, axes = np.linalg.eigh(points.T @ points)
    extent = np.sort(np.ptp(points @ axes, axis=0)) / wavelength
    if extent[2] < LEAST_SIZE:
        return (
            f"the body is {extent[2]:.2g} wavelengths large; below {LEAST_SIZE:g} it scatters as a dipole",
            True,
        )
    if extent[1] < LEAST_WIDTH:
        return f"the body is a rod {extent[1]:.2g} wavelengths thick; it resonates as a wire, see wires", True
    return "", False


def too_many(corners: F64, most: int) -> bool:
    """Whether triangles (n, 3, 3) have more flat facets than ``most``, however these are cut."""
    if len(corners) <= most:
        return False
    return len(corners) > MOST_TRIANGLES or int(coplanar_parts(corners).max()) >= most


def _some(power: F64) -> NDArray[np.intp]:
    """Directions that are examined: the strongest of every channel, and others evenly."""
    n = len(power)
    even = np.arange(0, n, -(-n // MOST_DIRECTIONS))
    return np.unique(np.concatenate([even, power.argmax(axis=0), [n - 1]]))


def repeated_share(faces: MetalFaces, width: float, wavelength: float, n_orders: int) -> F64:
    r"""(n_orders,) share of the energy of 1, 2, ... bounces by which ray optics is wrong.

    Of n bounces on faces of the width w, or the distance w from a face that is opposite, in wavelengths, the share

    .. math:: \min\left(1, \frac{n - 1}{w}\right)^2

    by one over the Fresnel number of a face seen from the one n - 1 widths before, in the mean over the area of the
    faces. Beyond it waves have spread over all walls, and rays do not give the phase of the modes.

    Parameters
    ----------
    faces : of the metal
    width : mean width of the faces, wavelengths
    wavelength : m
    n_orders : bounces
    """
    across = np.maximum(np.minimum(width, gaps(faces) / wavelength), 1e-9)
    share = np.square(np.minimum(1.0, np.arange(n_orders)[:, None] / across))
    area = faces.fill * faces.half.prod(axis=1)
    return np.asarray(share @ area / max(float(area.sum()), 1e-300))


def cause_text(name: str, lines: MetalLines, wavelength: float, gap: float = math.inf) -> str:
    """Text of a cause with the size that matters, wavelengths; ``gap`` between bodies, m."""
    sharp, k = lines.radius == 0.0, 2.0 * np.pi / wavelength
    across = f"{lines.face_width / wavelength:.2g} wavelengths"
    if name == EDGES_OFF:
        return "edges that are not simulated"
    if name == BETWEEN:
        return f"waves between edges {across} apart, and their ends"
    if name == BODIES:
        return f"waves between bodies {gap / wavelength:.2g} wavelengths apart"
    if name == BENT:
        return f"waves along bent sheets {across} wide"
    if name == REPEATED:
        return f"several bounces by ray optics{f' on faces {across} wide' if sharp.any() else ''}"
    if name == ONE_RIM:
        values, chosen = lines.width.min(axis=1), sharp & (lines.width < ONE_EDGE * wavelength).any(axis=1)
        text = "edges {} wavelengths apart act as one"
    else:
        values, chosen = lines.radius, ~sharp & ((k * lines.radius < AS_EDGE) == (name == ROUNDED))
        text = "waves of rounded edges and tips, radius {} wavelengths"
        if name == CURVED:
            text = "creeping waves, radius {} wavelengths"
    if not chosen.any():
        return name
    size = np.exp(np.average(np.log(np.maximum(values[chosen], 1e-12)), weights=lines.length[chosen]))
    return text.format(f"{size / wavelength:.2g}")
