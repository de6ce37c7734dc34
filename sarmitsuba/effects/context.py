"""What effects are decided from: context of the scene and the radar, and what a pilot trace measured."""

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from sarmitsuba.effects.shape import ShapeAnalysis
from sarmitsuba.effects.slabs_between import seen_through
from sarmitsuba.materials.map_materials import with_parts
from sarmitsuba.materials.material import Material
from sarmitsuba.scene.scene import Scene

F64 = NDArray[np.float64]

# a single resolution cell that is left out must stay this far below the clutter, dB: a hundredth of the power of
# one look of speckle. Without clutter the tolerance applies, below the peak
CELL_BELOW_CLUTTER_DB = -20.0

# about what it takes to prove a closed body convex
PROOF_SECONDS_PER_FACE = 2.5e-6

KINDS = ("coherent", "diffuse", "reciprocal")


@dataclass(frozen=True, eq=False)
class SamplingFacts:
    """How the full run will sample the scene, as far as it is known before the plan.

    Parameters
    ----------
    ray_spacing : m, of the rays for coherent returns, or of all where there is one lattice
    n_rays : of one key pulse, all lattices
    cell : m, edge of a square as large as a resolution cell on level ground
    box : (2, 3) float64, m, scene frame; the lit part of the scene
    key_pulses : pulses to trace, about
    """

    ray_spacing: float
    n_rays: int
    cell: float
    box: F64
    key_pulses: int


@dataclass(frozen=True)
class PairLevel:
    """What pairs of diffuse scatterers return, from pairs drawn at random; no bias.

    Parameters
    ----------
    share : their power over that of diffuse scatterers alone
    error : standard error of ``share``
    strongest : power in the square of the ground that has most, over mean clutter on as much ground
    square : m, side of the squares
    pairs : drawn ones that return something
    realisation_error : energy of the error that the realisation of the run's pairs makes in the image, over that of the
        clutter
    cell : m, of the points that the run's pairs are drawn from
    cross : their cross-polar power over that of diffuse scatterers alone; 0 where the radar records none
    """

    share: float
    error: float
    strongest: float
    square: float
    pairs: int
    realisation_error: float
    cell: float
    cross: float = 0.0


@dataclass(frozen=True, eq=False)
class PilotResult:
    """Power by kind of return and bounce order, from patches about as large as a resolution cell.

    Parameters
    ----------
    pulses : traced pulse numbers
    rays : traced in all
    n_patches, n_features : patches placed at random, and on small features (all pulses together)
    n_skipped : small features that the budget left out, the weakest
    mean, deviation : (4, n_orders) float64, m^2; mean power of a random patch and that mean's standard error; rows
        are ``KINDS`` and their coherent sum
    share : (n_orders,) share of the random patches with any return of the order
    peak : (4, n_orders) float64, m^2, the strongest patch, random or on a feature
    hits : (n_orders,) hits by order
    rays_per_second : pilot kernel alone, 0 when unknown
    seconds : whole pilot
    going_on : largest share of a patch's power, as launched, that still goes on after the last order
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

    @property
    def n_orders(self) -> int:
        """Bounces that were followed."""
        return int(self.mean.shape[1])

    @property
    def clutter(self) -> float:
        """Mean diffuse power of a patch, m^2; 0 where nothing is rough."""
        return float(self.mean[1:3].sum())

    @property
    def total(self) -> float:
        """Mean power of a patch, m^2."""
        return float(self.mean[3].sum())

    def energy_db(self, rows: slice | int, first_order: int, *, upper: bool = False) -> float:
        """Share of the image's energy in some kinds from an order on, dB; with ``upper``, plus two standard errors."""
        mean = np.atleast_2d(self.mean[rows])[:, first_order - 1 :].sum()
        if upper:
            mean = mean + 2.0 * np.sqrt(
                np.square(np.atleast_2d(self.deviation[rows])[:, first_order - 1 :]).sum()
            )
        return _ratio_db(float(mean), self.total)

    def cell_db(self, rows: slice | int, first_order: int) -> float:
        """Strongest patch in some kinds from an order on: dB above the clutter, or above the peak without any."""
        peak = np.atleast_2d(self.peak[rows])[:, first_order - 1 :]
        strongest = float(peak.max()) if peak.size else 0.0
        return _ratio_db(strongest, self.clutter if self.clutter > 0 else float(self.peak[3].max()))

    def enough(self, tolerance_db: float) -> int:
        """Fewest bounces after which what is left, two standard errors included, stays below the tolerance; 0: none."""
        limit = self.cell_limit_db(tolerance_db)
        for n in range(1, self.n_orders):
            if self.energy_db(3, n + 1, upper=True) <= tolerance_db and self.cell_db(3, n + 1) <= limit:
                return n
        return 0

    def settled(self, tolerance_db: float) -> bool:
        """Whether enough bounces were followed, by their returns and by what power goes on after the last."""
        return self.enough(tolerance_db) > 0 and self.going_on <= 10.0 ** (0.1 * tolerance_db)

    def would_be_enough(self, tolerance_db: float) -> int:
        """Bounces that :meth:`enough` would find beyond those followed, if returns fall as over the last half."""
        middle, last = (self.n_orders + 1) // 2, self.n_orders
        over, falls = 0.0, np.inf
        for of, limit in ((self.energy_db, tolerance_db), (self.cell_db, self.cell_limit_db(tolerance_db))):
            begin, end = of(3, middle), of(3, last)
            if end > limit:
                over = max(over, end - limit)
                falls = min(falls, (begin - end) / (last - middle))
        return last + int(np.ceil(over / max(falls, 1e-2)))

    def cell_limit_db(self, tolerance_db: float) -> float:
        """What ``cell_db`` may be of a return that is left out."""
        return CELL_BELOW_CLUTTER_DB if self.clutter > 0 else tolerance_db


def _ratio_db(power: float, reference: float) -> float:
    return float(10.0 * np.log10(power / reference)) if power > 0 and reference > 0 else -np.inf


@dataclass(frozen=True, eq=False)
class SceneContext:
    """All that an effect may look at.

    Parameters
    ----------
    scene : as loaded
    sampling : of the full run, None before it is known
    pilot : what a pilot trace measured, None when there was none
    known_shape : what was worked out about the geometry before, None to start anew
    pairs : what pairs of diffuse scatterers return; None where they were not looked for
    """

    scene: Scene
    sampling: SamplingFacts | None = None
    pilot: PilotResult | None = None
    known_shape: ShapeAnalysis | None = None
    pairs: PairLevel | None = None

    @property
    def tolerance_db(self) -> float:
        """Accepted error, dB of the image's clutter or peak."""
        return self.scene.settings.tolerance_db

    @property
    def tolerance(self) -> float:
        """Accepted error as an amplitude ratio."""
        return float(10.0 ** (self.tolerance_db / 20.0))

    @cached_property
    def materials(self) -> tuple[Material, ...]:
        """Materials that rays can hit, those of maps included."""
        used = np.unique(self.scene.geometry.face_material)
        return with_parts([m for m in (self.scene.materials[i] for i in used) if not m.invisible])

    @cached_property
    def unlike_materials(self) -> tuple[Material, ...]:
        """Of the materials that differ in name alone the first: a mesh may name thousands that are alike."""
        return tuple({replace(m, name=""): m for m in reversed(self.materials)}.values())[::-1]

    @cached_property
    def shape(self) -> ShapeAnalysis:
        """What the visible geometry proves."""
        if self.known_shape is not None:
            return self.known_shape
        return self.shape_within(np.inf)

    def shape_within(self, seconds: float) -> ShapeAnalysis:
        """The same, without proofs where they would take longer than that."""
        visible = np.array([not m.invisible for m in self.scene.materials], dtype=bool)
        # proofs hold for the places at one time: what moves may come together
        thorough = not self.scene.geometry.moves and (
            PROOF_SECONDS_PER_FACE * self.scene.geometry.n_faces <= seconds
        )
        return ShapeAnalysis(self.scene.geometry, visible, self.antenna, thorough=thorough)

    @cached_property
    def seen_through(self) -> tuple[Material, ...]:
        """Slabs that let waves through to something of the scene; see :mod:`sarmitsuba.effects.slabs_between`."""
        return seen_through(self.scene, self.antenna)

    @cached_property
    def antenna(self) -> F64:
        """(n, 3) antenna positions that bound the aperture: at most 65 pulses spread over it, m."""
        position = self.scene.radar.track.position
        pick = np.unique(np.linspace(0, len(position) - 1, min(len(position), 65)).round().astype(int))
        return np.asarray(position[pick])

    @cached_property
    def box(self) -> F64:
        """(2, 3) bounds of what is lit, m, scene frame: the sampled box, else all geometry and points."""
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
        """(9, 3) corners of ``box`` and its middle, m."""
        low, high = self.box
        grid = np.array(
            [[x, y, z] for x in (low[0], high[0]) for y in (low[1], high[1]) for z in (low[2], high[2])]
        )
        return np.concatenate([grid, [0.5 * (low + high)]])

    @cached_property
    def incidence_cosine(self) -> tuple[float, float]:
        """Least and greatest cosine of the incidence angle on any visible face over the aperture."""
        return self.shape.cosines

    @property
    def wavenumber(self) -> float:
        """Wave number at the carrier, rad/m."""
        return float(2.0 * np.pi / self.scene.radar.waveform.wavelength)


__all__ = ["CELL_BELOW_CLUTTER_DB", "KINDS", "PairLevel", "PilotResult", "SamplingFacts", "SceneContext"]
