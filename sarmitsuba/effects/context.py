"""Context in which effects are decided: scene and radar, a pilot trace, and slabs that waves pass to objects behind."""

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from functools import cached_property

import numpy as np

from sarmitsuba.core.arrays import F64, box_corners
from sarmitsuba.core.units import amplitude_from_db, db_from_power, power_from_db
from sarmitsuba.effects.shape import ShapeAnalysis
from sarmitsuba.scene.materials.map_materials import list_with_parts
from sarmitsuba.scene.materials.material import Material
from sarmitsuba.scene.materials.slab import lets_through
from sarmitsuba.scene.scene import Scene

# faces up to this many thicknesses behind one of the same material may be the other face of its slab
SAME_SLAB = 1.5


def seen_through(scene: Scene, antenna: F64) -> tuple[Material, ...]:
    """Slab materials that transmit and have objects of the scene behind one of their faces.

    Parameters
    ----------
    scene : as loaded
    antenna : (n, 3) positions that bound the aperture, m

    Notes
    -----
    An object is behind a face if it lies beyond the plane of the face as seen from the antenna, whether or not rays hit
    it there.
    """
    geometry = scene.geometry
    if not geometry.n_faces:
        return ()
    wavelength = scene.radar.waveform.wavelength
    used = np.unique(geometry.face_material)
    slabs = [i for i in used if lets_through(scene.materials[i], wavelength)]
    if not slabs:
        return ()
    hidden = np.array([m.invisible for m in scene.materials])[geometry.face_material]
    corners = geometry.vertices[np.unique(geometry.faces[~hidden])]
    others = np.concatenate([corners, scene.places])
    return tuple(
        scene.materials[i]
        for i in slabs
        if _something_behind(
            geometry.vertices[geometry.faces[geometry.face_material == i]],
            others,
            antenna,
            SAME_SLAB * scene.materials[i].thickness,
        )
    )


def _something_behind(faces: F64, points: F64, antenna: F64, slack: float) -> bool:
    """Whether any point lies farther than ``slack`` (m) beyond the plane of any face (n, 3, 3)."""
    normal = np.cross(faces[:, 1] - faces[:, 0], faces[:, 2] - faces[:, 0])
    length = np.linalg.norm(normal, axis=1)
    for n, corner in zip(normal[length > 0] / length[length > 0, None], faces[length > 0, 0], strict=True):
        sides = np.sign((antenna - corner) @ n)
        height = (points - corner) @ n
        if any(bool((height * side < -slack).any()) for side in np.unique(sides) if side):
            return True
    return False


# limit for the return left out in a single resolution cell, relative to the clutter, dB: a hundredth of the power of
# one look of speckle. Without clutter the tolerance applies, relative to the peak
CELL_BELOW_CLUTTER_DB = -20.0

# approximate cost of proving a closed body convex
PROOF_SECONDS_PER_FACE = 2.5e-6

# patches that may have been missed, of a rare return: the upper 97.5 % limit of a Poisson count m is about
# m + 2 sqrt(m) + 3
_UNMET = 3.0

KINDS = ("coherent", "diffuse", "reciprocal")


@dataclass(frozen=True, eq=False)
class SamplingFacts:
    """SamplingFacts of the full run, as far as it is known before the plan.

    Parameters
    ----------
    ray_spacing : m, of the rays for coherent returns, or of all where there is one lattice
    n_rays : of one key pulse, all lattices
    cell : m, edge of a square as large as a resolution cell on level ground
    box : (2, 3) float64, m, scene frame; the lit part of the scene
    key_pulses : estimated number of traced pulses
    azimuth_cell, range_cell : m, resolution along azimuth and slant range
    """

    ray_spacing: float
    n_rays: int
    cell: float
    box: F64
    key_pulses: int
    azimuth_cell: float
    range_cell: float

    @property
    def cell_across(self) -> float:
        """Area of a resolution cell on level ground, projected across the line of sight, m^2."""
        sine = min(1.0, self.azimuth_cell * self.range_cell / self.cell**2)
        return float(self.cell**2 * np.sqrt(1.0 - sine**2))


@dataclass(frozen=True, eq=False)
class PilotResult:
    """Power by kind of return and bounce order, from patches about as large as a resolution cell.

    Parameters
    ----------
    pulses : traced pulse numbers
    rays : traced in all
    n_patches, n_features : patches placed at random, and on small features (all pulses together)
    n_skipped : weakest small features, left out because of the budget
    mean, deviation : (4, n_orders) float64, m^2; mean power of a random patch and that mean's standard error; rows
        are ``KINDS`` and their coherent sum
    share : (n_orders,) share of the random patches with any return of the order
    peak : (4, n_orders) float64, m^2, the strongest patch, random or on a feature
    hits : (n_orders,) number of hits by order
    rays_per_second : pilot kernel alone, 0 when unknown
    seconds : whole pilot
    going_on : largest share of a patch's launched power that is incident at the last order
    incident : (n_orders,) float64, mean share of a random patch's launched power that is incident at each bounce
    in_phase, in_phase_deviation : (n_orders,) float64, m^2; mean power of a patch with which patches that do not
        interfere would have the image energy of the coherent returns, which add up over a resolution cell, and that
        mean's standard error; see :mod:`sarmitsuba.simulation.execution.in_phase`
    patch_area : m^2 across the line of sight, effective: of the taper's power; NaN if not known
    lit_area : m^2 across the line of sight, over which random patches are distributed; NaN if not known
    """

    pulses: tuple[int, ...]
    rays: int
    n_patches: int
    n_features: int
    n_skipped: int
    mean: F64
    deviation: F64
    share: F64
    peak: F64
    rays_per_second: float
    seconds: float
    going_on: float = 0.0
    incident: F64 = field(default_factory=lambda: np.zeros(0))
    patch_area: float = float("nan")
    lit_area: float = float("nan")
    in_phase: F64 = field(default_factory=lambda: np.zeros(0))
    in_phase_deviation: F64 = field(default_factory=lambda: np.zeros(0))

    @property
    def n_orders(self) -> int:
        """Number of bounces traced."""
        return int(self.mean.shape[1])

    @property
    def clutter(self) -> float:
        """Mean diffuse power of a patch, m^2; 0 where nothing is rough."""
        return float(self.mean[1:3].sum())

    @property
    def total(self) -> float:
        """Mean power of a patch, m^2."""
        return float(self.mean[3].sum())

    @property
    def least_energy(self) -> float:
        """Energy of the image, in cells times m^2: that of all patches less two errors, at least of the strongest.

        The strongest patch may be as strong at one of the traced pulses alone.
        """
        strongest = float(self.peak[3].max(initial=0.0)) / max(1, len(self.pulses))
        mean = self.total - 2.0 * float(np.sqrt(np.square(self.deviation[3]).sum()))
        everything = mean * self.lit_area / self.patch_area
        return max(strongest, everything) if np.isfinite(everything) else strongest

    def energy_db(self, rows: slice | int, first_order: int, *, upper: bool = False) -> float:
        """Share of the image's energy in some kinds of return from an order on, dB; ``upper``: plus two errors."""
        mean = np.atleast_2d(self.mean[rows])[:, first_order - 1 :].sum()
        if upper:
            mean = mean + 2.0 * np.sqrt(
                np.square(np.atleast_2d(self.deviation[rows])[:, first_order - 1 :]).sum()
            )
        return _ratio_db(float(mean), self.total)

    def left_out_db(self, depth: int) -> float:
        """Upper bound of the energy of bounces after ``depth`` over that of the image, dB; at most 0.

        As :meth:`energy_db` with two standard errors, and with coherent returns in phase over resolution cells where
        that is more. Three patches as bright as the brightest count beside those found: where few have a return,
        their standard error is no bound. Of the image's energy, only the part that patches see is assumed beside the
        bounces left out. Returns that no patch meets are not in it.
        """
        above = slice(depth, None)
        left = float(self.mean[3, above].sum() + 2.0 * np.sqrt(np.square(self.deviation[3, above]).sum()))
        if self.in_phase.size:
            more = float(np.maximum(self.in_phase[above], 0.0).sum()) - float(self.mean[0, above].sum())
            more += 2.0 * float(np.sqrt(np.square(self.in_phase_deviation[above]).sum()))
            left += max(more, 0.0)
        left += _UNMET * float(self.peak[3, above].max(initial=0.0)) / max(self.n_patches, 1)
        return _ratio_db(left, float(self.mean[3, :depth].sum()) + left)

    def cell_db(self, rows: slice | int, first_order: int) -> float:
        """Strongest patch in some kinds of return from an order on, dB relative to the clutter, or to the peak."""
        peak = np.atleast_2d(self.peak[rows])[:, first_order - 1 :]
        strongest = float(peak.max()) if peak.size else 0.0
        return _ratio_db(strongest, self.clutter if self.clutter > 0 else float(self.peak[3].max()))

    def enough(self, tolerance_db: float) -> int:
        """Least number of bounces after which the rest, plus two standard errors, is below the tolerance; 0: none."""
        limit = self.cell_limit_db(tolerance_db)
        for n in range(1, self.n_orders):
            if self.energy_db(3, n + 1, upper=True) <= tolerance_db and self.cell_db(3, n + 1) <= limit:
                return n
        return 0

    def last_turn(self, tolerance_db: float) -> int:
        """Last bounce at which echoes that count turn back along their chain; 1: none beyond the first."""
        limit = self.cell_limit_db(tolerance_db)
        counts = [
            n
            for n in range(2, self.n_orders + 1)
            if self.energy_db(2, n, upper=True) > tolerance_db or self.cell_db(2, n) > limit
        ]
        return max(counts, default=1)

    def settled(self, tolerance_db: float) -> bool:
        """Whether enough bounces were traced, by their returns and by the power that continues after the last."""
        limit = power_from_db(tolerance_db)
        return self.enough(tolerance_db) > 0 and self.going_on <= limit and self.later_db <= tolerance_db

    @property
    def later_db(self) -> float:
        r"""Share of the image's energy that bounces after the last may have, dB, by the power left for them.

        .. math:: P_N \max_n E_n / P_n

        with the energy :math:`E_n` returned at bounce n and the power :math:`P_n` incident at it. No return at bounce N
        is no proof: between two walls that meet at an edge, every second bounce returns nothing.
        """
        if not self.incident.size:
            return -np.inf
        lit = self.incident > 0.0
        best = float((self.mean[3][lit] / self.incident[lit]).max(initial=0.0))
        return _ratio_db(best * float(self.incident[-1]), self.total)

    def would_be_enough(self, tolerance_db: float) -> int:
        """Extrapolated number of bounces for :meth:`enough`, if returns decay as over the last half of those traced."""
        middle, last = (self.n_orders + 1) // 2, self.n_orders
        over, falls = 0.0, np.inf
        for of, limit in ((self.energy_db, tolerance_db), (self.cell_db, self.cell_limit_db(tolerance_db))):
            begin, end = of(3, middle), of(3, last)
            if end > limit:
                over = max(over, end - limit)
                falls = min(falls, (begin - end) / (last - middle))
        return last + int(np.ceil(over / max(falls, 1e-2)))

    def cell_limit_db(self, tolerance_db: float) -> float:
        """Limit of ``cell_db`` for returns that are left out."""
        return CELL_BELOW_CLUTTER_DB if self.clutter > 0 else tolerance_db


def _ratio_db(power: float, reference: float) -> float:
    return db_from_power(power / reference) if power > 0 and reference > 0 else -np.inf


@dataclass(frozen=True, eq=False)
class SceneContext:
    """Information from which effects are decided.

    Parameters
    ----------
    scene : as loaded
    sampling : of the full run, None before it is known
    pilot : result of the pilot trace, None without one
    known_shape : analysis of the geometry, None to compute it
    measured : measurements of kinds of sources, by name
    draft : the decisions only prepare a pilot trace: effects that do not change it may stay on without assessment
    """

    scene: Scene
    sampling: SamplingFacts | None = None
    pilot: PilotResult | None = None
    known_shape: ShapeAnalysis | None = None
    measured: Mapping[str, object] = field(default_factory=dict)
    draft: bool = False

    @property
    def tolerance_db(self) -> float:
        """Accepted error, dB relative to the image's clutter or peak."""
        return self.scene.settings.tolerance_db

    @property
    def tolerance(self) -> float:
        """Accepted error as an amplitude ratio."""
        return amplitude_from_db(self.tolerance_db)

    @cached_property
    def materials(self) -> tuple[Material, ...]:
        """Materials that rays can hit, those of maps included."""
        used = np.unique(self.scene.geometry.face_material)
        return list_with_parts([m for m in (self.scene.materials[i] for i in used) if not m.invisible])

    @cached_property
    def unlike_materials(self) -> tuple[Material, ...]:
        """Distinct materials: the first of those that differ in name only (a mesh may have thousands of copies)."""
        return tuple({replace(m, name=""): m for m in reversed(self.materials)}.values())[::-1]

    @cached_property
    def shape(self) -> ShapeAnalysis:
        """Analysis of the visible geometry."""
        if self.known_shape is not None:
            return self.known_shape
        return self.shape_within(np.inf)

    def shape_within(self, seconds: float) -> ShapeAnalysis:
        """Analysis of the visible geometry, without proofs that would take longer than ``seconds``."""
        visible = np.array([not m.invisible for m in self.scene.materials], dtype=bool)
        # proofs hold for positions at one time only: moving shapes may come together
        thorough = not self.scene.geometry.moves and (
            PROOF_SECONDS_PER_FACE * self.scene.geometry.n_faces <= seconds
        )
        return ShapeAnalysis(self.scene.geometry, visible, self.antenna, thorough=thorough)

    @cached_property
    def seen_through(self) -> tuple[Material, ...]:
        """Slabs that transmit waves to objects behind them; see :mod:`sarmitsuba.effects.context`."""
        return seen_through(self.scene, self.antenna)

    @cached_property
    def antenna(self) -> F64:
        """Antenna positions (n, 3), m: at most 65 pulses distributed over the aperture."""
        position = self.scene.radar.track.position
        pick = np.unique(np.linspace(0, len(position) - 1, min(len(position), 65)).round().astype(int))
        return np.asarray(position[pick])

    @cached_property
    def box(self) -> F64:
        """Bounds (2, 3) of the lit part, m, scene frame: the sampled box, else all geometry and points."""
        parts = []
        if self.sampling is not None:
            parts.append(self.sampling.box)
        elif self.scene.geometry.n_faces:
            parts.append(self.scene.geometry.bounds)
        parts += [np.tile(place, (2, 1)) for place in self.scene.places]
        if not parts:
            return np.zeros((2, 3))
        return np.stack([np.min([p[0] for p in parts], axis=0), np.max([p[1] for p in parts], axis=0)])

    @cached_property
    def corners(self) -> F64:
        """Corners of ``box`` and its middle, (9, 3), m."""
        return np.concatenate([box_corners(self.box), [0.5 * (self.box[0] + self.box[1])]])

    @cached_property
    def incidence_cosine(self) -> tuple[float, float]:
        """Least and greatest cosine of the incidence angle on any visible face over the aperture."""
        return self.shape.cosines

    @property
    def wavenumber(self) -> float:
        """Wave number at the carrier, rad/m."""
        return float(2.0 * np.pi / self.scene.radar.waveform.wavelength)
