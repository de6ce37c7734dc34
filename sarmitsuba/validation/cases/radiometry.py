"""Radiometry end to end: from raw data to calibrated pixels over range, resolution, rate, pulse, window, focuser."""

from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from sarmitsuba import theory
from sarmitsuba.image.metrics import point_target_in
from sarmitsuba.image.sar_image import SarImage
from sarmitsuba.scene.geometry import Geometry, PointTarget
from sarmitsuba.scene.scene import Scene
from sarmitsuba.simulation.raw import simulate
from sarmitsuba.validation import targets
from sarmitsuba.validation.chain import chain, make_scene, track_distance
from sarmitsuba.validation.comparison import Case, CaseEntry, Comparison, db

F64 = NDArray[np.float64]
METHODS = ("backprojection", "omega_k")
WINDOWS = ("rectangular", "hamming", "taylor:4:-35", "kaiser:2.5")
RCS_DBSM = 7.0


def bandwidth(resolution: float) -> float:
    """Bandwidth of a slant-range cell, Hz."""
    return 299792458.0 / (2.0 * resolution)


def point_scene(slant_range: float, resolution: float, **changes: Any) -> Scene:
    """An ideal point of 7 dBsm somewhere off the aim point, X band."""
    cell = resolution
    parameters: dict[str, Any] = {
        "slant_range": slant_range,
        "look_angle_deg": 40.0,
        "azimuth_resolution": resolution,
        "bandwidth": bandwidth(resolution),
        "center_frequency": 9.65e9,
        "speed": 7500.0 if slant_range > 200e3 else 150.0,
        "image_extent_azimuth": 48.0 * cell,
        "image_extent_range": 72.0 * cell,
    } | changes
    point = PointTarget("point", np.array([3.3 * cell, -2.7 * cell, 0.4 * cell]), 10.0 ** (RCS_DBSM / 10.0))
    return make_scene(None, points=(point,), **parameters)


def peak_dbsm(image: SarImage) -> float:
    """Calibrated peak of the brightest target, dBsm."""
    return float(db(point_target_in(image).rcs))


def point_rcs(quick: bool = False) -> Case:
    """RCS of an ideal point through chirped echoes, compression and focusing."""
    reason = "interpolation of the peak; float32 profiles"
    comparisons = []

    def compare(label: str, x: list[float], values: list[float]) -> None:
        comparisons.append(
            Comparison(
                label,
                np.asarray(x),
                np.full(len(x), RCS_DBSM),
                np.asarray(values),
                tolerance=0.1,
                reason=reason,
                shown=len(x) - 1,
            )
        )

    ranges = [1e3, 10e3, 1000e3] if quick else [1e3, 3e3, 10e3, 50e3, 200e3, 700e3, 1000e3]
    # cells coarse enough to keep the aperture below half the range, fine enough to need thousands of pulses far away
    for method in METHODS:
        values = []
        for slant_range in ranges:
            resolution = max(0.5, slant_range / 100e3)
            image = chain(point_scene(slant_range, resolution), chirped=True, method=method)  # type: ignore[arg-type]
            values.append(peak_dbsm(image))
        compare(f"range 1 ... 1000 km, {method}, log10(R / m)", list(np.log10(ranges)), values)
    cells = [0.1, 1.0, 10.0] if quick else [0.1, 0.2, 0.5, 1.0, 3.0, 10.0]
    for method in METHODS:
        # a decimetre cell takes 3 km, 10 m take 100 km: both a few hundred pulses
        values = []
        for cell in cells:
            scene = point_scene(float(np.clip(1e4 * cell, 2e3, 1e5)), cell)
            values.append(peak_dbsm(chain(scene, chirped=True, method=method)))  # type: ignore[arg-type]
        compare(f"resolution 0.1 ... 10 m, {method}, log10(cell / m)", list(np.log10(cells)), values)
    base = point_scene(10e3, 1.0)
    track = base.radar.track
    prf = 1.0 / float(track.time[1] - track.time[0])
    factors = [1.0, 3.0] if quick else [0.9, 1.0, 1.5, 3.0]
    compare(
        "prf over automatic",
        factors,
        [peak_dbsm(chain(point_scene(10e3, 1.0, prf=f * prf), chirped=True)) for f in factors],
    )
    widths = [0.5e-6, 20e-6] if quick else [0.5e-6, 2e-6, 20e-6, 100e-6]
    compare(
        "pulse width, log10(s)",
        list(np.log10(widths)),
        [peak_dbsm(chain(point_scene(10e3, 1.0, pulse_width=w), chirped=True)) for w in widths],
    )
    for method in METHODS:
        compare(
            f"windows {', '.join(WINDOWS)}, {method}",
            [float(i) for i in range(len(WINDOWS))],
            [peak_dbsm(chain(base, chirped=True, method=method, window=w)) for w in WINDOWS],  # type: ignore[arg-type]
        )
    return Case(
        name="point_rcs",
        topic="radiometry",
        title="Calibrated RCS of an ideal point",
        formula="|pixel|^2 = RCS at the peak, 7 dBsm",
        source="the image's convention (radar equation inverted)",
        x_label="see the legend",
        y_label="RCS (dBsm)",
        comparisons=tuple(comparisons),
        note="LFM echoes, range compression, focusing, band-limited interpolation of the peak. X band, off the grid.",
    )


def received_power(quick: bool = False) -> Case:
    """Power of the range-compressed echo before calibration against the radar equation."""
    ranges = np.array([1e3, 10e3, 100e3, 1000e3])
    power, gain, losses = 500.0, 30.0, 2.0
    simulated, closed = [], []
    for slant_range in ranges:
        scene = point_scene(
            float(slant_range),
            max(0.5, slant_range / 100e3),
            transmit_power=power,
            gain_db=gain,
            losses_db=losses,
        )
        radar = scene.radar
        raw = simulate(scene)
        # oversample the strongest profile: its band-limited peak
        profile = raw.total()[radar.track.center_index].astype(np.complex128)
        n = profile.size
        spectrum = np.fft.fftshift(np.fft.fft(profile))
        fine = np.fft.ifft(np.fft.ifftshift(np.pad(spectrum, (32 * n, 32 * n)))) * 65.0
        simulated.append(db(np.max(np.abs(fine)) ** 2))
        r = np.linalg.norm(scene.points[0].position - radar.track.position[radar.track.center_index])
        closed.append(
            db(
                theory.received_power(
                    power,
                    10.0 ** (gain / 10.0),
                    radar.waveform.wavelength,
                    scene.points[0].rcs,
                    float(r),
                    10.0 ** (losses / 10.0),
                )
            )
        )
    return Case(
        name="received_power",
        topic="radiometry",
        title="Received power before calibration falls with the fourth power of range",
        formula="P_t G^2 lambda^2 sigma / ((4 pi)^3 R^4 L)",
        source="Skolnik, Introduction to Radar Systems, 3rd ed.",
        x_label="log10(slant range / m)",
        y_label="power (dBW)",
        comparisons=(
            Comparison(
                "500 W, 30 dB, 2 dB losses, 7 dBsm",
                np.log10(ranges),
                np.asarray(closed),
                np.asarray(simulated),
                tolerance=0.02,
                reason="the profile's ends are cut by the receive window",
                unit="dB",
                shown=1,
            ),
        ),
        note="Peak of the range-compressed mid-aperture echo.",
    )


def traced_rcs(quick: bool = False) -> Case:
    """Traced plates and corner reflectors through the whole chain."""
    lam = targets.wavelength("X")
    turn = _turn_to_look(np.radians(40.0))
    corner = _rotated(targets.trihedral(0.6, "triangular"), _corner_turn())
    shapes = {
        "plate 0.5 m": (_rotated(targets.plate(0.5, 0.5), turn), 4.0 * np.pi * 0.5**4 / lam**2),
        "triangular trihedral 0.6 m": (
            _rotated(corner, turn),
            4.0 * np.pi * 0.6**4 / (3.0 * lam**2),
        ),
    }
    comparisons = []
    # cells of 2 m and more keep the aperture within a tenth of the plate's lobe
    setups = [(10e3, 2.0), (700e3, 5.0)] if quick else [(2e3, 2.0), (10e3, 2.0), (100e3, 3.0), (700e3, 5.0)]
    for name, (shape, rcs) in shapes.items():
        for method in METHODS:
            values = []
            for slant_range, resolution in setups:
                scene = make_scene(
                    shape,
                    targets.PEC,
                    slant_range=slant_range,
                    look_angle_deg=40.0,
                    azimuth_resolution=resolution,
                    bandwidth=bandwidth(resolution),
                    center_frequency=9.65e9,
                    speed=7500.0 if slant_range > 200e3 else 150.0,
                    image_extent_azimuth=24.0 * resolution,
                    image_extent_range=36.0 * resolution,
                )
                values.append(peak_dbsm(chain(scene, chirped=True, method=method)))  # type: ignore[arg-type]
            comparisons.append(
                Comparison(
                    f"{name}, {method}",
                    np.log10([s[0] for s in setups]),
                    np.full(len(setups), float(db(rcs))),
                    np.asarray(values),
                    tolerance=0.2,
                    reason="4.5 rays a wavelength, and the lobe's fall over the aperture, 0.05 dB",
                )
            )
    comparisons += _two_corners()
    return Case(
        name="traced_rcs",
        topic="radiometry",
        title="Traced targets through the whole chain",
        formula="4 pi A^2 / lambda^2 (plate), 4 pi a^4 / (3 lambda^2) (trihedral)",
        source="Skolnik, Radar Handbook",
        x_label="log10(slant range / m)",
        y_label="RCS (dBsm)",
        comparisons=tuple(comparisons),
        note="X band; cells of 2 to 5 m from 2 to 700 km, and two corners off the centre at 10 km in cells of 0.5 m.",
    )


def _two_corners() -> list[Comparison]:
    """Two corners either side of the launch window's centre: levels and places over several key pulses."""
    edge, cell, slant_range = 0.4, 0.5, 10e3
    # a wave's phase shows only off the centre of the window, to which lengths are referred
    places = np.array([[1.7, 2.1, 0.0], [-1.9, -2.3, 0.0]])
    corner = _rotated(
        _rotated(targets.trihedral(edge, "triangular"), _corner_turn()), _turn_to_look(np.radians(40.0))
    )
    meshes = [(corner.vertices + place, corner.faces) for place in places]
    scene = make_scene(
        targets.geometry(meshes),
        targets.PEC,
        slant_range=slant_range,
        look_angle_deg=40.0,
        azimuth_resolution=cell,
        bandwidth=bandwidth(cell),
        center_frequency=9.65e9,
        speed=150.0,
        image_extent_azimuth=40.0 * cell,
        image_extent_range=60.0 * cell,
    )
    radar = scene.radar
    at_range = track_distance(radar, places)
    closed = float(db(4.0 * np.pi * edge**4 / (3.0 * radar.waveform.wavelength**2)))
    comparisons = []
    for method in METHODS:
        image = chain(scene, chirped=True, method=method)  # type: ignore[arg-type]
        at_azimuth = (places - image.grid.origin) @ image.grid.along
        found = [
            point_target_in(image, near=(float(a), float(r)), chip=16)
            for a, r in zip(at_azimuth, at_range, strict=True)
        ]
        off = [
            np.hypot(m.azimuth_position - a, m.range_position - r)
            for m, a, r in zip(found, at_azimuth, at_range, strict=True)
        ]
        for label, want, got, tolerance, unit in (
            ("level", closed, [float(db(m.rcs)) for m in found], 0.3, "dBsm"),
            ("distance from its place", 0.0, off, 0.1 * cell, "m"),
        ):
            comparisons.append(
                Comparison(
                    f"two corners {edge:g} m, 5 m apart, {method}, {label}",
                    np.arange(2.0),
                    np.full(2, want),
                    np.asarray(got),
                    tolerance=tolerance,
                    reason="13 wavelengths an edge: single and double bounces, and the other corner's side lobes",
                    unit=unit,
                )
            )
    return comparisons


def _corner_turn() -> F64:
    """Rotation that puts the axis of a corner, (1, 1, 1), on +z."""
    z = np.ones(3) / np.sqrt(3.0)
    x = np.array([1.0, -1.0, 0.0]) / np.sqrt(2.0)
    return np.stack([x, np.cross(z, x), z])


def _turn_to_look(look_angle: float) -> F64:
    """Rotation that turns +z towards a radar that flies along +y and looks right (it stands at -x)."""
    z = np.array([-np.sin(look_angle), 0.0, np.cos(look_angle)])
    y = np.array([0.0, 1.0, 0.0])
    return np.stack([np.cross(y, z), y, z], axis=1)


def _rotated(shape: Geometry, rotation: F64) -> Geometry:
    return replace(shape, vertices=shape.vertices @ rotation.T)


CASES = (
    CaseEntry("point_rcs", "radiometry", point_rcs),
    CaseEntry("received_power", "radiometry", received_power),
    CaseEntry("traced_rcs", "radiometry", traced_rcs),
)

__all__ = [
    "CASES",
    "point_rcs",
    "point_scene",
    "received_power",
    "traced_rcs",
]
