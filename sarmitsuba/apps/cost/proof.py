"""Verification of a cost study: measured error against a reference, and time of a setting."""

from dataclasses import dataclass

import numpy as np

from sarmitsuba.apps.cost.trial import Changes, TrialSetting
from sarmitsuba.apps.cost.trials import Trials
from sarmitsuba.core.arrays import C64, C128
from sarmitsuba.scene.scene import Scene
from sarmitsuba.signal.image.sar_image import ImageGrid

Image = C64 | C128

# runs shorter than this are repeated, s
STEADY = 1.0
# factor of the expected seconds, either way, beyond which longer ones are repeated
DEVIATES = 1.25
# number of the first lattices of the reference, not used by any trial
REFERENCE_PASS = 1000


@dataclass(frozen=True, eq=False)
class Reference:
    """Converged reference image.

    Parameters
    ----------
    image : (n_azimuth, n_range) complex64, mean of two runs with different lattices
    noise : relative energy of the mean's error by ray sampling, from the difference of the two
    unseen : most relative energy of the bounces after its last one
    """

    image: C64
    noise: float
    unseen: float = 0.0

    @staticmethod
    def of(
        scene: Scene, setting: TrialSetting, grid: ImageGrid, trials: Trials, unseen: float = 0.0
    ) -> "Reference":
        """Trace it."""
        a, b = (trials.run(scene, setting, grid, pass_index=REFERENCE_PASS + i).image for i in range(2))
        mean = 0.5 * (a.astype(np.complex128) + b)
        return Reference(mean.astype(np.complex64), _energy(a - b) / (4.0 * _energy(mean)), unseen)

    def error_db(self, image: Image) -> float:
        """Energy of an image's error over that of the reference, dB, minus the reference's own noise.

        At most half of the difference is attributed to the reference. Bounces that the reference lacks count as error.
        """
        ratio = _energy(image - self.image) / _energy(self.image)
        return 10.0 * float(np.log10(max(ratio - self.noise, 0.5 * ratio, 1e-12) + self.unseen))


def _energy(image: Image) -> float:
    return float(np.sum(np.abs(image.astype(np.complex128)) ** 2))


@dataclass(frozen=True)
class ProofRun:
    """Measured error (dB) and time (s) of a setting."""

    error_db: float
    seconds: float


@dataclass(frozen=True, eq=False)
class Proof:
    """Measurement of the error and time of settings.

    Parameters
    ----------
    scene : whole scene, for the time
    field : part of the scene for the error: the whole scene if a reference of it fits the budget
    grid : of the field's image
    base : settings to be changed
    reference : image of the field
    factor : ray spacing of the reference, relative to the automatic one
    text : description of the field
    trials : of the study
    """

    scene: Scene
    field: Scene
    grid: ImageGrid
    base: TrialSetting
    reference: Reference
    factor: float
    text: str
    trials: Trials

    def cost(self, seconds: float) -> float:
        """Seconds for :meth:`measure` of a setting that takes ``seconds`` for the whole scene."""
        return seconds * ((2.0 if seconds < STEADY else 1.0) + (self.field is not self.scene))

    def measure(self, changes: Changes, pass_index: int = 0, expected: float | None = None) -> ProofRun:
        """Error on the field and seconds on the whole scene, with these lattices.

        Short runs, and those that deviate from the ``expected`` seconds, are repeated
        (:meth:`sarmitsuba.apps.cost.trials.Trials.steady`).
        """
        setting = self.base.but(**changes)
        trial = self.trials.run(self.field, setting, self.grid, pass_index=pass_index)
        error = self.reference.error_db(trial.image)
        if self.field is not self.scene:
            trial = self.trials.run(self.scene, setting, pass_index=pass_index)
        seconds = trial.seconds
        off = max(seconds / expected, expected / seconds) if expected and seconds > 0.0 else 1.0
        if seconds < STEADY or off > DEVIATES:
            seconds = self.trials.steady(self.scene, setting, pass_index=pass_index).seconds
        return ProofRun(error, seconds)
