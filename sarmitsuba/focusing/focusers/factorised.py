"""Fast factorised backprojection: two-stage and recursive."""

import math
from collections.abc import Iterator
from dataclasses import dataclass, replace
from typing import ClassVar

import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import make_interp_spline

from sarmitsuba.focusing.aperture import matched_weights
from sarmitsuba.focusing.factorised.plan import Plan, make_plan
from sarmitsuba.focusing.factorised.stages import make_job, run_plan
from sarmitsuba.focusing.focuser import FOCUSERS, Focused, Focuser, FocusTask, option
from sarmitsuba.focusing.profiles import plan_profiles
from sarmitsuba.image.sar_image import ImageGrid
from sarmitsuba.memory import check_fits
from sarmitsuba.radar.radar import Radar

F64 = NDArray[np.float64]

# layers that share one pass over the geometry
_MAX_LAYERS = 2
# pixels whose summed weight is below this part of the aperture's were not illuminated
_DARK = 1e-6
# nodes of the sum of weights along azimuth, where they are a beam's or bands', and across
_ROW_NODES, _BAND_NODES, _COLUMN_NODES = 65, 257, 17


@dataclass(frozen=True)
class Factorised(Focuser):
    name: ClassVar[str] = "factorised"
    title: ClassVar[str] = "any track and any grid off the flight line; the fastest of them for large images"

    error: float = option(-50.0, "wanted error against exact backprojection, dB")
    upsampling: float = option(0.0, "samples per critical sample of subimages; 0 = as the error wants")
    stages: int = option(0, "between pulses and pixels: 2 (Yegulalp), 3, 4; 0 = those of least time")

    def plan(self, radar: Radar, grid: ImageGrid) -> Plan | str:
        return make_plan(radar, grid, self.error, self.upsampling, self.stages)

    def refusal(self, radar: Radar, grid: ImageGrid) -> str:
        plan = self.plan(radar, grid)
        return plan if isinstance(plan, str) else ""

    def error_db(self, radar: Radar, grid: ImageGrid) -> float:
        plan = self.plan(radar, grid)
        return math.nan if isinstance(plan, str) else plan.error_db + 3.0

    def cpu_seconds(self, radar: Radar, grid: ImageGrid) -> float:
        plan = self.plan(radar, grid)
        return math.inf if isinstance(plan, str) else plan.seconds

    def focus(self, task: FocusTask) -> Focused:
        """Focus."""
        raw, grid = task.raw, task.grid
        radar = raw.radar
        plan = self.plan(radar, grid)
        assert isinstance(plan, Plan)
        profiles = plan_profiles(radar, task.range_window, interpolation=plan.sampling.interpolation)
        n_layers = len(raw.layers)
        image = np.empty((n_layers, *grid.shape), dtype=np.complex64)
        job = None
        for start in range(0, n_layers, _MAX_LAYERS):
            layers = slice(start, min(start + _MAX_LAYERS, n_layers))
            some = replace(raw, data=raw.data[layers], layers=raw.layers[layers])
            job = make_job(some, profiles, plan, task.azimuth_window, grid)
            image[layers] = run_plan(job, plan, grid, task.progress)
        weights = job.pulse_weights.sum()
        scale = np.float32(job.reference**2 / radar.amplitude_constant / weights)
        image *= scale
        return Focused(image, lambda point: matched_weights(radar, point, task.azimuth_window))


FOCUSERS.register(Factorised())
