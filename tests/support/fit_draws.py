"""Fits drawn at random: parameters, looks, channels, modes, headings, priors and noise; and how they end."""

from __future__ import annotations

import warnings
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from sarmitsuba import Fit, Prior, RawData, Scene, fit
from sarmitsuba.apps.fit.confirmation import CONFIRMED
from sarmitsuba.apps.fit.forward_model import ForwardModel
from sarmitsuba.apps.fit.jacobian import parameters_of
from sarmitsuba.core.arrays import F64
from sarmitsuba.core.constants import SPEED_OF_LIGHT
from sarmitsuba.core.errors import SarmitsubaError, SarmitsubaWarning
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
# the model's scatterers under another radar than the scene's, or beside a building that one of the two lacks
LOOK, MISSING, EXTRA = "look", "missing", "extra"
# of which the true values are known
KNOWN = (OWN, LOOK, MISSING, EXTRA)
# centre frequency and bandwidth, Hz, from VHF to Ka band
BANDS = {
    "VHF": (150e6, 50e6),
    "P": (435e6, 100e6),
    "L": (1.3e9, 150e6),
    "C": (5.4e9, 200e6),
    "X": (9.65e9, 200e6),
    "Ku": (17e9, 300e6),
    "Ka": (35e9, 300e6),
}
# ray spacing for flat walls from VHF to Ka band, m: a tube is a phase integral over its facet
RAYS = 0.3
# what carries the radar
PLATFORMS: dict[str, dict[str, Any]] = {
    "orbit": {"slant_range": None, "look_angle_deg": None, "heading_deg": None, "orbit_altitude": 600e3},
    "air": {"slant_range": 5000.0},
    "drone": {"slant_range": 400.0, "speed": 10.0},
    "bistatic": {"slant_range": 5000.0, "receiver_offset_across": 300.0},
}
OUTSIDE = (
    "shift:@:x",
    "shift:@:y",
    "shift:@:x,shift:@:y",
    "shift:@:z",
    "height:@",
    "rotation:@",
    "levels",
    "level:soil",
    "level:*",
    "permittivity:soil",
    "gain",
    "track:1:z",
    "track:2:x",
    "clock_offset",
)


@dataclass(frozen=True, eq=False)
class FitDraw:
    """A drawn fit.

    Parameters
    ----------
    seed : of the draw
    parameters, by, priors : of the fit
    scenes, data : of every look; scenes with wrong values
    truth : (n,) values of the data
    source : of the data, one of ``KNOWN``, ``SPECKLE`` or ``OTHER``
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
            with warnings.catch_warnings():
                warnings.filterwarnings("ignore", ".*radars of scene and raw data differ", SarmitsubaWarning)
                found: Fit = fit(self.scenes, self.data, self.parameters, by=self.by, priors=self.priors)
        except SarmitsubaError as error:
            return Ended("refused", np.nan, np.nan, str(error))
        off_by = np.abs(found.values - self.truth) / found.sigma
        worst = float(np.max(off_by)) if self.source in KNOWN else np.nan
        least = float(np.nanmin(found.confirmed)) if np.isfinite(found.confirmed).any() else np.nan
        sure = not least < CONFIRMED and found.converged
        right = self.source in KNOWN and worst < WITHIN
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


def outside(seed: int) -> FitDraw:
    """Bands, platforms and noise outside of what fits were made for, and models with a building more or less."""
    rng = np.random.default_rng([seed, 0xF5])
    band, platform = str(rng.choice(list(BANDS))), str(rng.choice(list(PLATFORMS), p=[0.3, 0.4, 0.25, 0.05]))
    source = str(rng.choice(KNOWN, p=[0.55, 0.15, 0.15, 0.15]))
    parameters, snr_db = str(rng.choice(OUTSIDE)), float(rng.uniform(0.0, 30.0))
    frequency, bandwidth = BANDS[band]
    angle = float(rng.uniform(28.0, 45.0))
    radar: dict[str, Any] = {
        "center_frequency": frequency,
        "bandwidth": bandwidth,
        "azimuth_resolution": max(1.0, SPEED_OF_LIGHT / frequency),
        "look_angle_deg": angle,
        "heading_deg": float(rng.uniform(0.0, 360.0)),
        **PLATFORMS[platform],
    }
    if platform == "orbit":
        radar["incidence_angle_deg"] = angle
    told = dict(radar)
    if source == LOOK:
        told["incidence_angle_deg" if platform == "orbit" else "look_angle_deg"] = angle + 8.0
    heights = rng.uniform(5.0, 10.0, 2)
    rest = {MISSING: (("building1",), ()), EXTRA: ((), ("building1",))}
    lacks, real_lacks = rest.get(source, ((), ()))
    scene = town(seed, heights, 0, left_out=lacks, ray_spacing=RAYS, **told)
    real = town(seed, heights, 0, left_out=real_lacks, ray_spacing=RAYS, **radar)
    wall = next(m.name for m in scene.materials if m.name != "soil")
    parameters = parameters.replace("@", "building0").replace("*", wall)
    model = ForwardModel(real, parameters_of(parameters, real))
    scale = np.array([OFF[name.replace(":", " ").split(" ")[0]] for name in model.names])
    truth = model.start + rng.uniform(-1.0, 1.0, len(scale)) * scale
    data, temperature = noisy(model.raw(model.data(truth)), snr_db, seed)
    scene = replace(scene, radar=replace(scene.radar, noise_temperature=temperature))
    return FitDraw(
        seed, parameters, "complex", {}, (scene,), (data,), truth, source, snr_db, f"{band} {platform}"
    )


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
        raw = model.raw(model.data(truth))
        # real data have no record of their scatterers
        raw = raw if source == OWN else replace(raw, metadata={})
        noise, temperature = noisy(raw, snr_db, 100 * seed + look)
        scenes.append(replace(scene, radar=replace(scene.radar, noise_temperature=temperature)))
        data.append(noise)
    known = {}
    if priors:
        known = {names[0]: Prior(float(truth[0] + scale[0] * rng.standard_normal()), float(scale[0]))}
    told = f"{looks} {channels.replace(',', '+') if len(channels) < 4 else 'quad'} {mode}"
    return FitDraw(seed, parameters, by, known, tuple(scenes), tuple(data), truth, source, snr_db, told)
