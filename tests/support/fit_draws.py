"""Fits drawn at random: parameters, looks, channels, modes, headings, priors and noise; and how they end."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from sarmitsuba import Fit, Prior, RawData, Scene, fit
from sarmitsuba.arrays import F64
from sarmitsuba.errors import SarmitsubaError
from sarmitsuba.gradients.confirmation import CONFIRMED
from sarmitsuba.gradients.forward_model import ForwardModel
from sarmitsuba.gradients.jacobian import parameters_of
from tests.support.buildings import town
from tests.support.differences import CHANNELS
from tests.support.fits import noisy

# how far values start off at most: by what the parameter begins with
OFF = {
    "shift": 1.0,
    "height": 1.0,
    "rotation": 0.03,
    "scale": 0.03,
    "gain": 3.0,
    "level": 3.0,
    "track": 0.03,
    "clock_offset": 2e-9,
    "permittivity": 1.0,
    "rms_height": 0.001,
}
# parameters that move the building, of materials, and of the radar of a look
SHAPES = ("shift:@:x", "shift:@:y", "shift:@:z", "height:@", "rotation:@", "scale:@")
MATERIALS = ("level:soil", "level:*", "permittivity:soil", "rms_height:soil")
RADAR = ("gain", "track:2:x", "clock_offset")
# amplitudes that a fit to data of another scene may shrink with
AMPLITUDES = ("", "gain", "levels")
# errors over the stated standard deviation up to which a value is right
WITHIN = 4.0
# where the data are from: the model's scatterers, others on the same building, another building
OWN, SPECKLE, OTHER = "own", "speckle", "other"


@dataclass(frozen=True, eq=False)
class FitDraw:
    """A drawn fit.

    Parameters
    ----------
    seed : of the draw
    parameters, by, priors : of the fit
    scenes, data : of every look; scenes with wrong values
    truth : (n,) values of the data
    source : of the data, ``OWN``, ``SPECKLE`` or ``OTHER``
    snr_db : mean signal over noise
    told : looks, channels and mode, as text
    """

    seed: int
    parameters: str
    by: str
    priors: dict[str, Prior]
    scenes: tuple[Scene, ...]
    data: tuple[RawData, ...]
    truth: F64
    source: str
    snr_db: float
    told: str

    def ended(self) -> Ended:
        """Fit, and say how it ended."""
        try:
            found: Fit = fit(self.scenes, self.data, self.parameters, by=self.by, priors=self.priors)
        except SarmitsubaError as error:
            return Ended("refused", np.nan, np.nan, str(error))
        off_by = np.abs(found.values - self.truth) / found.sigma
        worst = float(np.max(off_by)) if self.source == OWN else np.nan
        least = float(np.nanmin(found.confirmed)) if np.isfinite(found.confirmed).any() else np.nan
        sure = not least < CONFIRMED and found.converged
        right = self.source == OWN and worst < WITHIN
        off = [f"{n} {e:.2g}" for n, e in zip(found.names, found.values - self.truth, strict=True)]
        finite = bool(np.isfinite(found.sigma).all())
        said = not sure or not finite
        how = ("right" if sure else "doubted") if right and finite else "not confirmed" if said else "WRONG"
        return Ended(how, worst, least, ", ".join(off))


@dataclass(frozen=True)
class Ended:
    """How a fit ended.

    Parameters
    ----------
    how : ``right`` (within ``WITHIN`` standard deviations, confirmed), ``WRONG`` (confirmed, and it is not right),
        ``doubted`` (right, and not confirmed), ``not confirmed`` (or without a finite standard deviation), ``refused``
    worst : largest error over the stated standard deviation
    confirmed : least of the values
    told : errors, or the reason of the refusal
    """

    how: str
    worst: float
    confirmed: float
    told: str


def combination(seed: int) -> FitDraw:
    """One to three kinds of parameters, looks, channels, mode, headings, priors and noise, all drawn."""
    rng = np.random.default_rng([seed, 0xF1])
    looks = int(rng.integers(1, 3))
    pool = (*SHAPES, *MATERIALS, *(RADAR if looks == 1 else ()))
    kinds = [str(kind) for kind in rng.choice(pool, int(rng.integers(1, 4)), replace=False)]
    by = "amplitude" if rng.uniform() < 0.2 else "complex"
    return _drawn(
        seed,
        rng,
        kinds,
        looks,
        by=by,
        snr_db=float(rng.choice([10.0, 20.0])),
        source=str(rng.choice([OWN, SPECKLE], p=[0.8, 0.2])) if by == "complex" else OWN,
        channels=str(rng.choice(CHANNELS)),
        mode=str(rng.choice(["spotlight", "stripmap"])),
        priors=bool(rng.uniform() < 0.4),
    )


def other_scene(seed: int) -> FitDraw:
    """A shape and perhaps amplitudes, to data of the same scene, of other scatterers or of another building."""
    rng = np.random.default_rng([seed, 0xF2])
    kinds = [str(rng.choice(SHAPES)), str(rng.choice(AMPLITUDES))]
    source, snr_db = str(rng.choice([OWN, SPECKLE, OTHER])), float(rng.choice([10.0, 20.0]))
    return _drawn(seed, rng, [kind for kind in kinds if kind], 1, snr_db=snr_db, source=source)


def form(seed: int) -> FitDraw:
    """A rotation or a scale, half of them beyond the reach of the search, perhaps with a shift."""
    rng = np.random.default_rng([seed, 0xF3])
    kinds = [str(rng.choice(["rotation:@", "scale:@"])), *(["shift:@:x"] if rng.uniform() < 0.3 else [])]
    return _drawn(seed, rng, kinds, 1, snr_db=float(rng.choice([10.0, 20.0])), source=OWN, wide=3.0)


def place(seed: int) -> FitDraw:
    """Height and place of a building from two looks, a metre off."""
    rng = np.random.default_rng([seed, 0xF4])
    return _drawn(seed, rng, ["height:@", "shift:@:x", "shift:@:y"], 2, snr_db=20.0, source=OWN)


def _drawn(
    seed: int,
    rng: np.random.Generator,
    kinds: Sequence[str],
    looks: int,
    *,
    by: str = "complex",
    snr_db: float,
    source: str,
    channels: str = "VV",
    mode: str = "spotlight",
    priors: bool = False,
    wide: float = 1.0,
) -> FitDraw:
    """Scenes of a building at drawn headings with errors of the start of up to ``wide`` times ``OFF``."""
    heights, first = rng.uniform(5.0, 12.0, 1), float(rng.uniform(0.0, 360.0))
    turns = (0.0, float(rng.uniform(40.0, 120.0)))
    angles = rng.uniform(30.0, 50.0, 2)
    scenes, data = [], []
    parameters, names, truth = "", tuple[str, ...](), np.zeros(0)
    for look in range(looks):
        radar: dict[str, Any] = {
            "heading_deg": (first + turns[look]) % 360.0,
            "look_angle_deg": float(angles[look]),
            "polarisation": channels,
            "mode": mode,
        }
        scene = town(seed, heights, 0, **radar)
        wall = next(m.name for m in scene.materials if m.name != "soil")
        parameters = ",".join(kind.replace("@", "building0").replace("*", wall) for kind in kinds)
        real = scene if source == OWN else town(seed + int(source == OTHER), heights, 0, 5, **radar)
        text = parameters.replace(wall, next(m.name for m in real.materials if m.name != "soil"))
        model = ForwardModel(real, parameters_of(text, real))
        if not len(truth):
            names = model.names
            scale = np.array([OFF[name.replace(":", " ").split(" ")[0]] for name in names])
            offsets = wide * rng.uniform(-1.0, 1.0, len(names)) * scale
            truth = model.start + offsets
        noise, temperature = noisy(model.raw(model.data(truth)), snr_db, 100 * seed + look)
        scenes.append(replace(scene, radar=replace(scene.radar, noise_temperature=temperature)))
        data.append(noise)
    known = {}
    if priors:
        known = {names[0]: Prior(float(truth[0] + scale[0] * rng.standard_normal()), float(scale[0]))}
    told = f"{looks} {channels.replace(',', '+') if len(channels) < 4 else 'quad'} {mode}"
    return FitDraw(seed, parameters, by, known, tuple(scenes), tuple(data), truth, source, snr_db, told)
