"""Antenna beam: two-way gain off its centre, in both modes, for points and traced targets; and mispointing."""

from collections.abc import Callable, Mapping
from dataclasses import replace
from typing import Literal

import numpy as np

from sarmitsuba.core.arrays import F64, unit_rows
from sarmitsuba.core.units import db_from_power
from sarmitsuba.radar.antenna import Antenna
from sarmitsuba.radar.radar import Radar
from sarmitsuba.scene.geometry import Geometry, PointTarget
from sarmitsuba.scene.scene import Scene
from sarmitsuba.scene.settings import TraceSettings
from sarmitsuba.signal.focusing.focusers.backprojection import backproject
from sarmitsuba.signal.raw_data import RawData
from sarmitsuba.simulation.execution.render import simulate
from sarmitsuba.truth import theory
from sarmitsuba.truth.validation import targets
from sarmitsuba.truth.validation.cases import CASES, CaseEntry
from sarmitsuba.truth.validation.chain import Parameter, make_scene
from sarmitsuba.truth.validation.comparison import Case, Comparison

WIDTH = np.radians(2.0)  # of the beam, both ways
RANGE = 500.0
PRF = 60.0  # of a speed of 50 m/s: four times the aperture of the beam
FREQUENCY = 3.0e9
WAVELENGTH = 299792458.0 / FREQUENCY
LENGTH = 0.442946470689452 * WAVELENGTH / np.sin(0.5 * WIDTH)  # uniform aperture of that width
GAINS = {
    "gaussian": theory.gaussian_gain(WIDTH),
    "rectangular": theory.uniform_aperture_gain(LENGTH, WAVELENGTH),
}


def parameters(mode: str, pattern: str, seed: int, squint: float) -> dict[str, Parameter]:
    """A radar of drawn heading, side and look angle that aims at the origin."""
    rng = np.random.default_rng([31, seed])
    found: dict[str, Parameter] = {
        "mode": mode,
        "pattern": pattern,
        "slant_range": RANGE,
        "look_angle_deg": float(rng.uniform(35.0, 55.0)),
        "heading_deg": float(rng.uniform(0.0, 360.0)),
        "look_side": ("left", "right")[int(rng.integers(2))],
        "squint_angle_deg": squint,
        "azimuth_resolution": 3.0,
        "bandwidth": 50e6,
        "center_frequency": FREQUENCY,
        "speed": 50.0,
        "polarisation": "HH,VV",
        "image_extent_azimuth": 30.0,
        "image_extent_range": 40.0,
    }
    if pattern != "isotropic":
        found |= {
            name: float(np.degrees(WIDTH)) for name in ("azimuth_beamwidth_deg", "elevation_beamwidth_deg")
        }
    return found


def offset(radar: Radar, azimuth: float, elevation: float) -> F64:
    """Point in the plane through the aim point across the line of sight, offset in fractions of the half beamwidth."""
    line = radar.aim_point - radar.track.center_position
    line = line / np.linalg.norm(line)
    along = radar.track.along - (radar.track.along @ line) * line
    along = along / np.linalg.norm(along)
    up = np.cross(along, line)
    up = up * np.sign(up[2])
    return np.asarray(radar.aim_point + RANGE * np.sin(0.5 * WIDTH) * (azimuth * along + elevation * up))


def closed_gain(radar: Radar, pattern: str, point: F64, spread: F64 | None = None) -> float:
    r"""Two-way power gain of a focused point over that at boresight: the square of the aperture's mean amplitude.

    Parameters
    ----------
    radar : track, aim point and processed band
    point : (3,) m
    spread : (n, 3) m; a corner whose paths leave towards ``point + spread`` and come back from ``point - spread``
    """
    track, along = radar.track, radar.track.along
    ahead = (point - track.center_position) @ along
    closest = float(np.linalg.norm(point - track.center_position - ahead * along))
    middle = radar.aim_point - track.center_position
    middle = middle / np.linalg.norm(middle)
    if np.isfinite(radar.half_aperture):
        sine = middle @ along + np.linspace(-radar.half_aperture, radar.half_aperture, 401)
        x = ahead - closest * np.tan(np.arcsin(sine))
        weight = (1.0 - sine**2) ** -1.5
    else:
        half = 0.5 * float((track.position[-1] - track.position[0]) @ along)
        half *= track.n_pulses / (track.n_pulses - 1)
        x = np.linspace(-half, half, 401)
        weight = np.ones(401)
    place = track.center_position + x[:, None] * along
    boresight = np.broadcast_to(middle, place.shape)
    if radar.mode == "spotlight":
        boresight = radar.aim_point - place
        boresight = unit_rows(boresight)
    azimuth = along - (boresight @ along)[:, None] * boresight
    azimuth = unit_rows(azimuth)
    elevation = np.cross(azimuth, boresight)

    def one_way(target: F64) -> F64:
        line = target - place
        line = unit_rows(line)
        gain = GAINS[pattern]
        return np.asarray(gain(np.sum(line * azimuth, axis=1)) * gain(np.sum(line * elevation, axis=1)))

    parts = np.zeros((1, 3)) if spread is None else spread
    amplitude = np.mean([np.sqrt(one_way(point + s) * one_way(point - s)) for s in parts], axis=0)
    return float((np.sum(weight * amplitude) / weight.sum()) ** 2)


def level(raw: RawData, point: F64) -> F64:
    """RCS (n_channels,) of the pixel at a point, focused as for an isotropic antenna, m^2."""
    told = replace(raw, radar=replace(raw.radar, antenna=Antenna()))
    return np.asarray(np.abs(backproject(told, point[None])[:, 0]) ** 2)


def corner(seed: int) -> Callable[[F64, F64], Geometry]:
    """Trihedral of 1 m facing the radar, with a random roll."""
    roll = float(np.random.default_rng([32, seed]).uniform(0.0, 360.0))

    def made(point: F64, toward: F64) -> Geometry:
        shape = targets.trihedral(1.0, "triangular")
        diagonal = np.ones(3) / np.sqrt(3.0)
        return place_geometry(shape, frame(diagonal, 0.0), frame(toward, np.radians(roll)), point)

    return made


def plate(point: F64, toward: F64) -> Geometry:
    """A plate of 0.6 m that faces the radar."""
    return place_geometry(
        targets.plate(0.6, 0.6), frame(np.array([0.0, 0.0, 1.0]), 0.0), frame(toward, 0.3), point
    )


def dihedral(roll: float, side: float) -> Callable[[F64, F64], Geometry]:
    """A dihedral whose corner line stands at ``roll`` from the horizontal."""

    def made(point: F64, toward: F64) -> Geometry:
        # faces along +x and +y; the corner line is z: the frame's third axis
        bisector = np.array([1.0, 1.0, 0.0]) / np.sqrt(2.0)
        own = np.stack([bisector, np.array([0.0, 0.0, 1.0]), np.cross(bisector, [0.0, 0.0, 1.0])])
        return place_geometry(targets.dihedral(side, side, side), own, frame(toward, roll), point)

    return made


def frame(toward: F64, roll: float) -> F64:
    """(3, 3) rows: a direction, and two axes across it, the first horizontal before it is rolled."""
    first = np.cross([0.0, 0.0, 1.0], toward) if abs(toward[2]) < 0.99 else np.array([1.0, 0.0, 0.0])
    first = first / np.linalg.norm(first)
    second = np.cross(toward, first)
    return np.stack(
        [toward, np.cos(roll) * first + np.sin(roll) * second, np.cos(roll) * second - np.sin(roll) * first]
    )


def place_geometry(shape: Geometry, own: F64, wanted: F64, point: F64) -> Geometry:
    """Geometry rotated from one frame into another and moved to a point."""
    return replace(shape, vertices=shape.vertices @ own.T @ wanted + point)


def measured_gain(
    values: Mapping[str, Parameter],
    place: tuple[float, float],
    shape: Callable[[F64, F64], Geometry] | None,
    method: Literal["raw", "hybrid"] = "raw",
) -> tuple[Scene, F64, F64]:
    """Scene, position of the target, and its gain (HH, VV) relative to an isotropic antenna."""
    levels = []
    bare = {k: v for k, v in values.items() if not k.endswith("beamwidth_deg")} | {"pattern": "isotropic"}
    aim = make_scene(None, (), bare, points=(PointTarget("aim", np.zeros(3), 1.0),)).radar
    point = offset(aim, *place)
    toward = aim.track.center_position - point
    toward = toward / np.linalg.norm(toward)
    if shape is None:
        scene = make_scene(None, (), values, points=(PointTarget("point", point, 1.0),))
        return scene, point, level(simulate(scene), point)
    settings = TraceSettings(max_depth=3, method=method)
    with_beam = make_scene(shape(point, toward), targets.PEC, values, settings=settings)
    # the same track and processed band, so that only the gain differs
    without = replace(with_beam, radar=replace(with_beam.radar, antenna=Antenna()))
    for scene in (with_beam, without):
        levels.append(level(simulate(scene, seed=1), point))
    return with_beam, point, levels[0] / levels[1]


def beam_gain(quick: bool = False) -> Case:
    """Two-way gain off the beam's centre, of ideal points and traced targets."""
    comparisons = []
    setups = [("spotlight", "gaussian", 0.0), ("stripmap", "rectangular", 8.0)]
    if not quick:
        setups += [("spotlight", "rectangular", -6.0), ("stripmap", "gaussian", 0.0)]
    kinds: dict[str, tuple[Callable[[F64, F64], Geometry] | None, int, float]] = {
        "ideal points": (None, 4, 0.02),
        "trihedral": (corner(1), 1 if quick else 3, 0.05),
        "plate": (plate, 1 if quick else 3, 0.05),
    }
    reasons = {
        "ideal points": "float32 profiles",
        "trihedral": "its corner is a metre wide",
        "plate": "its lobe over the aperture",
    }
    for number, (mode, pattern, squint) in enumerate(setups):
        for kind, (shape, n, tolerance) in kinds.items():
            closed, found = [], []
            for draw in range(n):
                rng = np.random.default_rng([33, number, draw, len(kind)])
                off, angle = rng.uniform(0.3, 0.95), rng.uniform(0.0, 2.0 * np.pi)
                place = (float(off * np.cos(angle)), float(off * np.sin(angle)))
                scene, point, gain = measured_gain(parameters(mode, pattern, draw, squint), place, shape)
                closed += 2 * [closed_gain(scene.radar, pattern, point)]
                found += list(gain)
            comparisons.append(
                Comparison(
                    f"{kind}, {mode}, {pattern}, squint {squint:g} deg, HH and VV",
                    0.5 * np.arange(2.0 * n),
                    db_from_power(np.array(closed)),
                    db_from_power(np.array(found)),
                    tolerance=tolerance,
                    reason=reasons[kind],
                    unit="dB",
                )
            )
    side = 4.0
    legs: tuple[tuple[str, float, Literal["raw", "hybrid"]], ...] = (
        ("elevation", 0.0, "raw"),
        ("azimuth", 0.5 * np.pi, "raw"),
        ("azimuth", 0.5 * np.pi, "hybrid"),
    )
    for name, roll, method in legs[1 if quick else 0 :]:
        # pulses enough for blocks of them
        values = parameters("spotlight", "gaussian", 7, 0.0) | {"azimuth_resolution": 1.5}
        scene, point, gain = measured_gain(values, (0.6, 0.5), dihedral(roll, side), method)
        toward = scene.radar.track.center_position - point
        toward = toward / np.linalg.norm(toward)
        across = np.linspace(-side / np.sqrt(2.0), side / np.sqrt(2.0), 201)[:, None]
        closed_db = float(
            db_from_power(closed_gain(scene.radar, "gaussian", point, across * frame(toward, roll)[2]))
        )
        comparisons.append(
            Comparison(
                f"dihedral of {side:g} m, legs apart in {name}, {method}, HH and VV",
                np.array([0.0, 0.5]),
                np.full(2, closed_db),
                db_from_power(gain),
                tolerance=0.1,
                reason="single bounces of its faces; tubes",
                unit="dB",
            )
        )
    return Case(
        name="beam_gain",
        topic="antenna",
        title="Two-way gain off the beam's centre: first leg and last leg",
        formula="|mean over the aperture of sqrt(g(first leg) g(last leg))|^2, g the one-way power gain",
        source="gain of a Gaussian beam and of a uniform aperture; reciprocity",
        x_label="drawn target",
        y_label="gain (dB)",
        comparisons=tuple(comparisons),
        note="Beam of 2 deg both ways, S band, 500 m; drawn headings, sides and look angles; targets 0.3 to 0.95 "
        "half-widths off; the processor takes the antenna as isotropic. The dihedral is half as wide as the "
        "half-power beam, so that its two legs have gains of their own: one gain at its middle "
        "would be 0.2 dB off.",
    )


def centroid(raw: RawData) -> float:
    """Doppler centroid by the phase of the correlation of neighbouring pulses, Hz, within half the prf of zero."""
    data = raw.total()
    prf = 1.0 / float(np.diff(raw.radar.track.time).mean())
    lag = np.sum(data[1:].astype(np.complex128) * np.conj(data[:-1]))
    return float(np.angle(lag)) * prf / (2.0 * np.pi)


def mispointing(quick: bool = False) -> Case:
    """Level and Doppler centroid of a beam with a pointing error unknown to the processor."""
    errors = np.array([0.3, 0.7]) if quick else np.array([0.0, 0.2, 0.4, 0.6, 0.8, 1.0])
    comparisons = []
    for pattern, squint in (("gaussian", 0.0), ("rectangular", 5.0)):
        loss, shift = [], []
        closed_loss, closed_shift = [], []
        for draw, part in enumerate(errors):
            sign = (-1.0) ** draw
            azimuth, elevation = sign * 0.5 * part * WIDTH, -sign * 0.3 * part * WIDTH
            values = parameters("stripmap", pattern, draw, squint) | {
                "prf": PRF,
                "image_extent_azimuth": 60.0,
                "pointing_error_azimuth_deg": float(np.degrees(azimuth)),
                "pointing_error_elevation_deg": float(np.degrees(elevation)),
            }
            scene = make_scene(None, (), values, points=(PointTarget("p", np.zeros(3), 1.0),))
            raw = simulate(scene)
            point = scene.points[0].position
            loss.append(float(np.abs(backproject(raw, point[None])[0, 0]) ** 2))
            gain = GAINS[pattern]
            in_elevation = float(gain(np.array(np.sin(elevation)))) ** 2
            half = scene.radar.half_aperture
            closed_loss.append(
                theory.mispointed_level(gain, half, azimuth, np.radians(squint)) * in_elevation
            )
            want = theory.doppler_centroid(50.0, WAVELENGTH, np.radians(squint) + azimuth)
            want -= theory.doppler_centroid(50.0, WAVELENGTH, np.radians(squint))
            nominal = make_scene(
                None,
                (),
                {k: v for k, v in values.items() if not k.startswith("pointing")},
                points=(PointTarget("p", np.zeros(3), 1.0),),
            )
            moved = centroid(raw) - centroid(simulate(nominal)) - want
            shift.append(want + moved - PRF * float(np.round(moved / PRF)))
            closed_shift.append(want)
        comparisons += [
            Comparison(
                f"level, {pattern}, squint {squint:g} deg",
                errors,
                db_from_power(np.array(closed_loss)),
                db_from_power(np.array(loss)),
                tolerance=0.05,
                reason="pulses at the band's ends count in part",
                unit="dB",
            ),
            Comparison(
                f"Doppler centroid, {pattern}, squint {squint:g} deg",
                errors,
                np.array(closed_shift),
                np.array(shift),
                tolerance=0.3,
                reason="the track ends within the beam's skirts",
                unit="Hz",
            ),
        ]
    return Case(
        name="mispointing",
        topic="antenna",
        title="A beam that points elsewhere than the processor is told",
        formula="level |int g g' dx / int g^2 dx|^2 g_el^2; centroid 2 v sin(psi + error) / lambda",
        source="Curlander and McDonough, Synthetic Aperture Radar, 1991, sec. 6.5; matched filter of another beam",
        x_label="azimuth error over half the beamwidth, 0.6 of it in elevation",
        y_label="level (dB), shift of the centroid (Hz)",
        comparisons=tuple(comparisons),
        note="Stripmap, S band, 500 m, 2 deg both ways; a focused point, and the echoes' correlation.",
    )


CASES.register(CaseEntry("beam_gain", "antenna", beam_gain))
CASES.register(CaseEntry("mispointing", "antenna", mispointing))
