"""How to trace."""

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Literal

Method = Literal["raw", "hybrid", "image", "raster"]
Switch = Literal["auto", "on", "off"]
METHODS: tuple[Method, ...] = ("raw", "hybrid", "image", "raster")
# an effect whose absence changes the image by less than this is left out, dB of the image's clutter or peak
TOLERANCE_DB = -40.0


@dataclass(frozen=True)
class TraceSettings:
    """How to trace; zero means automatic where the parameter says so.

    Parameters
    ----------
    method : ``raw`` (every pulse traced), ``hybrid`` (key pulses), ``image`` (one look),
        ``raster`` (one bounce)
    max_depth : most bounces; 0 = automatic
    ray_spacing : m, distance between rays in the launch plane; 0 = automatic
    diffuse_ray_spacing : m, of the rays that find diffuse scatterers; 0 = automatic, at least ``ray_spacing``
    key_pulse_interval : pulses that share one tracing; 0 = automatic
    scatterer_cell : m, side of the cells that carry one persistent diffuse scatterer; 0 = automatic
    gridding_width : samples that one contribution is spread over
    seed : of every random number
    pass_days : since the first pass; what changes between passes has changed since
    keep_orders : keep contributions of different bounce numbers apart
    keep_subsets : keep two independent ray subsets apart
    phase_precision : arithmetic of path lengths and phases
    tolerance_db : an effect that changes the image by less is left out, dB of its clutter or peak; below 0
    target_error_db : dB of the image's clutter or peak; 0 = off
    time_limit : s; 0 = off
    default_rms_height : m, roughness of materials that state none; used while loading
    effects : name of an effect to ``auto``, ``on`` or ``off``; what is not named is ``auto``
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
    effects: Mapping[str, Switch] = field(default_factory=dict)
