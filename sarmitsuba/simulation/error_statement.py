"""One statement of the error of radar cross sections: sampling, bounces left out, and theory."""

import math
from dataclasses import dataclass

import numpy as np

from sarmitsuba.arrays import C128, F64
from sarmitsuba.effects.flags import KernelFlags
from sarmitsuba.effects.omitted_waves import SimulatedWaves
from sarmitsuba.effects.theory_error import STRONG_DB, TheoryError, rms_db, stated, theory_error
from sarmitsuba.scene.scene import Scene

# dB, total error above which a sweep is warned of
DOUBTFUL_DB = 3.0
_REMEDIES = {
    "edges that are not simulated": "switch edge_diffraction on",
    "act as one": "describe the plate as a sheet without thickness",
}
_FULL_WAVE = "take a full-wave solver for single levels"


@dataclass(frozen=True, eq=False)
class ErrorStatement:
    """Expected rms error, dB, of levels within ``STRONG_DB`` of the peak, (n_channels,) each; infinite: not known.

    Parameters
    ----------
    sampling_db : by the sampling with rays; NaN: not measured
    bounces_db : by bounces left out
    theory_db : by waves that are not simulated
    total_db : by all of them; errors whose size is not measured are left out
    theory : causes of the theory's error
    """

    sampling_db: F64
    bounces_db: F64
    theory_db: F64
    total_db: F64
    theory: TheoryError

    @staticmethod
    def of(
        scene: Scene,
        flags: KernelFlags,
        directions: F64,
        amplitude: C128,
        sampling_db: tuple[float, ...],
        left_db: float,
    ) -> "ErrorStatement":
        """Statement on a sweep.

        Parameters
        ----------
        scene : the target, at its frequency
        flags : effects that were simulated
        directions : (n, 3) float64, unit vectors to the radar
        amplitude : (n, n_orders, n_channels) complex128, m
        sampling_db : of every channel, energy of the sampling error over that of the echoes, dB; NaN: not measured
        left_db : energy of the bounces left out over that of all, dB; -inf: none

        Notes
        -----
        Energies of sampling and bounces left out are spread evenly over the directions.
        """
        waves = SimulatedWaves(edges=flags.edge_diffraction)
        theory = theory_error(
            scene.geometry,
            scene.materials,
            directions,
            amplitude,
            flags.channels,
            scene.radar.waveform.wavelength,
            waves,
        )
        power = np.square(np.abs(amplitude.sum(axis=1)))
        level = np.nan_to_num(10.0 ** (0.1 * np.asarray(sampling_db, dtype=np.float64)))
        sampling = np.broadcast_to(level * power.mean(axis=0), power.shape)
        left = 0.0 if math.isnan(left_db) else 10.0 ** (0.1 * left_db)
        bounces = np.broadcast_to(left * power.mean(axis=0), power.shape)
        known = np.where(np.isnan(sampling_db), np.nan, 1.0)
        total = rms_db(sampling + bounces + theory.missing, power)
        return ErrorStatement(
            known * rms_db(sampling, power),
            rms_db(bounces, power),
            theory.rms_db,
            np.where(np.isfinite(theory.rms_db), total, np.inf),
            theory,
        )

    @property
    def worst_db(self) -> float:
        """Largest total of the channels, dB."""
        return float(self.total_db.max(initial=0.0))

    @property
    def text(self) -> str:
        """Statement in one line."""
        parts = [
            f"sampling {_level(self.sampling_db)}",
            f"bounces left out {_level(self.bounces_db)}",
            self.theory.text,
        ]
        if self.theory.unknown:
            total = "not known"
        else:
            total = f"within {_level(self.total_db)}"
            if self.worst_db > DOUBTFUL_DB:
                total = stated(self.worst_db)
        return f"expected error (rms, down to {STRONG_DB:g} dB below the peak): {total}: {', '.join(parts)}"

    @property
    def warning(self) -> str:
        """Warning with a remedy; empty where the total is low, or nothing is known that speaks against it."""
        if self.theory.unknown:
            return f"{self.theory.text}; {_FULL_WAVE}" if self.theory.doubtful else ""
        if self.worst_db <= DOUBTFUL_DB:
            return ""
        sampled = float(np.nan_to_num(np.maximum(self.sampling_db, self.bounces_db)).max(initial=0.0))
        if sampled > self.theory.worst_db:
            remedy = "set a smaller ray_spacing, or a higher max_depth"
        else:
            first = self.theory.causes[0].text if self.theory.causes else ""
            remedy = next((r for key, r in _REMEDIES.items() if key in first), _FULL_WAVE)
        return f"levels are {stated(self.worst_db)} ({self.theory.text}); {remedy}"

    def as_dict(self, channels: tuple[str, ...]) -> dict[str, object]:
        """Values for JSON; None where they are not known."""
        return {
            "strong_part_db": STRONG_DB,
            **{
                name: {c: _finite(v) for c, v in zip(channels, values, strict=True)}
                for name, values in (
                    ("sampling_db", self.sampling_db),
                    ("bounces_left_out_db", self.bounces_db),
                    ("theory_db", self.theory_db),
                    ("total_db", self.total_db),
                )
            },
            "causes": [{"cause": c.text, "rms_db": _finite(c.rms_db)} for c in self.theory.causes],
            "text": self.text,
        }


def _level(values: F64) -> str:
    known = values[~np.isnan(values)]
    return (
        f"{max(float(known.max()), 0.0):.2g} dB"
        if known.size and np.isfinite(known).all()
        else "not measured"
    )


def _finite(value: float) -> float | None:
    return round(float(value), 3) if math.isfinite(value) else None
