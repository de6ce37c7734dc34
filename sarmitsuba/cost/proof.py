"""Verification of a cost study's estimates: error against a reference, and seconds of a setting."""

from dataclasses import dataclass

import numpy as np

from sarmitsuba.arrays import C64, C128
from sarmitsuba.cost.clock import StudyClock
from sarmitsuba.cost.trial import Changes, TrialSetting, run_trial
from sarmitsuba.image.sar_image import ImageGrid
from sarmitsuba.scene.scene import Scene

Image = C64 | C128

# runs shorter than this are made again, s, and the faster one counts: what disturbs a run only makes it longer
STEADY = 3.0
# first of the reference's lattices, which no trial shares
REFERENCE_PASS = 1000


@dataclass(frozen=True, eq=False)
class Reference:
    """A converged image.

    Parameters
    ----------
    image : (n_azimuth, n_range) complex64, mean of two runs with lattices of their own
    noise : energy of what the lattices leave in the mean over its own, from the difference of the two
    """

    image: C64
    noise: float

    @staticmethod
    def of(scene: Scene, setting: TrialSetting, grid: ImageGrid, clock: StudyClock) -> "Reference":
        """Trace it."""
        a, b = (
            run_trial(scene, setting, grid, pass_index=REFERENCE_PASS + i, clock=clock).image
            for i in range(2)
        )
        mean = 0.5 * (a.astype(np.complex128) + b)
        return Reference(mean.astype(np.complex64), _energy(a - b) / (4.0 * _energy(mean)))

    def error_db(self, image: Image) -> float:
        """Energy of an image's error over that of the reference, dB, minus the reference's own noise.

        At most half of the difference is taken to be the reference's.
        """
        ratio = _energy(image - self.image) / _energy(self.image)
        return 10.0 * float(np.log10(max(ratio - self.noise, 0.5 * ratio, 1e-12)))


def _energy(image: Image) -> float:
    return float(np.sum(np.abs(image.astype(np.complex128)) ** 2))


@dataclass(frozen=True)
class ProofRun:
    """Measured error (dB) and seconds of a setting."""

    error_db: float
    seconds: float


@dataclass(frozen=True, eq=False)
class Proof:
    """Runs settings for their error and time.

    Parameters
    ----------
    scene : the whole; seconds are of it
    field : the part of it that errors are of: the whole where a reference of the whole fits the budget
    grid : of the field's image
    base : settings that changes are made to
    reference : image of the field
    factor : ray spacing of the reference, in automatic ones
    text : which part the field is
    clock : of the seconds
    """

    scene: Scene
    field: Scene
    grid: ImageGrid
    base: TrialSetting
    reference: Reference
    factor: float
    text: str
    clock: StudyClock

    def cost(self, seconds: float) -> float:
        """Seconds that :meth:`measure` takes for a setting that takes the whole scene so many."""
        return seconds * ((2.0 if seconds < STEADY else 1.0) + (self.field is not self.scene))

    def measure(self, changes: Changes, pass_index: int = 0) -> ProofRun:
        """Error on the field and seconds on the whole scene, with these lattices."""
        setting = self.base.but(**changes)
        trial = run_trial(self.field, setting, self.grid, pass_index=pass_index, clock=self.clock)
        error = self.reference.error_db(trial.image)
        if self.field is not self.scene:
            trial = run_trial(self.scene, setting, pass_index=pass_index, clock=self.clock)
        seconds = trial.seconds
        if seconds < STEADY:
            seconds = min(
                seconds, run_trial(self.scene, setting, pass_index=pass_index, clock=self.clock).seconds
            )
        return ProofRun(error, seconds)
