"""Interferometry: what two images of one scene say together."""

from sarmitsuba.interferometry.baseline import Baseline
from sarmitsuba.interferometry.heights import HeightMap, heights, unwrapped_phase
from sarmitsuba.interferometry.interferogram import Interferogram, interferogram

__all__ = ["Baseline", "HeightMap", "Interferogram", "heights", "interferogram", "unwrapped_phase"]
