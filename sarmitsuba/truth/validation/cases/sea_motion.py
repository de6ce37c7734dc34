"""Water that moves: its coherence over the aperture, and where and how wide an image shows it."""

from dataclasses import dataclass, replace

import numpy as np

from sarmitsuba.core.constants import SPEED_OF_LIGHT
from sarmitsuba.scene.materials.material import Material
from sarmitsuba.scene.materials.named.water import klein_swift
from sarmitsuba.scene.scene import Scene
from sarmitsuba.scene.settings import Method, Switch, TraceSettings
from sarmitsuba.simulation.execution.render import simulate
from sarmitsuba.truth.theory import sea as theory
from sarmitsuba.truth.validation import targets
from sarmitsuba.truth.validation.cases import CASES, CaseEntry
from sarmitsuba.truth.validation.cases.sea import ALL_IN_LAW
from sarmitsuba.truth.validation.chain import Parameter, bandwidth, chain, make_scene, suppress_warnings
from sarmitsuba.truth.validation.comparison import Case, Comparison

RANGE, SPEED, FREQUENCY, LOOK = 3e3, 150.0, 9.65e9, 40.0
WAVELENGTH = SPEED_OF_LIGHT / FREQUENCY
# m: range cell of raw data, in which the more cells the better; azimuth cell of an aperture somewhat longer than the
# water stays coherent; and of images
CELL, SHORT, COARSE = 0.5, 2.5, 1.0
# m along the track: narrow, so that its own width does not hide the smear
WIDTH = 4.0
# what ripples of a centimetre leave of the mirror returns nothing at these angles
DIFFUSE: dict[str, Switch] = {"coherent": "off"}


@dataclass(frozen=True)
class Drawn:
    """A flight past a strip of water across the track, and its wind, drawn at random.

    Parameters
    ----------
    heading, bearing : deg, of the flight and of where the wind comes from, clockwise from north
    side : ``left`` or ``right``
    wind, fetch : m/s and m
    drawn : m, waves longer than that are drawn one by one
    """

    heading: float
    bearing: float
    side: str
    wind: float
    fetch: float
    drawn: float = ALL_IN_LAW

    @staticmethod
    def by(rng: np.random.Generator, fetch: tuple[float, float]) -> "Drawn":
        """Any directions, winds of 4 to 9 m/s, a fetch between two bounds, m."""
        return Drawn(
            float(rng.uniform(0.0, 360.0)),
            float(rng.uniform(0.0, 360.0)),
            str(rng.choice(["left", "right"])),
            float(rng.uniform(4.0, 9.0)),
            float(rng.uniform(*fetch)),
        )

    def scene(
        self, length: float, cells: tuple[float, float], image: float, method: Method = "hybrid"
    ) -> Scene:
        """The strip, ``length`` m across the track, in an image of ``image`` m along it; ``cells``: azimuth, range."""
        parameters: dict[str, Parameter] = {
            "slant_range": RANGE,
            "look_angle_deg": LOOK,
            "heading_deg": self.heading,
            "look_side": self.side,
            "speed": SPEED,
            "center_frequency": FREQUENCY,
            "azimuth_resolution": cells[0],
            "bandwidth": bandwidth(cells[1]),
            "prf": 600.0,
            "image_extent_azimuth": image,
            "image_extent_range": length,
        }
        heading = np.radians(self.heading)
        along = np.array([np.sin(heading), np.cos(heading), 0.0])
        across = np.array([along[1], -along[0], 0.0])
        strip = targets.parallelogram(
            -0.5 * (WIDTH * along + length * across), length * across, WIDTH * along
        )
        settings = TraceSettings(method=method, max_depth=1, effects=DIFFUSE)
        return make_scene(targets.geometry([strip]), (self.material,), parameters, settings=settings)

    @property
    def material(self) -> Material:
        """The water."""
        law = {
            "wind_speed": self.wind,
            "wind_direction_deg": self.bearing,
            "fetch": self.fetch,
            "shortest_drawn_wave": self.drawn,
        }
        return Material(
            "water",
            permittivity=klein_swift(FREQUENCY, 15.0, 0.0),
            diffuse_law="sea",
            law_parameters=tuple(law.items()),
        )

    def expected(self) -> tuple[float, float, float]:
        """Deviation of the range speed (m/s), Bragg frequency (rad/s) and share that comes to the radar, in theory."""
        toward = np.radians(self.heading + (90.0 if self.side == "left" else -90.0))
        downwind = np.radians(self.bearing + 180.0)
        azimuth = float(toward - downwind)
        start = 9.81 / self.wind**2
        age = min(0.84 * float(np.tanh((start * self.fetch / 2.2e4) ** 0.4)) ** -0.75, 5.0)
        low = 0.1 * start * age**2
        speeds = theory.band_integral(self.wind, low, 7400.0, 2.0, 2.0, age)
        incidence = np.radians(LOOK)
        wave = 4.0 * np.pi / WAVELENGTH * np.sin(incidence)
        return (
            float(theory.speed_deviation(*speeds, incidence, azimuth)),
            float(wave * theory.phase_speed(wave)),
            float(theory.approaching_share(azimuth)),
        )


def frozen(scene: Scene) -> Scene:
    """The same water at rest."""
    return replace(scene, settings=replace(scene.settings, effects=DIFFUSE | {"water_motion": "off"}))


def coherence(quick: bool = False) -> Case:
    """Correlation of raw data of moving water with those of the same water at rest, over the time from mid-aperture."""
    rng = np.random.default_rng(23)
    length, seeds = (200.0, 1) if quick else (600.0, 4)
    runs: tuple[Method, ...] = ("hybrid", "raw")
    comparisons = []
    for number in range(1 if quick else 3):
        drawn = Drawn.by(rng, (100.0, 400.0))
        deviation, bragg, share = drawn.expected()
        last = 1.5 * theory.coherence_time(WAVELENGTH, deviation)
        for method in runs:
            scene = drawn.scene(length, (SHORT, CELL), 8.0, method)
            time = scene.radar.track.time
            pick = np.flatnonzero(np.abs(time) <= last)
            pick = pick[np.unique(np.linspace(0, pick.size - 1, 21).round().astype(int))]
            product, energy = np.zeros(pick.size, dtype=np.complex128), np.zeros((2, pick.size))
            for seed in range(seeds):
                with suppress_warnings():
                    rest, moving = (
                        simulate(s, seed=seed).data[0][pick].astype(np.complex128)
                        for s in (frozen(scene), scene)
                    )
                product += np.sum(moving * np.conj(rest), axis=1)
                energy += [np.sum(np.abs(part) ** 2, axis=1) for part in (rest, moving)]
            got = product / np.sqrt(energy[0] * energy[1])
            want = theory.coherence(time[pick], WAVELENGTH, deviation, bragg, share)
            cells = seeds * length * np.sin(np.radians(LOOK)) / CELL
            sigma = float(np.sqrt(0.5 / cells))
            for name, part in (("real", np.real), ("imaginary", np.imag)):
                comparisons.append(
                    Comparison(
                        f"{method}, {name} part, wind {drawn.wind:.1f} m/s, flight {number + 1}",
                        1e3 * time[pick],
                        part(want),
                        part(got),
                        tolerance=4.5 * sigma,
                        reason=f"4.5 standard errors of {sigma:.3f}: {cells:.0f} range cells",
                        unit="",
                        shown=int(np.argmin(np.abs(time[pick] - last / 3.0))),
                    )
                )
    return Case(
        name="sea_coherence",
        topic="rough",
        title="Coherence of moving water over the aperture",
        formula="exp(-2 (k sigma_v t)^2) (p exp(j W t) + (1 - p) exp(-j W t)), W = Bragg frequency, p = its share",
        source="characteristic function of Gaussian velocities; sigma_v by an integral of the spectrum",
        x_label="time from mid-aperture (ms)",
        y_label="correlation with the water at rest",
        comparisons=tuple(comparisons),
        note=f"{WIDTH:g} m x {length:g} m of water in raw data of X band, {RANGE / 1e3:g} km, {SPEED:g} m/s; headings, "
        "sides, winds and fetches of 100 to 400 m drawn; key pulses and every pulse traced.",
    )


def spread(quick: bool = False) -> Case:
    """Mean displacement and width along the track of a narrow strip of water in the focused image."""
    rng = np.random.default_rng(29)
    count, length = (2, 150.0) if quick else (8, 600.0)
    shifts, widths = np.zeros((2, count)), np.zeros((2, count))
    for i in range(count):
        drawn = Drawn.by(rng, (300.0, 3000.0))
        deviation, bragg, share = drawn.expected()
        scene = drawn.scene(length, (COARSE, COARSE), 60.0)
        moments = []
        for each in (frozen(scene), scene):
            image = chain(each, window="taylor:4:-35")
            grid = image.grid
            place = (grid.positions()[:, grid.shape[1] // 2] - np.zeros(3)) @ scene.radar.track.along
            power = np.sum(np.abs(image.total()) ** 2, axis=1)
            mean = float(place @ power / power.sum())
            moments.append((mean, float((place - mean) ** 2 @ power / power.sum())))
        (mean_rest, variance_rest), (mean, variance) = moments
        bragg_speed = bragg * WAVELENGTH / (4.0 * np.pi)
        shifts[:, i] = (RANGE / SPEED * (2.0 * share - 1.0) * bragg_speed, mean - mean_rest)
        both = deviation**2 + 4.0 * share * (1.0 - share) * bragg_speed**2
        widths[:, i] = (
            theory.azimuth_spread(RANGE, float(np.sqrt(both)), SPEED),
            np.sqrt(max(variance - variance_rest, 0.0)),
        )
    # strip and response, and what they leave of independent looks
    looks = length * np.sin(np.radians(LOOK)) / COARSE * 0.5 * (WIDTH + float(widths[0].min())) / COARSE
    sigma = float(widths[0].max()) / np.sqrt(looks)
    order = np.argsort(shifts[0])
    return Case(
        name="sea_image",
        topic="rough",
        title="Displacement and smear of moving water in the image",
        formula="mean R v / V by the Bragg waves, deviation R sigma_v / V",
        source="Raney, IEEE Trans. AES 7 (1971), for every scatterer",
        x_label="flight",
        y_label="along the track (m)",
        comparisons=tuple(
            Comparison(
                label,
                np.arange(1.0, count + 1.0),
                values[0][order],
                values[1][order],
                tolerance=4.0 * sigma,
                reason=f"4 standard errors of {sigma:.2f} m: some {looks:.0f} looks",
                unit="m",
                shown=count - 1,
            )
            for label, values in (("mean displacement", shifts), ("deviation", widths))
        ),
        note=f"{WIDTH:g} m x {length:g} m of water, against the same at rest; X band, {RANGE / 1e3:g} km, {SPEED:g} "
        "m/s; headings, sides, winds and fetches of 0.3 to 3 km drawn.",
    )


CASES.register(CaseEntry("sea_coherence", "rough", coherence))
CASES.register(CaseEntry("sea_image", "rough", spread))
