"""Processor time and peak memory of one run, of its derivatives or of its fit, in a process of its own.

``benchmarks/suite/gradients.py`` starts it, with the folders of this package and of the studies on the search path and
with the names of a case and of a kind of job; it prints JSON. Every job runs once to compile, then is timed.
"""

import json
import sys
import time
import warnings
from collections.abc import Callable

import numpy as np

from benchmarks.support import munich_materials_drawn as munich_materials
from sarmitsuba import Prior, RawData, Scene, fit
from sarmitsuba.apps.fit.forward_model import ForwardModel
from sarmitsuba.apps.fit.parsing import parse
from sarmitsuba.machine.memory import peak_memory
from tests.support.fits import fields, noisy
from tests.support.tracks import targets, track_case

SEED, SNR_DB = 210, 20.0
Job = tuple[Scene, str, Callable[[], RawData], dict[str, Prior]]


def levels() -> Job:
    """Five levels that are off by up to 3 dB."""
    scene = fields(SEED, 4, 32)
    offsets = np.random.default_rng(SEED).uniform(-3.0, 3.0, 5)

    def data() -> RawData:
        model = ForwardModel(scene, parse("levels", scene))
        return noisy(model.raw(model.data(model.start + offsets)), SNR_DB, SEED)[0]

    return scene, "levels", data, {}


def track() -> Job:
    """A track of four knots that are off by up to two wavelengths, over fields."""
    scene = fields(SEED, 1, 48)
    return scene, "track:4", lambda: track_case(scene, 4, 2.0, SEED, 30.0).raw, {}


def corners() -> Job:
    """The same over eight trihedrals."""
    scene = targets(SEED, extent=20.0, bandwidth=300e6, azimuth_resolution=0.4, pulses=160, level_db=-60.0)
    return scene, "track:4", lambda: track_case(scene, 4, 2.0, SEED, 30.0).raw, {}


def munich() -> Job:
    """Levels, permittivities and rms heights of seven materials of Munich."""
    scene = munich_materials.drawn(SEED, munich_materials.SMALL)
    if scene is None:
        raise SystemExit("sionna-rt, which carries Munich, is not installed")
    start, truth, priors = munich_materials.started(scene, SEED)
    text = munich_materials.parameters_of(scene)

    def data() -> RawData:
        model = ForwardModel(start, parse(text, start))
        return noisy(model.raw(model.data(truth)), SNR_DB, SEED)[0]

    return start, text, data, priors


CASES: dict[str, Callable[[], Job]] = {
    "fields, 5 levels": levels,
    "fields, track of 4 knots": track,
    "trihedrals, track of 4 knots": corners,
    "Munich, 18 values of 7 materials": munich,
}
KINDS = ("plain", "jacobian", "fit")


def measure(case: str, kind: str) -> dict[str, float]:
    """Seconds, bytes, number of values, and steps of a fit."""
    scene, text, data, priors = CASES[case]()
    steps = 0.0
    model = ForwardModel(scene, parse(text, scene))
    if kind == "fit":
        raw = data()

        def job() -> None:
            nonlocal steps
            steps = float(len(fit(scene, raw, text, priors=priors).costs) - 1)
    else:
        job = model.data if kind == "plain" else model.derivative  # type: ignore[assignment]
    job()
    start = time.process_time()
    job()
    return {
        "cpu_s": time.process_time() - start,
        "peak_bytes": float(peak_memory()),
        "values": float(len(model.names)),
        "data": float(np.prod(model.shape)),
        "steps": steps,
    }


if __name__ == "__main__":
    warnings.simplefilter("ignore")
    print(json.dumps(measure(sys.argv[1], sys.argv[2])))
