"""Statements over scenes and radars drawn far wider than the laws were fitted on, and their truth.

Frequencies from 30 MHz to 240 GHz, ranges from 1 m to 900 km, 1 to 10 pulses a wavelength where that is affordable,
platforms of 1 to 10 000 m/s, separate receivers. Boxes, courts and plates on ground, smooth or rough, of metal and
dielectrics, as small as the truth needs: a few thousand rays a pulse.
"""

import math
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np

from benchmarks.support import harness
from benchmarks.support.denser_runs import DENSER, converged
from benchmarks.support.stated_row import Row
from sarmitsuba.analysis.error_budget import error_budget
from sarmitsuba.core.constants import SPEED_OF_LIGHT
from sarmitsuba.loading.load import load_scene
from sarmitsuba.scene.scene import Scene
from sarmitsuba.signal.image import SarImage
from sarmitsuba.signal.metrics import image_error_db
from sarmitsuba.simulation.execution.error_bars import add_error_bars
from sarmitsuba.simulation.execution.render import simulate
from sarmitsuba.simulation.execution.run import Run
from tests.support.unweighted import focus

FREQUENCIES, RANGES, SPEEDS = (30e6, 240e9), (1.0, 900e3), (1.0, 1e4)
# pulses of a track that is sampled by the wavelength, and of any
MOST_DENSE, MOST_PULSES = 240, 480
# image extent in resolution cells
CELLS = (10.0, 18.0)
# bounces of the truth beyond those of the run
DEEPER = 6


def draw(seed: int) -> tuple[Scene, str]:
    """A scene small enough for its truth, and what was drawn."""
    rng = np.random.default_rng([seed, 0x3E1D])

    def between(low: float, high: float) -> float:
        return float(np.exp(rng.uniform(np.log(low), np.log(high))))

    frequency = between(*FREQUENCIES)
    wavelength = SPEED_OF_LIGHT / frequency
    # the ground is seen from outside: an image of CELLS cells is a third of the range at most
    far = between(max(RANGES[0], 100.0 * wavelength), RANGES[1])
    cells = rng.uniform(*CELLS)
    finest = 1.2 * wavelength
    per_wavelength, dense = between(1.0, 10.0), True
    least = max(finest, far * per_wavelength / (2.0 * MOST_DENSE))
    cell = between(least, max(1.1 * least, far / 80.0))
    if cell > 300.0 * wavelength:  # as from orbit: pulses as rare as the aperture allows
        dense, least = False, max(finest, math.sqrt(0.7 * far * wavelength / MOST_PULSES))
        cell = between(least, max(1.1 * least, min(300.0 * wavelength, far / 80.0)))
    speed = between(*SPEEDS)
    parameters: dict[str, object] = {
        "center_frequency": frequency,
        "bandwidth": min(0.886 * SPEED_OF_LIGHT / (2.0 * cell), 0.5 * frequency),
        "azimuth_resolution": cell,
        "slant_range": far,
        "look_angle_deg": rng.uniform(25.0, 65.0),
        "heading_deg": rng.uniform(0.0, 360.0),
        "speed": speed,
        "mode": str(rng.choice(("spotlight", "stripmap"))),
        "polarisation": str(rng.choice(("VV", "HH"))),
        **({"prf": per_wavelength * speed / wavelength} if dense else {}),
    }
    if rng.random() < 0.2:
        parameters["receiver_offset_along"] = 0.1 * far * rng.uniform(-1.0, 1.0)
        parameters["receiver_offset_across"] = 0.1 * far * rng.uniform(-1.0, 1.0)
    if rng.random() < 0.2:
        parameters["squint_angle_deg"] = rng.uniform(-15.0, 15.0)
    text = _scene_text(parameters, cells * cell, cell, wavelength, rng)
    with TemporaryDirectory() as folder:
        path = Path(folder) / "wide.xml"
        path.write_text(text, encoding="utf-8")
        scene = load_scene(path)
    apart = " bistatic" if "receiver_offset_along" in parameters else ""
    sampled = f"{per_wavelength:.1f} a wavelength" if dense else "automatic prf"
    case = (
        f"{frequency / 1e9:.3g} GHz {far:.3g} m {parameters['mode']} {scene.radar.track.n_pulses} pulses, {sampled}, "
        f"{speed:.3g} m/s, cell {cell / wavelength:.3g} wavelengths{apart}"
    )
    return scene, case


def _scene_text(
    parameters: dict[str, object], extent: float, cell: float, wavelength: float, rng: np.random.Generator
) -> str:
    def entry(name: str, value: object) -> str:
        kind = "string" if isinstance(value, str) else "float"
        return f'<{kind} name="{name}" value="{value}"/>'

    def material(name: str) -> str:
        what = (
            entry("material", "pec")
            if rng.random() < 0.3
            else entry("permittivity_real", rng.uniform(2.5, 12.0))
        )
        rms = wavelength * rng.choice((0.0, 0.02, 0.1, 1.0))
        rough = entry("diffuse_law", "constant_gamma") + entry("diffuse_level_db", rng.uniform(-25.0, -5.0))
        return f'<bsdf type="radar_material" id="{name}">{what}{entry("rms_height", rms)}{rough if rms else ""}</bsdf>'

    heading = float(str(parameters["heading_deg"]))
    shapes = []
    for _ in range(int(rng.integers(1, 5))):
        x, y, z = cell * np.exp(rng.uniform(np.log(1.0), np.log(8.0), 3))
        if rng.random() < 0.3:
            x = 0.02 * cell  # a wall
        # walls often face the radar, and each other
        turn = -heading + rng.choice((0.0, 90.0, rng.uniform(0.0, 90.0))) + rng.uniform(-6.0, 6.0)
        at = 0.3 * extent * rng.uniform(-1.0, 1.0, 2)
        size = f'<scale x="{x / 2}" y="{y / 2}" z="{z / 2}"/>'
        place = f'<rotate z="1" angle="{turn}"/><translate x="{at[0]}" y="{at[1]}" z="{z / 2}"/>'
        shapes.append(
            f'<shape type="cube"><transform name="to_world">{size}{place}</transform><ref id="wall"/></shape>'
        )
    given = "".join(entry(name, value) for name, value in parameters.items())
    aim = "".join(entry(f"aim_{axis}", 0.0) for axis in "xyz")
    film = entry("image_extent_azimuth", extent) + entry("image_extent_range", extent)
    ground = f'<transform name="to_world"><scale x="{extent}" y="{extent}"/></transform><ref id="ground"/>'
    return (
        f'<scene version="3.0.0"><integrator type="sar_path"/><sensor type="sar_antenna">{given}{aim}'
        f'<film type="range_film">{film}</film></sensor>{material("ground")}{material("wall")}'
        f'<shape type="rectangle">{ground}</shape>{"".join(shapes)}</scene>'
    )


def _row(image: SarImage, name: str, seed: int, case: str, true: float) -> Row:
    """A statement: the level that the error stays below with 95 %, where that is stated, else its level."""
    part = next(part for part in error_budget(add_error_bars(image)) if part.name == name)
    stated = part.error_db if math.isnan(part.upper_db) else part.upper_db
    return Row("wide", f"{name}, {part.known}", seed, case, stated, true, note=part.why)


def _image(scene: Scene) -> SarImage:
    return focus(simulate(scene))


def wide(seed: int) -> Iterator[Row]:
    """Blocks, bounces and gridding of one drawn scene, each against a run that is exact in that respect alone."""
    scene, case = draw(seed)
    # without the effects that are stated on their own
    scene = scene.replace(diffuse_pairs="off", wideband="off")
    depth = int(np.random.default_rng([seed, 1]).choice((0, 0, 1, 2)))
    scene = harness.with_settings(scene, keep_subsets=True, max_depth=depth)
    raw = simulate(scene)
    if not raw.metadata["sampling"]:  # nothing was traced
        return
    # spacings that are given: a run of its own may halve automatic ones
    scene = harness.with_settings(scene, **raw.metadata["ray_spacing_settings"])
    raw = simulate(scene)
    sampling = raw.metadata["sampling"]
    image = focus(raw)
    fixed = harness.with_settings(scene, key_pulse_interval=sampling["key_pulse_interval"])
    total = image.total()

    def error(other: Scene) -> float:
        return image_error_db(total, focus(simulate(other), image.grid).total())

    if sampling["key_pulse_interval"] > 1:
        yield _row(image, "blocks of pulses", seed, case, error(harness.with_settings(scene, method="raw")))
    deeper = int(raw.metadata["effects"]["max_depth"]) + DEEPER
    yield _row(
        image,
        "bounces left out",
        seed,
        f"depth {depth} {case}",
        error(harness.with_settings(fixed, max_depth=deeper)),
    )
    yield _row(image, "gridding", seed, case, error(harness.with_settings(fixed, gridding_width=8)))


def wide_rays(seed: int) -> Iterator[Row]:
    """Two sets of rays of a drawn scene against runs of dense rays; see ``wide``."""
    scene, case = draw(seed)
    scene = harness.with_settings(scene.replace(diffuse_pairs="off", wideband="off"), keep_subsets=True)
    raw = simulate(scene)
    if not raw.metadata["sampling"]:
        return
    image = focus(raw)
    fixed = harness.with_settings(scene, key_pulse_interval=raw.metadata["sampling"]["key_pulse_interval"])
    truth = converged(Run(fixed).at(2.0 ** (-0.5 * DENSER)), image.grid)
    yield _row(image, "rays", seed, case, image_error_db(image.total(), truth))


def wide_effects(seed: int) -> Iterator[Row]:
    """Effects that are off in a drawn scene, against a run with all of them on."""
    scene, case = draw(seed)
    raw = simulate(scene)
    if not raw.metadata["sampling"]:
        return
    off = {
        name: "on"
        for name, decision in raw.metadata["effects"]["effects"].items()
        if not decision["on"]
        and decision["error_is"] != "none"
        and name not in ("max_depth", "key_pulse_interval")
    }
    image = focus(raw)
    fixed = harness.with_settings(scene, key_pulse_interval=raw.metadata["sampling"]["key_pulse_interval"])
    on = replace(fixed, settings=replace(fixed.settings, effects={**fixed.settings.effects, **off}))
    true = image_error_db(image.total(), focus(simulate(on), image.grid).total())
    yield _row(image, "effects left out", seed, f"{', '.join(off)} {case}", true)
