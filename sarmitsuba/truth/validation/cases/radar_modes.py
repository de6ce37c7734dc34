"""The radar modes' resolution: beams that move over the ground, apertures that all pixels share, the whole circle."""

import numpy as np

from sarmitsuba.analysis.image_quality import image_quality
from sarmitsuba.analysis.point_quality import KnownPoint
from sarmitsuba.core.constants import SPEED_OF_LIGHT
from sarmitsuba.scene.geometry import PointTarget
from sarmitsuba.scene.scene import Scene
from sarmitsuba.signal.focusing import focus
from sarmitsuba.signal.image import SarImage
from sarmitsuba.simulation.execution.render import simulate
from sarmitsuba.truth import theory
from sarmitsuba.truth.validation.cases import CASES, CaseEntry
from sarmitsuba.truth.validation.chain import Parameter, bandwidth, chain, make_scene
from sarmitsuba.truth.validation.comparison import Case, Comparison

ANTENNA = 2.0  # m, length of the uniform aperture
FACTOR = 0.4  # of the sliding spotlight
SPOT_PULSES, SPOT_PRF, SPEED = 256, 256.0, 60.0  # an aperture of 60 m from every distance
LOOK_DEG = 40.0


def _scene(slant_range: float, **mode: Parameter) -> Scene:
    """One point at the aim, X band, heading north-east, a range cell of 0.5 m."""
    parameters: dict[str, Parameter] = {
        "slant_range": slant_range,
        "look_angle_deg": LOOK_DEG,
        "heading_deg": 45.0,
        "bandwidth": bandwidth(0.5),
        "center_frequency": 9.65e9,
        "speed": SPEED,
        "image_extent_range": 24.0,
        **mode,
    }
    return make_scene(None, (), parameters, points=(PointTarget("point", np.zeros(3), 1.0),))


def _width(image: SarImage) -> float:
    """Half-power width along the azimuth lobe of the point at the aim, m."""
    return image_quality(image, [KnownPoint((0.0, 0.0, 0.0))], areas=()).points[0].azimuth_cut.irw


def resolution_laws(quick: bool = False) -> Case:
    """Half-power width of the same point in stripmap, sliding spotlight and spotlight over range."""
    ranges = np.array([1500.0, 3000.0] if quick else [1000.0, 1500.0, 2000.0, 3000.0, 5000.0])
    beam: dict[str, Parameter] = {
        "pattern": "rectangular",
        "antenna_length": ANTENNA,
        "elevation_beamwidth_deg": 20.0,
    }
    modes: dict[str, dict[str, Parameter]] = {
        "stripmap": {**beam, "azimuth_resolution": theory.beam_cell(ANTENNA), "image_extent_azimuth": 40.0},
        "sliding_spotlight": {
            **beam,
            "azimuth_resolution": theory.beam_cell(ANTENNA, FACTOR),
            "sliding_factor": FACTOR,
            "image_extent_azimuth": 16.0,
        },
        "spotlight": {"n_pulses": SPOT_PULSES, "prf": SPOT_PRF, "image_extent_azimuth": 30.0},
    }
    # the beam's two-way pattern over the band of the cell D / 2 widens 0.8859 cells to 1.14
    wavelength = _scene(ranges[0], **modes["spotlight"]).radar.waveform.wavelength
    cell = theory.beam_cell(ANTENNA)
    taper = theory.beam_taper(ANTENNA, wavelength)
    tapered = theory.half_power_width(wavelength, wavelength / (4.0 * cell), taper)
    length = SPOT_PULSES / SPOT_PRF * SPEED
    flat = theory.half_power_width(wavelength, wavelength / 4.0)  # of a cell of 1 m
    laws = {
        "stripmap": (f"stripmap, D = {ANTENNA:g} m: D / 2", np.full(ranges.size, tapered)),
        "sliding_spotlight": (
            f"sliding spotlight, A = {FACTOR:g}: A D / 2",
            np.full(ranges.size, FACTOR * tapered),
        ),
        "spotlight": (
            f"spotlight, L = {length:g} m: lambda R / 2 L",
            flat * np.array([theory.aperture_cell(wavelength, float(r), length) for r in ranges]),
        ),
    }
    comparisons = []
    for mode, (label, law) in laws.items():
        widths = [_width(chain(_scene(float(r), mode=mode, **modes[mode]))) for r in ranges]
        comparisons.append(
            Comparison(
                label,
                ranges / 1e3,
                law,
                np.asarray(widths),
                tolerance=0.01 * float(law.min()),
                reason="1 per cent of the width: a whole number of pulses, and the width's interpolation",
                unit="m",
                shown=ranges.size - 1,
            )
        )
    return Case(
        name="resolution_laws",
        topic="modes",
        title="Azimuth resolution of stripmap, sliding spotlight and spotlight",
        formula="A D / 2 and lambda R / 2 L times the half-power width of the aperture's taper, "
        f"{tapered / cell:.3f} (beam) and {flat:.3f} (uniform)",
        source="Cumming & Wong 2005, ch. 4; Prats et al. 2010",
        x_label="slant range (km)",
        y_label="half-power width in azimuth (m)",
        comparisons=tuple(comparisons),
        note="The same point in three modes, focused by backprojection with automatic tracks and no window.",
    )


def circular_response(quick: bool = False) -> Case:
    """Image of a point from a whole circle about the scene against the Bessel function."""
    comparisons = []
    draws = [(1.3e9, 50.0, 0.5), (5.4e9, 30.0, 2.0)]
    if not quick:
        draws += [(0.4e9, 65.0, 0.5), (9.65e9, 45.0, 4.0)]
    for frequency, look, cell in draws:
        wave = SPEED_OF_LIGHT / frequency
        extent = 8.0 * wave / np.sin(np.radians(look))
        place = np.array([0.11, -0.07, 0.0]) * extent  # off the grid and off the middle
        scene = make_scene(
            None,
            (),
            {
                "mode": "circular",
                "slant_range": 2000.0,
                "look_angle_deg": look,
                "heading_deg": 70.0,
                "center_frequency": frequency,
                "bandwidth": bandwidth(cell),
                "image_extent_azimuth": extent,
                "image_extent_range": extent,
            },
            points=(PointTarget("point", place, 1.0),),
        )
        image = focus(
            simulate(scene), request=scene.image, range_window="rectangular", azimuth_window="rectangular"
        )
        away = np.linalg.norm(image.grid.positions() - place, axis=-1).ravel()
        order = np.argsort(away)[:: max(1, away.size // 600)]
        radar = scene.radar
        closed = theory.circular_response(
            away[order], np.radians(look), wave, radar.waveform.bandwidth / frequency
        )
        comparisons.append(
            Comparison(
                f"{frequency / 1e9:g} GHz, look angle {look:g} deg",
                away[order] * np.sin(np.radians(look)) / wave,
                closed,
                image.total().ravel()[order].real.astype(np.float64),
                tolerance=3e-3,
                reason="the point lies off the circle's axis: its look angles differ over the circle",
                unit="",
                shown=0,
            )
        )
    return Case(
        name="circular_response",
        topic="modes",
        title="Response of a point to a whole circle",
        formula="mean over the band of J0(4 pi f r sin(look) / c)",
        source="Soumekh, Synthetic Aperture Radar Signal Processing with MATLAB Algorithms, 1999, ch. 7",
        x_label="distance from the point times sin(look angle) over wavelength",
        y_label="amplitude",
        comparisons=tuple(comparisons),
        note="Every pixel of the image about an ideal point off the middle; automatic prf, backprojection.",
    )


CASES.register(CaseEntry("resolution_laws", "modes", resolution_laws))
CASES.register(CaseEntry("circular_response", "modes", circular_response))
