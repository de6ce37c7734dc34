"""Link budgets of the shipped radars: predicted noise and signal against the focused noise of an empty scene."""

import numpy as np

from sarmitsuba.analysis.link_budget import LinkBudget, link_budget
from sarmitsuba.core.units import db_from_power
from sarmitsuba.loading.library import list_radars
from sarmitsuba.loading.load import load_scene
from sarmitsuba.scene.scene import Scene
from sarmitsuba.signal.focusing import default_grid
from sarmitsuba.truth import theory
from sarmitsuba.truth.validation.cases import CASES, CaseEntry
from sarmitsuba.truth.validation.chain import suppress_warnings
from sarmitsuba.truth.validation.comparison import Case, Comparison
from sarmitsuba.truth.validation.measured_noise import empty_echoes, focused_noise, focused_peak

# off the beam's centre in elevation, in sines over the first null's: the two-way gain is 3.6 dB down
_OFF = 0.35
_DRAWS = 4
# of radars that have none, K
_TEMPERATURE = 580.0


def preset_scene(name: str, off: bool) -> Scene:
    """A point seen by a shipped radar, which aims beyond it where ``off`` is true."""
    changes: dict[str, str] = {}
    scene = load_scene("point", radar=name)
    if scene.radar.noise_temperature <= 0.0:
        changes["sar_antenna.noise_temperature"] = str(_TEMPERATURE)
    if off and scene.radar.antenna.directive:
        line = scene.radar.aim_point - scene.radar.track.center_position
        # the ground across the line of sight is its distance over the cosine of the incidence angle
        beyond = _OFF * scene.radar.antenna.nulls[1] * float(line @ line) / -line[2]
        aim = scene.radar.aim_point + scene.offset + beyond * scene.radar.across
        changes |= {"aim_x": str(aim[0]), "aim_y": str(aim[1]), "aim_z": str(aim[2])}
        changes |= {"range_film.image_center_x": "0", "range_film.image_center_y": "0"}
        changes |= {
            "range_film.image_extent_azimuth": str(scene.image.extent_azimuth),
            "range_film.image_extent_range": str(scene.image.extent_range),
        }
    return load_scene("point", radar=name, parameters=changes) if changes else scene


def measure_noise(scene: Scene, window: str, draws: int) -> tuple[float, float]:
    """NESZ and SNR of a point of 1 m^2 in the middle of the image, linear."""
    grid = default_grid(scene.radar, scene.image)
    found = np.array([focused_noise(empty_echoes(scene.radar, seed), grid, window) for seed in range(draws)])
    power, sigma0 = found.mean(axis=0)
    peak = focused_peak(scene.radar, grid, grid.azimuth.size // 2, grid.range.size // 2, window)
    return float(sigma0), peak / float(power)


def link(quick: bool = False) -> Case:
    """NESZ and SNR of every shipped radar, in the beam's centre and off it."""
    names = [entry.name for entry in list_radars()][:: 3 if quick else 1]
    draws = 1 if quick else _DRAWS
    predicted, found, closed, own = [], [], [], []
    with suppress_warnings():  # of squares of a few cells
        for name in names:
            scene = preset_scene(name, off=True)
            middle = link_budget(scene).middle
            predicted.append((middle.nesz, middle.snr))
            found.append(measure_noise(scene, "taylor", draws))
            centre = preset_scene(name, off=False)
            plain = link_budget(centre, range_window="rectangular", azimuth_window="rectangular")
            # the form is that of a beam at rest; bursts: tests/radar/test_bursts.py
            if scene.radar.burst is None:
                own.append(plain.middle.nesz)
                closed.append(closed_form(centre, plain))
    x = np.arange(float(len(names)))
    noise = "mean of speckle over some 1000 cells, four to sixteen times: a sigma of 0.1 dB and less"
    comparisons = [
        Comparison(
            f"{what} in the image, Taylor windows",
            x,
            db_from_power([pair[k] for pair in predicted]),
            db_from_power([pair[k] for pair in found]),
            tolerance=0.3,
            reason=noise,
            unit="dB",
            shown=len(names) - 1,
        )
        for k, what in enumerate(("NESZ", "SNR of 1 m^2"))
    ]
    comparisons.append(
        Comparison(
            "NESZ of the budget, no windows, beam's centre",
            np.arange(float(len(own))),
            db_from_power(closed),
            db_from_power(own),
            tolerance=0.1,
            reason="curved orbits, R^4 over the aperture; whole pulses",
            unit="dB",
            shown=len(own) - 1,
        )
    )
    return Case(
        name="link",
        topic="radiometry",
        title="Noise-equivalent sigma0 and signal-to-noise ratio of every shipped radar",
        formula="2 (4 pi)^3 R^3 v k T L / (P_av G^2 lambda^3 delta_gr), times <g^2> / <g^4> over the aperture",
        source="Curlander and McDonough, Synthetic Aperture Radar (1991), ch. 2",
        x_label=", ".join(f"{i} {name}" for i, name in enumerate(names)),
        y_label="dB",
        comparisons=tuple(comparisons),
        note="Images: noise of an empty scene focused by backprojection, and one point; predicted by `sarmitsuba "
        "link`, which sums pattern and windows over the pulses; aimed beyond the point, 3.6 dB down in elevation. "
        f"Idealised radars are given {_TEMPERATURE:g} K.",
    )


def closed_form(scene: Scene, budget: LinkBudget) -> float:
    """NESZ at the beam's centre without windows, from average power and the closed form of the beam's taper."""
    radar = scene.radar
    middle = budget.middle
    ground = radar.waveform.range_cell / float(np.sin(middle.incidence_angle))
    plain = theory.nesz_of_average_power(
        budget.timing.average_power,
        budget.gain,
        budget.wavelength,
        middle.slant_range,
        ground,
        budget.speed,
        radar.noise_temperature,
        budget.losses,
    )
    if not np.isfinite(radar.half_aperture):
        return plain
    null = budget.wavelength / scene.description.sensor.antenna_length if scene.description else np.inf
    return plain * theory.uniform_aperture_taper(null, radar.half_aperture)[1]


CASES.register(CaseEntry("link", "radiometry", link))
