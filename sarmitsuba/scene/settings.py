"""Settings of the tracing."""

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Literal

import numpy as np

from sarmitsuba.core.errors import DataError, SceneError
from sarmitsuba.core.parameters import knows_its_fields, one_line

Method = Literal["raw", "hybrid", "image", "raster"]
Switch = Literal["auto", "on", "off"]
METHODS: tuple[Method, ...] = ("raw", "hybrid", "image", "raster")
# an effect that changes the image by less than this is left out, dB relative to the image's clutter or peak
TOLERANCE_DB = -40.0
_LARGEST_SEED = 2**31 - 1


@knows_its_fields
@dataclass(frozen=True)
class TraceSettings:
    """Settings of the tracing; zero means automatic where the parameter says so.

    Parameters
    ----------
    method : ``raw`` (every pulse traced), ``hybrid`` (key pulses), ``image`` (one look),
        ``raster`` (one bounce)
    max_depth : largest number of bounces; 0 = automatic
    ray_spacing : m, distance between rays in the launch plane; 0 = automatic
    diffuse_ray_spacing : m, of the rays for diffuse scattering; 0 = automatic, at least ``ray_spacing``
    key_pulse_interval : pulses that share one tracing; 0 = automatic
    scatterer_cell : m, side of the cells that carry one persistent diffuse scatterer; 0 = automatic
    gridding_width : width of the gridding kernel, samples
    seed : of all random numbers
    pass_days : days since the first pass, over which the scene decorrelates
    keep_orders : store contributions by number of bounces
    keep_subsets : store two independent ray subsets separately
    phase_precision : arithmetic of path lengths and phases
    tolerance_db : an effect that changes the image by less is left out, dB relative to its clutter or peak; below 0
    target_error_db : sampling error up to which passes are added, dB relative to the image's clutter or peak; 0 = off
    time_limit : for which passes are added, s; 0 = off
    default_rms_height : m, of Sionna's materials without a roughness; 0: none has a typical one; used while loading
    smooth : whether meshes are taken for their smooth surfaces, see :mod:`sarmitsuba.scene.mesh.smooth_surface`; used
        while loading
    endless_ground : whether level ground goes on beyond its rim, see :mod:`sarmitsuba.scene.ground`
    effects : name of an effect to ``auto``, ``on`` or ``off``; others are ``auto``
    """

    method: Method = "hybrid"
    max_depth: int = 0
    ray_spacing: float = 0.0
    diffuse_ray_spacing: float = 0.0
    key_pulse_interval: int = 0
    scatterer_cell: float = 0.0
    gridding_width: int = 4
    seed: int = 0
    pass_days: float = 0.0
    keep_orders: bool = False
    keep_subsets: bool = False
    phase_precision: Literal["double", "single"] = "double"
    tolerance_db: float = TOLERANCE_DB
    target_error_db: float = 0.0
    time_limit: float = 0.0
    default_rms_height: float = 1e-3
    smooth: bool = False
    endless_ground: Switch = "auto"
    effects: Mapping[str, Switch] = field(default_factory=dict)

    def __post_init__(self) -> None:
        whole = isinstance(self.seed, int | np.integer) and not isinstance(self.seed, bool)
        if not whole or not 0 <= self.seed <= _LARGEST_SEED:
            raise SceneError(
                f"seed = {one_line(self.seed, 40)} is not a whole number between 0 and {_LARGEST_SEED}; choose one"
            )

    @property
    def one_look(self) -> bool:
        """Whether the method makes an image of one look, without raw data."""
        return self.method in ("image", "raster")

    @property
    def adds_passes(self) -> bool:
        """Whether passes of rays are added until an error or a time is reached."""
        return self.target_error_db < 0.0 or self.time_limit > 0.0

    def check(self, name: str, *, raw: bool) -> None:
        """Refuse settings that contradict each other, before any work.

        Parameters
        ----------
        name : of the scene
        raw : whether raw data are asked for

        Raises
        ------
        DataError
            One line: the settings and the remedy.
        """
        if self.one_look and raw:
            raise DataError(
                f"{name}: method {self.method} makes an image without raw data; render it (without --no-focus and "
                "--raw), or take method hybrid"
            )
        if self.one_look and self.adds_passes:
            raise DataError(
                f"{name}: method {self.method} makes one pass only; leave out target_error_db and time_limit "
                "(--target-error, --time-limit), or take method hybrid"
            )
