"""What a run did: counts of the trace kernel, and the rays it took."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from sarmitsuba.trace.launch import LaunchGrid, Purpose


@dataclass(frozen=True)
class TraceStatistics:
    """What a simulation did.

    Parameters
    ----------
    rays, hits, contributions : over all pulses traced
    outside : contributions outside the receive window or the Doppler window, dropped
    key_pulses : pulses that were traced
    path_pulses : contributions times the pulses they went to
    power, power_outside : of all contributions and of those dropped, taken singly, W
    """

    rays: int = 0
    hits: int = 0
    contributions: int = 0
    outside: int = 0
    key_pulses: int = 0
    path_pulses: int = 0
    power: float = 0.0
    power_outside: float = 0.0

    def plus(self, other: "TraceStatistics") -> "TraceStatistics":
        """Sum."""
        return TraceStatistics(**{name: value + getattr(other, name) for name, value in vars(self).items()})

    def scaled(self, factor: float) -> "TraceStatistics":
        """Times a factor, counts rounded."""
        whole = {n: round(v * factor) if isinstance(v, int) else v * factor for n, v in vars(self).items()}
        return TraceStatistics(**whole)


@dataclass(frozen=True)
class LatticeSpacings:
    """Distances between the rays of all subsets together, m; 0 where there is no lattice of the kind.

    Parameters
    ----------
    every : of lattices that serve both kinds of return, where there are no others
    coherent, diffuse : of the rays that serve this kind of return
    """

    every: float = 0.0
    coherent: float = 0.0
    diffuse: float = 0.0

    @staticmethod
    def of(lattices: Sequence[Sequence[LaunchGrid]]) -> "LatticeSpacings":
        """From the lattices of every subset; finer levels over small parts do not count."""
        grids = [grid for subset in lattices for grid in subset]

        def spacing(*purposes: Purpose) -> float:
            density = sum(grid.spacing**-2 for grid in grids if grid.purpose in purposes)
            return float(density**-0.5) if density else 0.0

        if all(grid.purpose == "all" for grid in grids):
            return LatticeSpacings(every=spacing("all"))
        return LatticeSpacings(coherent=spacing("all", "coherent"), diffuse=spacing("all", "diffuse"))

    @property
    def finest(self) -> float:
        """The least, m."""
        return min(self.as_dict().values())

    @property
    def of_coherent(self) -> float:
        """Of the rays that serve coherent returns, m; 0 without any."""
        return self.coherent or self.every

    def as_dict(self) -> dict[str, float]:
        """By purpose, those that there are."""
        by_purpose = {"all": self.every, "coherent": self.coherent, "diffuse": self.diffuse}
        return {name: value for name, value in by_purpose.items() if value > 0.0}


@dataclass(frozen=True)
class SamplingReport:
    """The rays that a simulation took.

    Parameters
    ----------
    spacings : distances between them
    rays_per_key_pulse : of all subsets and lattices
    scatterer_cell : m, edge of the diffuse scatterers' cells
    key_pulse_interval : pulses that shared one tracing
    block_error_db : error that this makes against tracing every pulse, measured; -inf where every one is, NaN where one
        block holds all
    grid_bytes : of the largest accumulator grid
    """

    spacings: LatticeSpacings
    rays_per_key_pulse: int
    scatterer_cell: float
    key_pulse_interval: int
    block_error_db: float
    grid_bytes: int

    def as_dict(self) -> dict[str, object]:
        """JSON-able form."""
        return {
            "ray_spacing": self.spacings.finest,
            "ray_spacings": self.spacings.as_dict(),
            "rays_per_key_pulse": self.rays_per_key_pulse,
            "scatterer_cell": self.scatterer_cell,
            "key_pulse_interval": self.key_pulse_interval,
            "block_error_db": round(self.block_error_db, 1) if np.isfinite(self.block_error_db) else None,
            "grid_bytes": self.grid_bytes,
        }
