"""Witness of the ray spacing: a share of the rays against finer ones in their place.

Two sets of rays of one spacing err alike where all tubes are too wide; finer rays show it. Cells of a lattice are tiled
exactly by the cells of their parts, so that the difference of the two is the error of the rays, and nothing else. Both
are traced at once, one of them with a negative weight. Levels of few rays, which lie about what needs denser rays, are
traced as a whole. Of those of many, runs of neighbours are drawn in groups: what groups have in common is the error of
the spacing, what they differ by is the chance of the draw.
"""

import math
import warnings
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
import scipy

from sarmitsuba.core.arrays import C64, F64
from sarmitsuba.core.constants import EMPTY_DB
from sarmitsuba.core.errors import SarmitsubaWarning
from sarmitsuba.core.units import db_from_power, power_from_db
from sarmitsuba.core.witness import CONFIDENCE, USELESS_DB, Witness
from sarmitsuba.simulation.execution.error_bars import add_two_sets
from sarmitsuba.simulation.planning.sampling.chains import Draw, exchange_rays
from sarmitsuba.simulation.planning.sampling.density_plan import SamplingPlan
from sarmitsuba.tracing.kernel.launch import LaunchGrid

# least rays traced; rounds in which they are, while their scatter leaves the error open by more than so many dB, and
# groups of each, of runs of neighbours, as terms of common sides of tubes cancel among them; runs of a group in a level
LEAST_TRACED, ROUNDS, SURE_DB, GROUPS, RUN, LEAST_RUNS = 25_000, 3, 4.0, 3, 256, 4
# rays traced for a diffuse one that is drawn; rays of a round over those for levels as a whole
PARTS, DRAWN = 5, 0.25
# resolution cells across a run whose errors do not add up with those of others in a pixel; least rays across
RUN_CELLS, LEAST_RUN = 2.0, 4.0
# wavelengths down to which rays are halved where something needs dense ones, and most halvings: what is seen in a
# curved mirror may converge no sooner
FINE_WAVELENGTHS, MOST_HALVINGS = 1.0 / 8.0, 2
# wavelengths of rays whose tubes are narrow enough for any return
FINEST_WAVELENGTHS = 1.0 / 32.0
# dB, error below which the ray spacing is not refined further
FINE_DB = -15.0
# dB, error from which a contradiction to two sets of rays is said
SAID_DB = -20.0
# most rays of a lattice of half the spacing
MOST_RAYS = 16_000_000


def witness_rays(
    profiles: Callable[[Sequence[LaunchGrid]], C64],
    lattices: Sequence[LaunchGrid],
    energy: F64,
    two_sets_db: float,
    wavelength: float,
    cell: float,
    seed: int,
    allowed: float,
) -> Witness | None:
    """Error by the spacing of the rays for coherent returns, and by the scatter of two sets; None without such rays.

    Parameters
    ----------
    profiles : echoes (n_channels, ...) of some rays of one pulse or look
    lattices : of one ray set
    energy : (n_channels,) of the echoes of all rays and sources of this pulse or look
    two_sets_db : error measured by the difference of two ray sets, worst channel, dB; NaN: there is one set
    wavelength : m
    cell : m, the larger resolution
    seed : of the draw
    allowed : most rays to be traced

    Returns
    -------
    Witness of the worst channel: of both together. The law is the latter alone
    """
    lattices = [grid for grid in lattices if grid.n_rays]
    counted = energy > power_from_db(EMPTY_DB) * energy.max(initial=0.0)
    if not lattices or not counted.any():
        return None
    plan = _Plan.of(lattices, wavelength, cell, max(allowed, LEAST_TRACED))
    if not plan.whole and not plan.drawn:  # all are finer than any error
        return None
    change = _Change(profiles, lattices, plan, np.random.default_rng([seed & 0x7FFFFFFF, 0x3A75]))
    while True:
        levels = (db_from_power(float((x[counted] / energy[counted]).max())) for x in change.measure())
        error_db, upper_db = (add_two_sets(level, two_sets_db) for level in levels)
        if upper_db <= max(error_db + SURE_DB, SAID_DB) or not change.go_on():
            break
    reference = "finer rays" + ("" if math.isnan(two_sets_db) else ", and two sets of rays")
    return Witness(error_db, upper_db, change.n_drawn, two_sets_db, reference)


@dataclass(frozen=True)
class _Plan:
    """Levels of lattices whose rays are all traced again, and the share of the others that is drawn.

    Parameters
    ----------
    whole : draws by the numbers of the lattice and of the level, and the number of their rays
    drawn : (number of the lattice, of the level, its rays, halvings of its spacing, whether only later hits count)
    step : one over the share of a round
    """

    whole: Mapping[tuple[int, int], tuple[Draw, int]]
    drawn: tuple[tuple[int, int, int, int, bool], ...]
    step: int

    @staticmethod
    def of(lattices: Sequence[LaunchGrid], wavelength: float, cell: float, allowed: float) -> "_Plan":
        """Plan of about ``allowed`` rays for levels of few rays as a whole, and a share of it for a round of others.

        Errors of runs wider than a resolution cell, and those of diffuse returns, do not add up in a pixel: of these
        one draw suffices, weighted by the root of one over its chance.
        """
        near, apart = [], []
        for i, grid in enumerate(lattices):
            counts = np.diff([*(level.first for level in grid.every_level), grid.n_rays]).tolist()
            for k, (level, n) in enumerate(zip(grid.every_level, counts, strict=True)):
                # large flat facets are tiled exactly at first hits, but only by all rays together
                plain = (
                    level.serves != "later" and not np.isfinite(level.needs[1]) and grid.purpose != "diffuse"
                )
                if (
                    not n
                    or level.spacing < FINEST_WAVELENGTHS * wavelength
                    or (plain and level.serves == "first")
                ):
                    continue
                run = 1 << math.ceil(2.0 * math.log2(max(RUN_CELLS * cell / level.spacing, LEAST_RUN)))
                if grid.purpose == "diffuse" or run <= RUN:
                    apart.append((i, k, n, min(run, RUN), plain))
                    continue
                wanted = math.ceil(math.log2(max(level.spacing / (FINE_WAVELENGTHS * wavelength), 1.0)))
                halvings = min(max(wanted, 1), MOST_HALVINGS)
                near.append((n * (1 + 4**halvings), i, k, n, halvings, plain, wanted))
        near.sort()
        whole, left = {}, allowed
        fits = int(np.searchsorted(np.cumsum([level[0] for level in near]), left, side="right"))
        left -= sum(level[0] for level in near[:fits])
        for cost, i, k, n, halvings, plain, wanted in near[:fits]:
            if wanted > halvings and 3 * cost <= left:  # once more, where few rays allow it
                halvings, left = halvings + 1, left - 3 * cost
            whole[i, k] = Draw(halvings=halvings, weight=_full(halvings), only_later=plain), n
        step = max(1, math.ceil(PARTS * sum(n for _, _, n, _, _ in apart) / (DRAWN * allowed)))
        for i, k, n, run, plain in apart:
            whole[i, k] = Draw(step, 0, run, weight=math.sqrt(step), only_later=plain), n // step
        of_round = max(2, math.ceil(sum(level[0] for level in near[fits:]) / (left + DRAWN * allowed)))
        return _Plan(whole, tuple(level[1:6] for level in near[fits:]), of_round)


class _Change:
    r"""Change of the echoes by finer rays, measured in rounds.

    With the change C by levels traced as a whole, and those :math:`S_g` by G groups of runs drawn of the others,
    weighted by one over their chance 1 / w, and T their sum, the energy of the change by all rays is

    .. math:: |C|^2 + \frac1w \sum_g |S_g|^2 + 2 \Re C^* T + \frac{G}{G - 1} (|T|^2 - \sum_g |S_g|^2)

    The first two are the whole where runs are independent of each other. The others are what they have in common; they
    count as far as they exceed their scatter.
    """

    def __init__(
        self,
        profiles: Callable[[Sequence[LaunchGrid]], C64],
        lattices: Sequence[LaunchGrid],
        plan: _Plan,
        rng: np.random.Generator,
    ) -> None:
        self.profiles, self.lattices, self.plan = profiles, lattices, plan
        self.steps = GROUPS * plan.step
        self.first, self.shift = int(rng.integers(self.steps)), rng.random()
        self.n_drawn = sum(n for _, n in plan.whole.values())
        draws = {
            key: replace(draw, first=int(rng.integers(draw.step))) for key, (draw, _) in plan.whole.items()
        }
        self.whole = self._exchange(draws) if draws else None
        self.groups: list[C64] = []
        self.go_on()

    def _exchange(self, draws: Mapping[tuple[int, int], Draw]) -> C64:
        grids = [
            exchange_rays(grid, {k: draw for (j, k), draw in draws.items() if j == i})
            for i, grid in enumerate(self.lattices)
        ]
        return self.profiles([grid for grid in grids if grid.n_rays])

    def go_on(self) -> bool:
        """Trace another round of groups, if there is one."""
        done = len(self.groups) // GROUPS
        if not self.plan.drawn or done == min(ROUNDS, self.plan.step):
            return False
        for g in range(GROUPS):
            draws = {}
            for i, k, n, halvings, plain in self.plan.drawn:
                run = min(max(n // (LEAST_RUNS * self.steps), 1), RUN)
                place = (self.first + g * self.plan.step + done) % self.steps
                draws[i, k] = Draw(
                    self.steps, place, run, halvings, _full(halvings), int(self.shift * run), plain
                )
                self.n_drawn += n // self.steps
            self.groups.append(self._exchange(draws))
        return True

    def measure(self) -> tuple[F64, F64]:
        """Energy of the change by all rays, and the level below which it lies, (n_channels,)."""
        if not self.groups:
            assert self.whole is not None
            square = np.square(np.abs(self.whole), dtype=np.float64)
            own, carry = (
                square.sum(axis=(axes := tuple(range(1, square.ndim)))),
                _count_carriers(square, axes),
            )
            drawn = any(draw.step > 1 for draw, _ in self.plan.whole.values())
            return own, own * (1.0 + drawn * scipy.special.stdtrit(carry, CONFIDENCE) / np.sqrt(carry))
        n, axes = len(self.groups), tuple(range(1, self.groups[0].ndim))
        weight = self.steps / n
        each = np.float32(weight) * np.stack(self.groups)
        total = each.sum(axis=0)
        whole = np.zeros_like(total) if self.whole is None else self.whole
        apart = np.square(np.abs(each), dtype=np.float64).sum(axis=0)
        alone = (np.square(np.abs(whole), dtype=np.float64) + apart / weight).sum(axis=axes)
        common = (np.square(np.abs(total), dtype=np.float64) - apart) * (n / (n - 1))
        shared = (2.0 * np.real(np.conj(whole) * total) + common).sum(axis=axes)
        square = np.square(apart) * (n / (n - 1)) + 2.0 * np.square(np.abs(whole)) * apart
        spread = np.sqrt(square.sum(axis=axes))
        carry = _count_carriers(apart, axes)
        quantile = scipy.special.stdtrit((n - 1) * carry, CONFIDENCE)
        likely = np.maximum(shared, 0.0) ** 3 / np.maximum(np.square(shared) + np.square(spread), 1e-300)
        upper = alone * (1.0 + quantile / np.sqrt(carry)) + np.maximum(shared, 0.0) + quantile * spread
        return alone + likely, upper


def _count_carriers(square: F64, axes: tuple[int, ...]) -> F64:
    """Effective number of samples that carry the energy of a channel, at least 1: the quantile of few is large."""
    total = np.square(square.sum(axis=axes)) / np.maximum(np.square(square).sum(axis=axes), 1e-300)
    return np.asarray(np.maximum(total, 1.0))


def _full(halvings: int) -> float:
    """Amplitude of the error over the change by so many halvings, as it falls with the square of the spacing."""
    return 1.0 / (1.0 - 4.0**-halvings)


def say_rays(name: str, witness: Witness | None) -> str:
    """Text on rays whose measured error is large, or high and far above that of two sets; empty for none.

    It is a warning where two sets of rays say so, too. The witness alone counts all echoes of one pulse, also those of
    large errors far outside the image.
    """
    if witness is None:
        return ""
    measured = f"{name}: the error of the rays, measured against finer ones, is"
    if witness.useless and witness.law_db > USELESS_DB:
        text = f"{measured} {witness.error_db:.1f} dB: the image is not usable; set a smaller ray_spacing"
        warnings.warn(text, SarmitsubaWarning, stacklevel=4)
        return text
    if witness.contradicts and witness.error_db > SAID_DB:
        return f"{measured} {witness.error_db:.1f} dB; a smaller ray_spacing lowers it"
    return ""


def halved_plan(
    sampling: SamplingPlan, lattices: Sequence[Sequence[LaunchGrid]], witness: Witness | None
) -> SamplingPlan | None:
    """Plan at half the spacing, where automatic rays are too far apart by the measurement; None where they are not.

    Two sets of rays have to say so, too, and half the spacing has to fit the bound on rays. Diffuse returns alone keep
    their spacing.

    Parameters
    ----------
    lattices : of every ray set, at one pulse or look
    """
    if witness is None or sampling.halvings or sampling.scene.settings.ray_spacing > 0.0:
        return None
    if not (witness.error_db > FINE_DB and witness.law_db > FINE_DB):
        return None
    every = [grid for grids in lattices for grid in grids]
    if all(grid.purpose == "diffuse" for grid in every) or 4 * max(grid.n_rays for grid in every) > MOST_RAYS:
        return None
    return replace(sampling, halvings=1)
