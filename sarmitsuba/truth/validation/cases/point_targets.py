"""Radiometry of an ideal point: calibrated peak, and received power before calibration."""

import numpy as np

from sarmitsuba.core.units import db_from_power
from sarmitsuba.simulation.execution.render import simulate
from sarmitsuba.truth import theory
from sarmitsuba.truth.validation.cases import CASES, CaseEntry
from sarmitsuba.truth.validation.chain import METHODS, RCS_DBSM, WINDOWS, chain, peak_dbsm, point_scene
from sarmitsuba.truth.validation.comparison import Case, Comparison


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
            image = chain(point_scene(slant_range, resolution), chirped=True, method=method)
            values.append(peak_dbsm(image))
        compare(f"range 1 ... 1000 km, {method}, log10(R / m)", list(np.log10(ranges)), values)
    cells = [0.1, 1.0, 10.0] if quick else [0.1, 0.2, 0.5, 1.0, 3.0, 10.0]
    for method in METHODS:
        # a decimetre cell takes 3 km, 10 m take 100 km: both a few hundred pulses
        values = []
        for cell in cells:
            scene = point_scene(float(np.clip(1e4 * cell, 2e3, 1e5)), cell)
            values.append(peak_dbsm(chain(scene, chirped=True, method=method)))
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
            [peak_dbsm(chain(base, chirped=True, method=method, window=w)) for w in WINDOWS],
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
        simulated.append(db_from_power(np.max(np.abs(fine)) ** 2))
        r = np.linalg.norm(scene.points[0].position - radar.track.position[radar.track.center_index])
        closed.append(
            db_from_power(
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


CASES.register(CaseEntry("point_rcs", "radiometry", point_rcs))
CASES.register(CaseEntry("received_power", "radiometry", received_power))
