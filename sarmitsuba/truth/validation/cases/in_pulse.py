"""Motion of the antenna within the pulse: where a long chirp appears, and the phase of an echo from orbit."""

import numpy as np

from sarmitsuba.core.constants import SPEED_OF_LIGHT
from sarmitsuba.scene.geometry import PointTarget
from sarmitsuba.scene.settings import TraceSettings
from sarmitsuba.simulation.execution.render import simulate
from sarmitsuba.truth import theory
from sarmitsuba.truth.validation.cases import CASES, CaseEntry
from sarmitsuba.truth.validation.chain import Parameter, make_scene, suppress_warnings
from sarmitsuba.truth.validation.comparison import Case, Comparison

FREQUENCY = 9.65e9
# a satellite's pulse, and the sweep of a drone's continuous wave
RADARS: dict[str, dict[str, Parameter]] = {
    "orbit": {"slant_range": 700e3, "speed": 7500.0, "bandwidth": 60e6, "pulse_width": 40e-6},
    "drone, FMCW": {"slant_range": 600.0, "speed": 15.0, "bandwidth": 150e6, "pulse_width": 1e-3},
}


def motion_in_pulse(quick: bool = False) -> Case:
    """Range shift and phase of a point's echo over the squint, against the exact echo of a moving antenna."""
    squints = np.linspace(-2.0, 2.0, 5 if quick else 17)
    comparisons = []
    for name, own in RADARS.items():
        shifts, exact_shifts, turns = [], [], []
        cell = SPEED_OF_LIGHT / (2.0 * float(own["bandwidth"]))
        for squint in squints:
            parameters: dict[str, Parameter] = {
                **own,
                "center_frequency": FREQUENCY,
                "squint_angle_deg": float(squint),
                "look_angle_deg": 40.0,
                "heading_deg": 30.0,
                "n_pulses": 2,
                "azimuth_resolution": 10.0,
                "image_extent_azimuth": 60.0,
                "image_extent_range": 60.0,
            }
            point = PointTarget("p", np.array([6.0, -4.0, 1.0]))
            settings = TraceSettings(effects={"motion_in_pulse": "on"})
            with suppress_warnings():  # of the pulse rate: nobody focuses these echoes
                scene = make_scene(None, (), parameters, points=(point,), settings=settings)
            radar, wave = scene.radar, scene.radar.waveform
            x, v = radar.track.position[0], radar.track.velocity[0]
            line = point.position - x
            distance = float(np.linalg.norm(line))
            profile = simulate(scene).total()[0].astype(np.complex128)
            samples = radar.window.start_range[0] + np.arange(profile.size) * radar.window.sample_spacing
            rate = -float(v @ line) / distance
            shift = theory.chirp_range_shift(rate, FREQUENCY, wave.bandwidth, wave.pulse_width)
            # the antenna is nearer or farther, too, when the echo is back
            exact_shifts.append(shift + rate * distance / SPEED_OF_LIGHT)
            fine = distance + exact_shifts[-1] + np.linspace(-1.0, 1.0, 1001) * wave.range_cell
            near = np.abs(samples - distance) < 40.0 * wave.range_cell
            offset = (fine[:, None] - samples[near]) / radar.window.sample_spacing
            shifts.append(float(fine[np.argmax(np.abs(np.sinc(offset) @ profile[near]))]) - distance)
            close = np.abs(samples - distance) < 4.0 * wave.range_cell
            echo = theory.moving_echo(
                x,
                v,
                point.position,
                2.0 * samples[close] / SPEED_OF_LIGHT,
                center_frequency=FREQUENCY,
                bandwidth=wave.bandwidth,
                pulse_width=wave.pulse_width,
            )
            turns.append(float(np.degrees(np.angle(np.vdot(echo, profile[close])))))
        comparisons.append(
            Comparison(
                f"{name}, shift in range",
                squints,
                np.asarray(exact_shifts),
                np.asarray(shifts),
                tolerance=0.004 * cell,
                reason="1/500 of a cell between places looked at; side lobes cut 40 cells away",
                unit="m",
            )
        )
        comparisons.append(
            Comparison(
                f"{name}, phase against the moving antenna's echo",
                squints,
                np.zeros(squints.size),
                np.asarray(turns),
                tolerance=0.3,
                reason="the chirp itself is stretched by 2 v sin(squint) / c",
                unit="deg",
                shown=0,
            )
        )
    return Case(
        name="motion_in_pulse",
        topic="antenna",
        title="Motion of the antenna within the pulse",
        formula="shift = (dR/dt) (f_c T_p / B + R / c); c D = |p - x(t)| + |p - x(t - D)|",
        source="Cumming and Wong (2005), 4.2; Prats-Iraola et al., IEEE TGRS 52 (2014), III",
        x_label="squint (deg)",
        y_label="shift in range (m), phase (deg)",
        comparisons=tuple(comparisons),
        note="X band; 40 us over 60 MHz at 7.5 km/s and 700 km, 1 ms over 150 MHz at 15 m/s and 600 m.",
    )


CASES.register(CaseEntry("motion_in_pulse", "antenna", motion_in_pulse))
