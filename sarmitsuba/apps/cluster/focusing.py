"""Backprojection by the workers of a cluster: one task per launch of pixels; every worker holds all raw data."""

import math
from collections.abc import Callable
from dataclasses import dataclass, field, fields
from functools import partial

import numpy as np

from sarmitsuba.apps.cluster.dask_workers import DaskWorkers
from sarmitsuba.radar.radar import Radar
from sarmitsuba.signal.focusing.aperture_weights import matched_weights
from sarmitsuba.signal.focusing.focuser import Auto, Focused, Focuser, FocusTask, OptionValue
from sarmitsuba.signal.focusing.focusers.backprojection import Backprojection
from sarmitsuba.signal.focusing.pixel_tiles import TILE_PIXELS, Tiles
from sarmitsuba.signal.image.sar_image import ImageGrid


@dataclass(frozen=True)
class SharedBackprojection(Backprojection):
    """:class:`Backprojection` with the same pixels, distributed to workers where it takes more than one launch."""

    workers: "DaskWorkers | None" = field(default=None, repr=False)
    tile_pixels: int = field(default=TILE_PIXELS, repr=False)

    @property
    def options(self) -> dict[str, OptionValue]:
        """Options of the backprojection."""
        return {option.name: getattr(self, option.name) for option in fields(Backprojection)}

    def focus(self, task: FocusTask) -> Focused:
        """Focus."""
        tiles = Tiles(
            task.raw,
            task.grid,
            task.range_window,
            task.azimuth_window,
            self.interpolation,
            self.oversampling,
            tile_pixels=self.tile_pixels,
        )
        count = sum(1 for _ in tiles.launches())
        if self.workers is None or count < 2:
            return super().focus(task)
        image = np.empty((len(task.raw.layers), int(np.prod(tiles.shape))), dtype=np.complex64)
        for done, tile in enumerate(self.workers.spread(partial(_same, tiles), Tiles.tile, range(count)), 1):
            image[tile.layers, tile.start : tile.stop] = tile.pixels
            task.progress("focus", float(done), float(count), {"workers": float(self.workers.n_workers)})
        pixels = image.reshape(len(task.raw.layers), *tiles.shape)
        return Focused(pixels, lambda point: matched_weights(task.raw.radar, point, task.azimuth_window))


@dataclass(frozen=True)
class SharedAuto(Auto):
    """:class:`Auto` whose choice is distributed to workers where it is backprojection."""

    workers: "DaskWorkers | None" = field(default=None, repr=False)

    @property
    def options(self) -> dict[str, OptionValue]:
        """Options of the choice."""
        return {"error": self.error}

    def resolved(
        self, radar: Radar, grid: ImageGrid, data_error_db: Callable[[], float] = lambda: math.nan
    ) -> tuple[Focuser, str]:
        """The focuser used, distributed to the workers, and why."""
        found, reason = super().resolved(radar, grid, data_error_db)
        return (shared(found, self.workers) if self.workers else found), reason


def shared(focuser: Focuser, workers: DaskWorkers) -> Focuser:
    """The focuser distributed to workers; itself where it is not backprojection."""
    if type(focuser) is Auto:
        return SharedAuto(focuser.error, workers)
    if type(focuser) is not Backprojection:
        return focuser
    return SharedBackprojection(focuser.interpolation, focuser.oversampling, workers)


def _same(tiles: Tiles) -> Tiles:
    return tiles
