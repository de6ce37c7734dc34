"""Witness of the ray spacing: a drawn share of the rays against four rays in place of each, at half the spacing.

Two sets of rays of one spacing err alike where all tubes are too wide; half the spacing shows it. Cells of a lattice
are tiled exactly by the cells of their parts, so that the difference of the two is the error of the rays drawn, and
nothing else. Rays are drawn evenly over the lattice in groups: their common part is the error of the spacing,
their differences are the chance of the draw.
"""

import math
import warnings
from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np
import scipy

from sarmitsuba.core.arrays import C64, F64
from sarmitsuba.core.errors import SarmitsubaWarning
from sarmitsuba.core.units import db_from_power, power_from_db
from sarmitsuba.core.witness import USELESS_DB, Witness
from sarmitsuba.simulation.planning.sampling.chains import every_nth, halve_spacing
from sarmitsuba.simulation.planning.sampling.density_plan import SamplingPlan
from sarmitsuba.tracing.kernel.launch import LaunchGrid

# least and most rays drawn of a lattice; rays that are drawn together: terms of common sides of tubes cancel among
# them; groups; rays that are traced for each that is drawn
LEAST_DRAWN, MOST_DRAWN, RUN, GROUPS, PARTS = 5_000, 100_000, 64, 4, 5
# dB, error below which the ray spacing is not refined further
FINE_DB = -15.0
# dB, error from which a contradiction to two sets of rays is said
SAID_DB = -20.0
# share of the rays that may be drawn that are drawn at first: all of them where that leaves open whether it is met
FIRST = 4
# confidence from which what groups have in common is not the chance of the draw
SEEN = 0.99
# dB, energy of a channel relative to the strongest below which it does not count
EMPTY_DB = -60.0
# most rays of a lattice of half the spacing
MOST_RAYS = 16_000_000


def witness_rays(
    profiles: Callable[[Sequence[LaunchGrid]], C64],
    lattices: Sequence[LaunchGrid],
    energy: F64,
    two_sets_db: float,
    seed: int,
    allowed: float,
) -> Witness | None:
    """Error by the spacing of the rays for coherent returns, and by the scatter of two sets; None without such rays.

    Parameters
    ----------
    profiles : echoes (n_channels, ...) of some rays of one pulse or look, all of the same weight
    lattices : of one ray set
    energy : (n_channels,) of the echoes of all rays and sources of this pulse or look
    two_sets_db : error measured by the difference of two ray sets, worst channel, dB; NaN: there is one set
    seed : of the draw
    allowed : most rays to be traced

    Returns
    -------
    Witness of the worst channel: the error of the spacing and that of two sets together. The law is the latter alone
    """
    coherent = [grid for grid in lattices if grid.purpose != "diffuse"]
    n_rays = sum(grid.n_rays for grid in coherent)
    counted = energy > power_from_db(EMPTY_DB) * energy.max(initial=0.0)
    if not n_rays or not counted.any():
        return None
    rng = np.random.default_rng([seed & 0x7FFFFFFF, 0x3A75])
    least = max(1, -(-n_rays // int(np.clip(allowed / PARTS, LEAST_DRAWN, MOST_DRAWN))))
    step = FIRST * least if n_rays > FIRST * LEAST_DRAWN else least
    while True:
        common, chance = _differences(profiles, coherent, step, rng)
        error, spread = (float((x[counted] / energy[counted]).max()) for x in (common, chance))
        if step == least or db_from_power(error + 2.0 * spread) <= FINE_DB:
            break
        step = least
    reference = "rays at half the spacing" + ("" if math.isnan(two_sets_db) else ", and two sets of rays")
    bias = Witness(
        db_from_power(error), db_from_power(error + 2.0 * spread), -(-n_rays // step), reference=reference
    )
    return bias.with_part(two_sets_db)


def _differences(
    profiles: Callable[[Sequence[LaunchGrid]], C64],
    lattices: Sequence[LaunchGrid],
    step: int,
    rng: np.random.Generator,
) -> tuple[F64, F64]:
    """Energy of the change by half the spacing, without bias by the draw, and the chance of the draw; (n_channels,)."""
    groups = GROUPS if step > 1 else 1
    first = int(rng.integers(step))
    change = []
    for k in range(groups):
        drawn = [every_nth(grid, step * groups, first + k * step, RUN) for grid in lattices]
        drawn = [grid for grid in drawn if grid.n_rays]
        if drawn:
            step_of = np.float32(step * groups)
            change.append(step_of * (profiles([halve_spacing(grid) for grid in drawn]) - profiles(drawn)))
    each = np.stack(change)
    mean = each.mean(axis=0)
    axes = tuple(range(1, mean.ndim))
    common = np.square(np.abs(mean), dtype=np.float64).sum(axis=axes)
    if len(each) < 2:
        return common, np.zeros_like(common)
    apart = np.square(np.abs(each - mean), dtype=np.float64).sum(axis=0)
    n = len(each)
    chance = apart.sum(axis=axes) / (n * (n - 1))
    # what the chance of the draw alone may well give is not seen: an F test, with as many degrees of freedom as samples
    # that carry the chance
    carry = np.square(apart.sum(axis=axes)) / np.maximum(np.square(apart).sum(axis=axes), 1e-300)
    limit = scipy.special.fdtri(2.0 * np.maximum(carry, 1.0), 2.0 * (n - 1) * np.maximum(carry, 1.0), SEEN)
    return np.where(common > limit * chance, common - chance, 0.0), chance


def say_rays(name: str, witness: Witness | None) -> str:
    """Text on rays whose measured error is large, or high and far above that of two sets; empty for none.

    It is a warning where two sets of rays say so, too. The witness alone counts all echoes of one pulse, also those of
    large errors far outside the image.
    """
    if witness is None:
        return ""
    measured = f"{name}: the error of the rays at one pulse, measured against half their spacing, is"
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

    Two sets of rays have to say so, too, and half the spacing has to fit the bound on rays.

    Parameters
    ----------
    lattices : of every ray set, at one pulse or look
    """
    if witness is None or sampling.halvings or sampling.scene.settings.ray_spacing > 0.0:
        return None
    coherent = [grid.n_rays for grids in lattices for grid in grids if grid.purpose != "diffuse"]
    if not (witness.error_db > FINE_DB and witness.law_db > FINE_DB) or 4 * max(coherent) > MOST_RAYS:
        return None
    return replace(sampling, halvings=1)
