"""Interferometry of two images of one scene."""

from sarmitsuba.analysis.interferometry.baseline import Baseline
from sarmitsuba.analysis.interferometry.heights import HeightMap, height_map, unwrapped_phase
from sarmitsuba.analysis.interferometry.interferogram import Interferogram, interferogram
from sarmitsuba.analysis.interferometry.planning import PassOffset, second_pass

__all__ = [
    "Baseline",
    "HeightMap",
    "Interferogram",
    "PassOffset",
    "height_map",
    "interferogram",
    "second_pass",
    "unwrapped_phase",
]
