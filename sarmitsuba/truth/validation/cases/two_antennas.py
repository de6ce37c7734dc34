"""Bistatic radar: phase of a point over the baseline, a plate over the bistatic angle."""

from dataclasses import replace

import numpy as np

from sarmitsuba.core.arrays import F64
from sarmitsuba.core.constants import SPEED_OF_LIGHT
from sarmitsuba.core.units import db_from_power
from sarmitsuba.scene.geometry import PointTarget
from sarmitsuba.scene.scene import Scene
from sarmitsuba.scene.settings import TraceSettings
from sarmitsuba.simulation.execution.render import simulate
from sarmitsuba.truth import theory
from sarmitsuba.truth.validation import targets
from sarmitsuba.truth.validation.cases import CASES, CaseEntry
from sarmitsuba.truth.validation.chain import Parameter, bandwidth, make_scene, suppress_warnings
from sarmitsuba.truth.validation.comparison import Case, Comparison

FREQUENCY, CELL = 9.65e9, 1.0
WAVELENGTH = SPEED_OF_LIGHT / FREQUENCY


def _parameters(baseline: F64, **changes: Parameter) -> dict[str, Parameter]:
    """Parameters of a short flight with a baseline along, across and up."""
    names = ("receiver_offset_along", "receiver_offset_across", "receiver_offset_up")
    parameters: dict[str, Parameter] = {
        "center_frequency": FREQUENCY,
        "bandwidth": bandwidth(CELL),
        "azimuth_resolution": CELL,
        "n_pulses": 3,
        "image_extent_azimuth": 24.0,
        "image_extent_range": 24.0,
        **{name: float(b) for name, b in zip(names, baseline, strict=True)},
    }
    return parameters | changes


def _echo(scene: Scene, receiver: F64, channel: str | None = None) -> complex:
    """Echo of the target at the origin in the middle pulse, relative to the radar equation for 1 m^2."""
    radar, raw = scene.radar, simulate(scene)
    pulse, origin = radar.track.center_index, scene.points[0].position if scene.points else np.zeros(3)
    legs = [float(np.linalg.norm(origin - at)) for at in (radar.track.position[pulse], receiver)]
    place = 0.5 * sum(legs) - radar.window.start_range[pulse]
    i = round(place / radar.window.sample_spacing)
    shape = np.sinc((i * radar.window.sample_spacing - place) / radar.waveform.range_cell)
    value = raw.total(channel)[pulse, i] / shape * legs[0] * legs[1] / radar.amplitude_constant
    return complex(value)


def _receiver(scene: Scene, baseline: F64, heading: float) -> F64:
    """Position of the receiver in the middle pulse."""
    along = np.array([np.sin(heading), np.cos(heading), 0.0])
    right = np.array([along[1], -along[0], 0.0])
    place = scene.radar.track.position[scene.radar.track.center_index]
    return np.asarray(
        place + baseline[0] * along + baseline[1] * right + baseline[2] * np.array([0.0, 0.0, 1.0])
    )


def bistatic_phase(quick: bool = False) -> Case:
    """Phase of an ideal point at drawn geometries, over the length of the baseline."""
    rng = np.random.default_rng(15)
    lengths = np.logspace(-1.0, 3.0, 9 if quick else 33)
    found, exact = [], []
    for length in lengths:
        baseline = rng.normal(size=3)
        baseline *= length / np.linalg.norm(baseline)
        heading = float(rng.uniform(-180.0, 180.0))
        parameters = _parameters(
            baseline, slant_range=5e3, heading_deg=heading, look_angle_deg=float(rng.uniform(25.0, 55.0))
        )
        point = PointTarget("p", rng.uniform(-8.0, 8.0, 3))
        with suppress_warnings():  # of the pulse rate: nobody focuses these echoes
            scene = make_scene(None, (), parameters, points=(point,))
        at = _receiver(scene, baseline, np.radians(heading))
        sent = scene.radar.track.position[scene.radar.track.center_index]
        phase = -4.0 * np.pi / WAVELENGTH * float(theory.bistatic_range(sent, point.position, at))
        exact.append(float(np.degrees(np.angle(np.exp(1j * phase)))))
        turn = np.angle(_echo(scene, at) * np.exp(-1j * phase))
        found.append(exact[-1] + float(np.degrees(turn)))
    return Case(
        name="bistatic_phase",
        topic="geometry",
        title="Phase of a point seen by two antennas",
        formula="arg = -2 pi (|p - x_t| + |p - x_r|) / lambda",
        source="the phase convention, over both legs",
        x_label="log10(baseline / m)",
        y_label="phase (deg)",
        comparisons=(
            Comparison(
                "drawn headings, incidences and baselines",
                np.log10(lengths),
                np.asarray(exact),
                np.asarray(found),
                tolerance=1e-4,
                reason="complex64",
                unit="deg",
            ),
        ),
        note="Raw data of the middle pulse, X band, 5 km; the receiver up to a fifth of the range away.",
    )


def bistatic_plate(quick: bool = False) -> Case:
    """Square conducting plate that faces the transmitter, over the angle to a receiver farther along the track."""
    side, distance, look = 0.6, 1000.0, np.radians(40.0)
    angles = np.radians(np.linspace(0.0, 11.5, 24 if quick else 93))
    n = 96
    cell = (np.arange(n) + 0.5) / n * side - 0.5 * side
    flat = np.stack([*(one.ravel() for one in np.meshgrid(cell, cell)), np.zeros(n * n)], axis=1)
    # facing the transmitter, which flies north to the west
    normal = np.array([-np.sin(look), 0.0, np.cos(look)])
    axes = np.stack([np.array([0.0, 1.0, 0.0]), np.cross(normal, [0.0, 1.0, 0.0]), normal])
    plate = targets.plate(side, side)
    geometry = replace(plate, vertices=plate.vertices @ axes)
    middles, normals = flat @ axes, np.tile(normal, (n * n, 1))
    areas = np.full(n * n, (side / n) ** 2)
    channels = ("HH", "VV")
    echoes: dict[str, tuple[list[complex], list[complex]]] = {channel: ([], []) for channel in channels}
    for angle in angles:
        baseline = np.array([distance * np.tan(angle), 0.0, 0.0])
        parameters = _parameters(
            baseline, slant_range=distance, look_angle_deg=40.0, polarisation=",".join(channels)
        )
        settings = TraceSettings(method="raw", max_depth=1, effects={"edge_diffraction": "off"})
        with suppress_warnings():  # of the pulse rate: nobody focuses these echoes
            scene = make_scene(geometry, targets.PEC, parameters, settings=settings)
        at = _receiver(scene, baseline, 0.0)
        sent = scene.radar.track.position[scene.radar.track.center_index]
        legs = float(np.linalg.norm(sent)) * float(np.linalg.norm(at))
        for channel, (found, exact) in echoes.items():
            with suppress_warnings():  # of edges, which physical optics alone leaves out
                found.append(_echo(scene, at, channel))
            facets = theory.bistatic_po(middles, normals, areas, sent, at, WAVELENGTH, channel)
            exact.append(complex(facets.sum()) * legs)
    return Case(
        name="bistatic_plate",
        topic="canonical",
        title="Square plate between two antennas",
        formula="sqrt(sigma) = 2 sqrt(pi) / lambda sum dS [n x (d x e)] . q exp(-j k (R_t + R_r))",
        source="Ruck et al., Radar Cross Section Handbook (1970), section 2.2.2; summed over 96 x 96 facets",
        x_label="bistatic angle (deg)",
        y_label="bistatic RCS (dBsm)",
        comparisons=tuple(
            Comparison(
                f"0.6 m, X band, {channel}",
                np.degrees(angles),
                db_from_power(np.abs(np.asarray(exact)) ** 2),
                db_from_power(np.abs(np.asarray(found)) ** 2),
                tolerance=0.1,
                reason="rays across the plate",
                floor=30.0,
                canonical=True,
            )
            for channel, (found, exact) in echoes.items()
        ),
        note="1 km; the plate faces the transmitter, the receiver flies ahead.",
    )


CASES.register(CaseEntry("bistatic_phase", "geometry", bistatic_phase))

CASES.register(CaseEntry("bistatic_plate", "canonical", bistatic_plate))
