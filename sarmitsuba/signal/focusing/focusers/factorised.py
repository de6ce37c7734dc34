"""Fast factorised backprojection focuser: two-stage and recursive."""

import math
from collections.abc import Iterator
from dataclasses import dataclass, replace
from functools import cached_property
from typing import ClassVar

import numpy as np

from sarmitsuba.core.arrays import C64, F32, LinearMap
from sarmitsuba.core.errors import DataError
from sarmitsuba.core.units import db_from_power, power_from_db
from sarmitsuba.machine.memory import check_fits
from sarmitsuba.radar.radar import Radar
from sarmitsuba.signal.focusing.aperture_weights import DARK, matched_weights
from sarmitsuba.signal.focusing.factorised.adjoint import adjoint_plan
from sarmitsuba.signal.focusing.factorised.division import Plan
from sarmitsuba.signal.focusing.factorised.image_weights import alike, image_weights, pulse_weights
from sarmitsuba.signal.focusing.factorised.sampling import MARGIN_DB, UPSAMPLING
from sarmitsuba.signal.focusing.factorised.section_plan import make_plan
from sarmitsuba.signal.focusing.factorised.stages import Job, image_reference, make_job, plan_bytes, run_plan
from sarmitsuba.signal.focusing.focuser import (
    ERROR_DB,
    FOCUSERS,
    PIXEL,
    Focused,
    Focuser,
    FocusTask,
    option,
)
from sarmitsuba.signal.focusing.profiles import ProfilePlan, plan_profiles
from sarmitsuba.signal.focusing.windows import Window, parse_window
from sarmitsuba.signal.image import ImageGrid

# layers that share one evaluation of the geometry
_MAX_LAYERS = 2
# pixels whose summed weight is below this part of the aperture's were not illuminated
_DARK = 1e-6
# processor seconds of a pulse in the summed weights, at all of their nodes
_WEIGHTS = 5e-5
STAGES = (0, 2, 3, 4)
RECTANGULAR = parse_window("rectangular")


@dataclass(frozen=True)
class Factorised(Focuser):
    r"""Fast factorised backprojection: coarse subimages of few pulses are merged into finer ones of many pulses.

    Consecutive pulses about the mean position :math:`A_g` of their group make a subimage

    .. math:: b_g(p) = \sum_{t \in g} w_t g_t R_t^2 s_t(R_t) e^{+j k_c (R_t - R_g)}, \quad k_c = 4 \pi f_c / c

    whose spectrum, without the carrier of :math:`R_g = |p - A_g|`, is as narrow as the group is short: in angle
    about the group it needs few samples. Subimages of neighbouring groups are refined in angle, brought to a common
    carrier by :math:`e^{j k_c (R_g - R_G)}` and summed; the widest ones are interpolated at the pixels. ``stages=2``
    has no merger: the local backprojection of Yegulalp 1999. With 3 and 4 it is the recursion of Ulander, Hellsten and
    Stenstrom 2003, with one difference: all subimages of a section of the aperture have the section's ranges, so that
    mergers interpolate in angle only (as Dong 2017 does in Cartesian coordinates). Sections are as long as this saves
    time; within one, :math:`\kappa (d R_t / d\varphi)` of the range band :math:`|\kappa| \le 2 \pi B / c` widens the
    spectrum in angle.

    Every grid samples the spectra of its pulses, computed from the track, times ``upsampling``; the error is that of
    the interpolations, predicted by :meth:`sarmitsuba.signal.focusing.factorised.sampling.SubimageSampling.error_db`,
    and ``upsampling=0`` uses the smallest that meets ``error``.

    Validity: any track, spotlight or with apertures of the pixels' own (then in two stages). Refuses an image that
    extends below the track, where angle and range are no coordinates, one that leaves the receive window, and own
    apertures whose sharp ends need sections so long that backprojection is as fast.

    Notes
    -----
    Has the limits of backprojection. Where a pixel's aperture ends within a section, the section's subimage has
    an edge, of which the part outside its spectrum is lost: the longer the section over the Fresnel length
    :math:`\sqrt{\lambda R / 2}`, the less (:attr:`sarmitsuba.signal.focusing.factorised.division.Plan.edge_db`, an
    empirical law).

    Errors are relative to the energy of all echoes that pass through the image's pixels, side lobes included. In a crop
    beside something far brighter they are larger than stated, relative to the crop: by 2 dB for a point 20 m outside,
    70 dB above the pixels.
    """

    name: ClassVar[str] = "factorised"
    title: ClassVar[str] = "any track, an image off the flight line; fast for large images"

    error: float = option(-50.0, "wanted error against exact backprojection, dB", within=ERROR_DB)
    upsampling: float = option(
        0.0,
        "samples per critical sample of subimages; 0 = from the wanted error",
        within=UPSAMPLING,
        automatic=True,
    )
    stages: int = option(
        0, "stages between pulses and pixels: 2 (Yegulalp), 3 or 4; 0 = the fastest", choices=STAGES
    )

    def plan(self, radar: Radar, grid: ImageGrid, window: Window = RECTANGULAR) -> Plan | str:
        """Division of the aperture; the reason where it is impossible."""
        return make_plan(radar, grid, window, self.error, self.upsampling, self.stages)

    def refusal(self, radar: Radar, grid: ImageGrid) -> str:
        """Reason why it cannot focus this radar's data on this grid; empty when it can."""
        plan = self.plan(radar, grid)
        if isinstance(plan, str):
            return plan
        if np.isfinite(radar.half_aperture) and self._seconds(plan, radar) > super().cpu_seconds(radar, grid):
            return (
                f"the pixels' own apertures end so sharply that {self.error:g} dB would take longer than "
                "backprojection; raise error"
            )
        return ""

    def error_db(self, radar: Radar, grid: ImageGrid) -> float:
        """Predicted error for a rectangular azimuth window, with a margin; NaN where the image leaves the beam.

        With the error of the summed weights between their nodes, measured halfway.
        """
        plan = self.plan(radar, grid)
        if isinstance(plan, str):
            return math.nan
        power = power_from_db(plan.error_db + MARGIN_DB)
        if not alike(radar):
            weights = image_weights(radar, grid, RECTANGULAR)
            if weights.least <= DARK:
                return math.nan
            power += weights.error_power
        return db_from_power(power)

    def making_bytes(self, radar: Radar, grid: ImageGrid, n_layers: int) -> int:
        """Peak memory in bytes while the pixels are made, pixels included, raw data not."""
        plan = self.plan(radar, grid)
        if isinstance(plan, str):
            return super().making_bytes(radar, grid, n_layers)
        profiles = plan_profiles(radar, RECTANGULAR, interpolation=plan.sampling.interpolation)
        pixels = PIXEL * int(np.prod(grid.shape)) * n_layers
        return pixels + plan_bytes(plan, profiles, grid, min(n_layers, _MAX_LAYERS))

    def cpu_seconds(self, radar: Radar, grid: ImageGrid) -> float:
        """Processor time of all stages."""
        plan = self.plan(radar, grid)
        return math.inf if isinstance(plan, str) else self._seconds(plan, radar)

    @staticmethod
    def _seconds(plan: Plan, radar: Radar) -> float:
        """Processor time of all stages, and of the weights where they vary over the image."""
        uniform = not radar.antenna.directive and np.isinf(radar.half_aperture)
        return plan.seconds + (0.0 if uniform else _WEIGHTS * radar.track.n_pulses)

    def imaging(self, task: FocusTask) -> LinearMap:
        """Linear map from data to pixels.

        Raises
        ------
        DataError
            The aperture cannot be divided, see :meth:`refusal`.
        ResourceError
            Subimages and profiles do not fit into memory.
        """
        radar = task.raw.radar
        plan = self.plan(radar, task.grid, task.azimuth_window)
        if isinstance(plan, str):
            raise DataError(f"focuser factorised: {plan}")
        profiles = plan_profiles(radar, task.range_window, interpolation=plan.sampling.interpolation)
        check_fits(
            f"focuser factorised: subimages of {len(plan.sections)} sections",
            plan_bytes(plan, profiles, task.grid, min(len(task.raw.layers), _MAX_LAYERS)),
            "make the image smaller, or use focuser backprojection",
        )
        return FactorisedImaging(task, plan, profiles)

    def focus(self, task: FocusTask) -> Focused:
        """Focus; raises as :meth:`imaging` does."""
        radar, pixels = task.raw.radar, self.imaging(task).forward(task.raw.data)
        return Focused(pixels, lambda point: matched_weights(radar, point, task.azimuth_window))


@dataclass(frozen=True, eq=False)
class FactorisedImaging(LinearMap):
    """Linear map of factorised backprojection, from range-compressed data to pixels.

    Parameters
    ----------
    task : with data of the right shape
    plan : division of the aperture
    profiles : interpolation plan of the echoes
    """

    task: FocusTask
    plan: Plan
    profiles: ProfilePlan

    def forward(self, values: C64) -> C64:
        """Pixels (n_layers, n_azimuth, n_range) of data (n_layers, n_pulses, n_samples)."""
        grid = self.task.grid
        image = np.empty((len(values), *grid.shape), dtype=np.complex64)
        for layers, job in self._jobs(values):
            image[layers] = run_plan(job, self.plan, grid, self.task.progress)
            image[layers] *= self._scale
        return image

    def adjoint(self, values: C64) -> C64:
        """Data from pixels."""
        raw = self.task.raw
        data = np.empty(raw.data.shape, dtype=np.complex64)
        for layers, job in self._jobs(raw.data):
            pixels = values[layers] * self._scale
            data[layers] = adjoint_plan(job, self.plan, self.task.grid, pixels, self.task.progress)
        return data

    def _jobs(self, data: C64) -> Iterator[tuple[slice, Job]]:
        """Layers that are processed together."""
        task, raw = self.task, self.task.raw
        for start in range(0, len(raw.layers), _MAX_LAYERS):
            layers = slice(start, min(start + _MAX_LAYERS, len(raw.layers)))
            some = replace(raw, data=data[layers], layers=raw.layers[layers])
            yield layers, make_job(some, self.profiles, self.plan, task.azimuth_window, task.grid)

    @cached_property
    def _scale(self) -> F32:
        """Calibration of the pixels, (n_azimuth, n_range), or one for all; 0 where dark."""
        radar, grid, window = self.task.raw.radar, self.task.grid, self.task.azimuth_window
        whole = pulse_weights(radar, window).sum()
        weights = (
            np.full((1, 1), whole, dtype=np.float32)
            if alike(radar)
            else image_weights(radar, grid, window).at(grid)
        )
        scale = np.float32(image_reference(radar, grid) ** 2 / radar.amplitude_constant)
        return np.divide(scale, weights, out=np.zeros_like(weights), where=weights > _DARK * whole)


FOCUSERS.register(Factorised())
