"""Azimuth ambiguities: positions, levels and total energy of the ghosts of a point in stripmap."""

from collections.abc import Mapping
from dataclasses import replace

import numpy as np

from sarmitsuba.analysis.pulse_timing import azimuth_ambiguity_ratio
from sarmitsuba.core.arrays import F64
from sarmitsuba.core.units import db_from_power
from sarmitsuba.radar.radar import Radar
from sarmitsuba.scene.geometry import PointTarget
from sarmitsuba.signal.focusing.focusers.backprojection import backproject
from sarmitsuba.simulation.execution.render import simulate
from sarmitsuba.truth import theory
from sarmitsuba.truth.validation.cases import CASES, CaseEntry
from sarmitsuba.truth.validation.chain import Parameter, make_scene, suppress_warnings
from sarmitsuba.truth.validation.comparison import Case, Comparison

FREQUENCY = 9.65e9
WAVELENGTH = 299792458.0 / FREQUENCY
ORIGIN = np.zeros((1, 2))
# slant range, m; antenna length, m; speed, m/s
PLATFORMS = {"10 km": (10e3, 2.0, 120.0), "700 km": (700e3, 10.0, 7500.0)}


class Ghosts:
    """Undersampled stripmap image of a point with a uniform aperture.

    Parameters
    ----------
    platform : of ``PLATFORMS``
    prf_factor : prf over the speed by half the antenna's length, 2 v / D
    squint : rad
    bandwidth : of the pulse, Hz
    pointing_error : of the beam in azimuth, rad
    seed : of heading, side and look angle
    """

    def __init__(
        self,
        platform: str,
        prf_factor: float,
        squint: float,
        bandwidth: float,
        *,
        pointing_error: float = 0.0,
        seed: int = 0,
    ) -> None:
        self.slant_range, self.length, self.speed = PLATFORMS[platform]
        self.prf = 2.0 * self.speed / self.length * prf_factor
        self.squint, self.error = squint, pointing_error
        self.gain = theory.uniform_aperture_gain(self.length, WAVELENGTH)
        rng = np.random.default_rng([41, seed])
        apart = abs(theory.azimuth_ghost(WAVELENGTH, self.slant_range, self.prf, self.speed)[0])
        values: Mapping[str, Parameter] = {
            "mode": "stripmap",
            "pattern": "rectangular",
            "antenna_length": self.length,
            "antenna_height": 0.05,
            "slant_range": self.slant_range,
            "look_angle_deg": float(rng.uniform(30.0, 45.0)),
            "heading_deg": float(rng.uniform(0.0, 360.0)),
            "look_side": ("left", "right")[int(rng.integers(2))],
            "squint_angle_deg": float(np.degrees(squint)),
            "azimuth_resolution": 0.6 * self.length,
            "bandwidth": bandwidth,
            "center_frequency": FREQUENCY,
            "speed": self.speed,
            "prf": self.prf,
            "image_extent_azimuth": 4.4 * apart,
            "image_extent_range": 300.0,
        }
        if pointing_error:
            values = {**values, "pointing_error_azimuth_deg": float(np.degrees(pointing_error))}
        with suppress_warnings():  # about the prf, which is intended
            scene = make_scene(None, (), values, points=(PointTarget("p", np.zeros(3), 1.0),))
            raw = simulate(scene)
        self.raw = replace(
            raw, radar=raw.radar.start_stop()
        )  # from orbit the antenna moves on until the echo is back
        self.cell = 0.6 * self.length
        self.radar: Radar = self.raw.radar
        self.point = scene.points[0].position

    @property
    def processed(self) -> float:
        """Processed Doppler bandwidth, Hz."""
        return 4.0 * self.speed / WAVELENGTH * self.radar.half_aperture

    def at(self, places: F64) -> F64:
        """Image power (n,) at (n, 2) places from the point, m: along the track, and in closest range."""
        track = self.radar.track
        along = track.velocity[0] / np.linalg.norm(track.velocity[0])
        leg = self.point - track.center_position
        ahead = float(leg @ along)
        across = leg - ahead * along
        closest = float(np.linalg.norm(across))
        points = (
            track.center_position
            + (ahead + places[:, :1]) * along
            + (closest + places[:, 1:]) * across / closest
        )
        return np.asarray(np.abs(backproject(self.raw, points)[0]) ** 2)

    def ghost(self, order: int) -> F64:
        """(2,) place of a ghost by theory."""
        sine = float(np.sin(self.squint))
        return np.array(theory.azimuth_ghost(WAVELENGTH, self.slant_range, self.prf, self.speed, order, sine))

    def theory_level(self, order: int) -> float:
        """Power of a ghost over the point's by theory."""
        return theory.azimuth_ghost_level(
            self.gain,
            WAVELENGTH,
            self.slant_range,
            self.prf,
            self.speed,
            self.processed,
            order,
            range_cell=self.radar.waveform.range_cell,
            squint=self.squint,
            pointing_error=self.error,
        )

    def energy(self, place: F64) -> float:
        """Energy of the image along the track within 40 cells about a place."""
        line = np.arange(-120, 121) * (self.cell / 3.0)
        return float(self.at(place + np.stack([line, np.zeros_like(line)], axis=1)).sum())


def azimuth_ghosts(quick: bool = False) -> Case:
    """Places and levels of a point's azimuth ambiguities."""
    comparisons = []
    draws = 2 if quick else 6
    for platform in PLATFORMS:
        for name, bandwidth in (("coarse", 3e6), ("fine", 60e6)):
            level, closed, where, factors = [], [], [], []
            for draw in range(draws):
                rng = np.random.default_rng([42, draw, len(platform), len(name)])
                factor = float(rng.uniform(0.75, 1.25))
                squint = float(np.radians(rng.uniform(-4.0, 4.0))) if draw % 2 else 0.0
                seen = Ghosts(platform, factor, squint, bandwidth, seed=draw)
                own = seen.at(ORIGIN)[0]
                for order in (-1, 1):
                    place = seen.ghost(order)
                    level.append(seen.at(place[None])[0] / own)
                    closed.append(seen.theory_level(order))
                    factors.append(factor + 0.002 * order)
                    if name == "coarse":
                        line = np.linspace(-1.5, 1.5, 61)[:, None] * np.array([seen.cell, 0.0])
                        where.append(float(line[np.argmax(seen.at(place + line)), 0]) / seen.cell)
            comparisons.append(
                Comparison(
                    f"level, {platform}, {name} range cell",
                    np.array(factors),
                    db_from_power(np.array(closed)),
                    db_from_power(np.array(level)),
                    tolerance=0.6,
                    reason="side lobes of the point itself, about -54 dB there",
                    unit="dB",
                )
            )
            if where:
                comparisons.append(
                    Comparison(
                        f"place less lambda R PRF / 2 v, {platform}",
                        np.array(factors),
                        np.zeros(len(where)),
                        np.array(where),
                        tolerance=0.3,
                        reason="azimuth cells; the ghost's band is lopsided and its chirp another",
                        unit="",
                        shown=0,
                    )
                )
    return Case(
        name="azimuth_ghosts",
        topic="antenna",
        title="Azimuth ambiguities of a point: where its ghosts are, and how strong",
        formula="at k lambda R PRF / 2v; level |int g(s) g(s - k lambda PRF / 2v) sinc(D / cell) dx / int g^2 dx|^2",
        source="Curlander and McDonough, Synthetic Aperture Radar, 1991, sec. 6.5.1",
        x_label="prf over 2 v / D",
        y_label="ghost over point (dB), place (cells)",
        comparisons=tuple(comparisons),
        note="Stripmap, X band, uniform aperture of 2 m (10 km) and 10 m (700 km); drawn prf, headings and squints to "
        "4 deg; both first orders. In the fine range cell of 2.5 m the ghost's range walk D smears it.",
    )


def ambiguity_ratio(quick: bool = False) -> Case:
    """Total energy of the ghosts relative to the point, with and without a pointing error."""
    errors = np.array([0.0, 0.35]) if quick else np.array([0.0, 0.1, 0.2, 0.35, 0.5])
    comparisons = []
    for platform in PLATFORMS:
        measured, closed = [], []
        for draw, part in enumerate(errors):
            length = PLATFORMS[platform][1]
            error = float(part * 0.886 * WAVELENGTH / length)
            seen = Ghosts(platform, 0.95, 0.0, 3e6, pointing_error=error, seed=10 + draw)
            own = seen.energy(np.zeros(2))
            measured.append(sum(seen.energy(seen.ghost(k)) for k in (-2, -1, 1, 2)) / own)
            closed.append(
                azimuth_ambiguity_ratio(
                    seen.gain,
                    WAVELENGTH,
                    seen.prf,
                    seen.speed,
                    seen.processed,
                    weighting="matched",
                    pointing_error=error,
                    orders=2,
                )
            )
        comparisons.append(
            Comparison(
                f"energy of the ghosts to the second order, {platform}",
                errors,
                db_from_power(np.array(closed)),
                db_from_power(np.array(measured)),
                tolerance=0.3,
                reason="side lobes beyond 40 cells; side lobes of the point itself",
                unit="dB",
            )
        )
    return Case(
        name="ambiguity_ratio",
        topic="antenna",
        title="Azimuth ambiguity-to-signal ratio, and its rise with a pointing error",
        formula="sum over m of int W G^2(f + m PRF) df / int W G^2(f) df, W = G^2 of the nominal beam",
        source="Curlander and McDonough, Synthetic Aperture Radar, 1991, sec. 6.5.1",
        x_label="pointing error in azimuth over the half-power width",
        y_label="ambiguities over signal (dB)",
        comparisons=tuple(comparisons),
        note="A point's ghosts hold, all together, what ground of the same level shows of other ground. Stripmap, X "
        "band, prf 0.95 of 2 v / D, azimuth cell 0.6 D.",
    )


CASES.register(CaseEntry("azimuth_ghosts", "antenna", azimuth_ghosts))
CASES.register(CaseEntry("ambiguity_ratio", "antenna", ambiguity_ratio))
