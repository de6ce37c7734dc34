"""Statistics of a run: counts of the trace kernel, and the ray sampling."""

from collections.abc import Sequence
from dataclasses import dataclass, fields

import numpy as np

from sarmitsuba.tracing.kernel.launch import LaunchGrid, Purpose


@dataclass(frozen=True)
class TraceStatistics:
    """Counts and powers of a simulation.

    Parameters
    ----------
    rays, hits, contributions : over all pulses traced
    outside : contributions outside the receive window or the Doppler window, dropped
    key_pulses : pulses that were traced
    path_pulses : contributions times the pulses to which they were added
    power, power_outside : sum of the powers of all contributions, and of those dropped, W
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
        """Sum of two statistics."""
        return TraceStatistics(**{name: value + getattr(other, name) for name, value in vars(self).items()})

    def scaled(self, factor: float) -> "TraceStatistics":
        """Statistics times a factor, counts rounded."""
        whole = {n: round(v * factor) if isinstance(v, int) else v * factor for n, v in vars(self).items()}
        return TraceStatistics(**whole)


# of a journal's label (:func:`sarmitsuba.machine.journal.fits`)
STATISTICS_FORM = {f.name: type(f.default) for f in fields(TraceStatistics)}


@dataclass(frozen=True)
class LatticeSpacings:
    """Ray spacings of all subsets together, m; 0 where there is no lattice of the kind.

    Parameters
    ----------
    every : of lattices for both kinds of return, where there are no others
    coherent, diffuse : of the rays for this kind of return
    """

    every: float = 0.0
    coherent: float = 0.0
    diffuse: float = 0.0

    @staticmethod
    def of(lattices: Sequence[Sequence[LaunchGrid]]) -> "LatticeSpacings":
        """Spacings from the lattices of every subset; finer levels over small parts do not count."""
        grids = [grid for subset in lattices for grid in subset]

        def spacing(*purposes: Purpose) -> float:
            density = sum(grid.spacing**-2 for grid in grids if grid.purpose in purposes)
            return float(density**-0.5) if density else 0.0

        if all(grid.purpose == "all" for grid in grids):
            return LatticeSpacings(every=spacing("all"))
        return LatticeSpacings(coherent=spacing("all", "coherent"), diffuse=spacing("all", "diffuse"))

    @property
    def finest(self) -> float:
        """Smallest spacing, m."""
        return min(self.as_dict().values())

    @property
    def of_coherent(self) -> float:
        """Spacing of the rays for coherent returns, m; 0 without any."""
        return self.coherent or self.every

    def as_dict(self) -> dict[str, float]:
        """Spacings by kind of return, without absent ones."""
        by_purpose = {"all": self.every, "coherent": self.coherent, "diffuse": self.diffuse}
        return {name: value for name, value in by_purpose.items() if value > 0.0}


@dataclass(frozen=True)
class SamplingReport:
    """Sampling of a simulation.

    Parameters
    ----------
    spacings : ray spacings
    rays_per_key_pulse : of all subsets and lattices
    scatterer_cell : m, edge of the diffuse scatterers' cells
    key_pulse_interval : pulses that shared one tracing
    block_error_db : measured error of that against tracing every pulse; -inf where every pulse is traced, NaN for a
        single block
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
