"""Bounce depth: contribution of each bounce to an image of a scene, and its cost."""

import warnings
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from sarmitsuba.apps.cost_trials import TrialSetting, run_trial
from sarmitsuba.core.arrays import C64
from sarmitsuba.core.errors import SarmitsubaWarning, SceneError
from sarmitsuba.core.progress import Progress, silent
from sarmitsuba.core.units import amplitude_from_db, db_from_power
from sarmitsuba.scene.scene import Scene
from sarmitsuba.signal.image import ImageGrid, SarImage
from sarmitsuba.signal.metrics import image_error_db
from sarmitsuba.simulation.execution.render import RenderOptions, execute

# bounces of the reference image, by default
DEEPEST = 6
# a pixel counts as changed by a bounce that alters its level by more than this
CHANGED_DB = 1.0


@dataclass(frozen=True)
class DepthRow:
    """One number of bounces.

    Parameters
    ----------
    bounces : largest number of bounces, from 1
    error_db : energy of the image's difference from the deepest one, over that of the deepest one; -inf: none
    energy_db : energy of the image of this bounce alone, over that of the deepest image; -inf: none
    changed : share of the pixels whose level this bounce changes by more than ``CHANGED_DB``; 1 for the first
    seconds : processor seconds of a separate run that ends at this bounce, without compiling; NaN: not run
    """

    bounces: int
    error_db: float
    energy_db: float
    changed: float
    seconds: float


@dataclass(frozen=True, eq=False)
class DepthStudy:
    """Error, energy and time by number of bounces.

    Parameters
    ----------
    scene : its name
    channel : of the images
    image : of the deepest run, its bounce orders kept apart
    rows : one for each number of bounces
    """

    scene: str
    channel: str
    image: SarImage
    rows: tuple[DepthRow, ...]

    def image_up_to(self, bounces: int) -> SarImage:
        """The image that ends at a number of bounces; its first channel is the study's."""
        return pick_orders(self.image, self.channel, range(1, bounces + 1))

    def image_of(self, bounce: int) -> SarImage:
        """The image of one bounce order alone."""
        return pick_orders(self.image, self.channel, (bounce,))


def study_depth(
    scene: Scene,
    *,
    deepest: int = DEEPEST,
    channel: str | None = None,
    grid: ImageGrid | None = None,
    timed: bool = True,
    progress: Progress | None = None,
) -> DepthStudy:
    """Measure the contribution of each bounce to the image of a scene, and its cost.

    Errors and energies are of one run that keeps its bounces apart, so that all depths share rays and scatterers and no
    ray sampling stands between them. Seconds are of a run for each depth, simulated and focused.

    Parameters
    ----------
    scene : as loaded
    deepest : bounces of the reference image, from 2
    channel : polarisation; default: the first
    grid : pixels; default: those that the scene asks for
    timed : whether to run every depth for its seconds
    progress : called with the stage ``depth`` and the runs that are done

    Returns
    -------
    DepthStudy

    Raises
    ------
    SceneError
        The method traces one bounce only, or the scene has no surfaces, or no such channel.
    """
    settings = scene.settings
    if settings.method == "raster":
        raise SceneError(f"{scene.name}: method raster has one bounce; take hybrid, raw or image")
    if not scene.traced:
        raise SceneError(f"{scene.name}: has no surfaces, so no path has a second bounce")
    if channel is not None and channel not in scene.radar.channels:
        raise SceneError(
            f"{scene.name}: no channel {channel!r}; the radar has {', '.join(scene.radar.channels)}"
        )
    report, runs = progress or silent, 1 + (deepest if timed else 0)
    kept = replace(settings, max_depth=deepest, keep_orders=True, target_error_db=0.0, time_limit=0.0)
    image = execute(replace(scene, settings=kept), RenderOptions(error_bars=False, grid=grid)).image
    assert image is not None
    report("depth", 1, runs, {})
    channel = channel or image.channels[0]
    planes = [pick_orders(image, channel, (n,)).total(channel) for n in range(1, deepest + 1)]
    total = np.sum(planes, axis=0)
    energy = float(np.vdot(total, total).real)
    rows = []
    for bounces in range(1, deepest + 1):
        part, before = np.sum(planes[:bounces], axis=0), np.sum(planes[: bounces - 1], axis=0)
        alone = float(np.vdot(planes[bounces - 1], planes[bounces - 1]).real)
        seconds = float("nan")
        if timed:
            setting = TrialSetting({"max_depth": bounces, "target_error_db": 0.0, "time_limit": 0.0})
            with warnings.catch_warnings():  # that returns are left out is the point of these runs
                warnings.simplefilter("ignore", SarmitsubaWarning)
                seconds = run_trial(scene, setting).seconds
            report("depth", 1 + bounces, runs, {})
        rows.append(
            DepthRow(
                bounces,
                image_error_db(part, total) if energy > 0.0 else float("-inf"),
                db_from_power(alone / energy) if energy > 0.0 else float("-inf"),
                _share_changed(part, before) if bounces > 1 else 1.0,
                seconds,
            )
        )
    return DepthStudy(scene.name, channel, image, tuple(rows))


def pick_orders(image: SarImage, channel: str, orders: Sequence[int]) -> SarImage:
    """The part of an image of some bounce orders of one channel."""
    kept = [i for i, layer in enumerate(image.layers) if layer.channel == channel and layer.order in orders]
    return replace(image, data=image.data[kept], layers=tuple(image.layers[i] for i in kept))


def _share_changed(part: C64, before: C64) -> float:
    """Share of the pixels whose level differs by more than ``CHANGED_DB``."""
    ratio = amplitude_from_db(CHANGED_DB)
    a, b = np.abs(part), np.abs(before)
    return float(np.mean((a > ratio * b) | (b > ratio * a)))
