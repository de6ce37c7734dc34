"""Compact polarimetry: circular or slanted transmit is the sum of the linear channels, ray by ray."""

from dataclasses import replace
from typing import Literal

import numpy as np
import pytest

from sarmitsuba.core.arrays import C128
from sarmitsuba.core.errors import RadarError
from sarmitsuba.effects.flags import KernelFlags
from sarmitsuba.effects.plan import plan_effects
from sarmitsuba.radar.polarisation import COMPACT, LINEAR, isotropic_response
from sarmitsuba.scene.geometry import Geometry, PointTarget
from sarmitsuba.scene.materials.material import Material
from sarmitsuba.scene.settings import TraceSettings
from sarmitsuba.signal.image import SarImage
from sarmitsuba.simulation.execution.path_table import trace_paths
from sarmitsuba.simulation.execution.rcs import monostatic_rcs
from sarmitsuba.simulation.execution.render import simulate
from sarmitsuba.truth.validation.chain import Parameter, make_scene
from sarmitsuba.truth.validation.targets import PEC, geometry, parallelogram, plate
from tests.support.unweighted import render

FREQUENCY = 9.65e9
ROUGH = Material(
    "rough",
    permittivity=5.3 - 0.3j,
    rms_height=2e-3,
    correlation_length=0.02,
    diffuse_law="small_slope",
    cross_polar_ratio_db=-12.0,
)
# written out apart from the program: (h, v) of the waves sent, IEEE sense for exp(+j w t), h x v towards the radar
SENT = {"R": (1.0, 1j), "L": (1.0, -1j), "D": (1.0, 1.0)}


def combined(quad: C128, channel: str) -> C128:
    """A compact channel from HH, HV, VH, VV in the last axis."""
    h, v = SENT[channel[0]]
    column = "HV".index(channel[1])
    return np.asarray((h * quad[..., column] + v * quad[..., 2 + column]) / np.sqrt(2.0))


def corner(rng: np.random.Generator) -> Geometry:
    """Ground, a wall turned about the vertical, and a leaning plate; metal and rough by chance."""
    turn, lean = np.radians(rng.uniform(-40.0, 40.0)), np.radians(rng.uniform(-20.0, 20.0))
    normal = np.array([np.cos(turn), np.sin(turn), 0.0])
    along = np.array([-np.sin(turn), np.cos(turn), 0.0])
    up = np.array([0.0, 0.0, 1.0])
    wall = parallelogram(-0.4 * along, 0.8 * along, 0.6 * up)
    ground = parallelogram(-0.4 * along, 1.5 * normal, 0.8 * along)
    side = parallelogram(-0.4 * along, 0.6 * normal, 0.6 * (np.cos(lean) * up + np.sin(lean) * along))
    return geometry([wall, ground, side], rng.integers(0, 2, 3).tolist())


@pytest.mark.parametrize("depth", [1, 3])
@pytest.mark.parametrize("seed", [0, *(pytest.param(seed, marks=pytest.mark.slow) for seed in (1, 2))])
def test_compact_channels_are_sums_of_the_linear_ones(seed: int, depth: int) -> None:
    """Metal and rough, one bounce to three; the beam, the taper and the phases are the same."""
    rng = np.random.default_rng([seed, depth])
    shape = corner(rng)
    theta, azimuth = np.radians(rng.uniform(25.0, 65.0)), np.radians(rng.uniform(-30.0, 30.0, 4))
    look = np.stack(
        [np.sin(theta) * np.cos(azimuth), np.sin(theta) * np.sin(azimuth), np.full(4, np.cos(theta))], axis=-1
    )

    def traced(channels: tuple[str, ...]) -> C128:
        flags = KernelFlags(channels=channels, antenna_pattern=False, taper=False, multi_bounce=depth > 1)
        result = monostatic_rcs(
            shape,
            (PEC[0], ROUGH),
            look,
            FREQUENCY,
            channels=channels,
            max_depth=depth,
            flags=flags,
            ray_spacing=0.02,
        )
        return result.amplitude[:, 0]

    quad = traced(LINEAR)
    for channels in (("RH", "RV"), ("LV", "DH", "DV")):
        compact = traced(channels)
        for i, channel in enumerate(channels):
            expected = combined(quad, channel)
            # tol: float32 sums of some 5000 returns that cancel in part
            assert compact[:, i] == pytest.approx(expected, abs=2e-5 * float(np.abs(quad).max()))
            assert np.abs(expected).min() > 1e-3 * np.abs(quad).max()


def test_the_sense_is_that_of_the_ieee() -> None:
    """Right-handed: for who looks along the wave it turns clockwise, from up (v) to the right (h), in exp(+j w t)."""
    look = np.array([0.0, 1.0, 0.0])
    h = np.cross(look, [0.0, 0.0, 1.0])
    v = np.cross(h, look)
    # what a trihedral returns in RH and RV is the wave sent, in the same h and v
    sent = isotropic_response("RH") * h + isotropic_response("RV") * v
    a, b = sent.real, (sent * 1j).real  # at w t = 0 and a quarter of a period later
    assert np.cross(a, b) @ look > 0.0  # thumb along the wave, fingers with the field
    assert np.linalg.norm(sent) == pytest.approx(1.0)
    other = isotropic_response("LH") * h + isotropic_response("LV") * v
    assert np.vdot(sent, other) == pytest.approx(0.0)


def test_one_bounce_carries_one_field_and_more_bounces_two() -> None:
    """A compact pair costs no more fields than a linear pair of the same reciprocity."""
    flags = KernelFlags(channels=("RH", "RV"))
    assert replace(flags, multi_bounce=False).tracked == ("R",)
    assert replace(flags, multi_bounce=False).closed == ("RH", "RV")
    assert flags.tracked == ("H", "V")
    assert flags.closed == LINEAR[::2] + LINEAR[1::2]
    for channels in (LINEAR, ("VV",), ("HV", "HH")):
        assert replace(flags, channels=channels).closed == channels


def test_compact_channels_are_cross_polar_to_the_plan() -> None:
    """Sent and received polarisation differ: the effect is on, and switching it off leaves nothing to record."""
    scene = make_scene(plate(4.0, 4.0), (ROUGH,), {"slant_range": 1000.0, "polarisation": "RH,RV"})
    plan = plan_effects(scene)
    assert plan.flags.channels == ("RH", "RV") and plan.flags.depolarisation
    off = replace(scene, settings=TraceSettings(effects={"cross_polarisation": "off"}))
    with pytest.raises(RadarError, match="leaves none of the channels RH, RV; add HH or VV"):
        plan_effects(off)


def test_an_isotropic_point_through_raw_data_and_the_path_table() -> None:
    """HH = VV = 1, HV = VH = 0: RH = 1/sqrt 2, RV = j/sqrt 2, in the signal and in the list of paths."""
    point = PointTarget("p", np.array([0.4, -0.3, 0.2]), 2.0)
    common = {"slant_range": 2000.0, "azimuth_resolution": 1.0, "bandwidth": 150e6}
    names = ("VV", "HV", *COMPACT)
    scene = make_scene(None, (), {**common, "polarisation": ",".join(names)}, points=(point,))
    raw = simulate(scene)
    co = raw.total("VV").astype(np.complex128)
    for name in COMPACT:
        linear = np.stack([co, np.zeros_like(co), np.zeros_like(co), co], axis=-1)
        # tol: float32
        assert np.abs(raw.total(name) - combined(linear, name)).max() < 1e-6 * np.abs(co).max()
    assert np.abs(raw.total("HV")).max() == 0.0
    table = trace_paths(scene, pulses=[0])
    row = dict(zip(table.channels, table.amplitude[0], strict=True))
    linear = np.array([row["VV"], 0.0, 0.0, row["VV"]])
    assert len(table) == 1 and row["HV"] == 0.0
    for name in COMPACT:
        assert row[name] == pytest.approx(combined(linear, name))


@pytest.mark.filterwarnings(
    "ignore::sarmitsuba.core.errors.SarmitsubaWarning"
)  # a scene smaller than its image
@pytest.mark.parametrize("method", ["hybrid", pytest.param("image", marks=pytest.mark.slow)])
def test_images_of_compact_channels_are_sums_of_the_linear_ones(method: Literal["hybrid", "image"]) -> None:
    """Whole chain with automatic settings; the plan may see another set of channels, the rays are the same."""
    common: dict[str, Parameter] = {
        "slant_range": 1000.0,
        "look_angle_deg": 40.0,
        "heading_deg": 180.0,
        "azimuth_resolution": 1.0,
        "bandwidth": 150e6,
        "image_extent_azimuth": 12.0,
        "image_extent_range": 12.0,
    }
    shape = corner(np.random.default_rng(8))

    def made(channels: tuple[str, ...]) -> SarImage:
        scene = make_scene(
            shape,
            (PEC[0], ROUGH),
            {**common, "polarisation": ",".join(channels)},
            settings=TraceSettings(method=method, max_depth=2),
        )
        return render(scene)

    quad_image, compact = made(LINEAR), made(("RH", "RV"))
    quad = np.stack([quad_image.total(c) for c in LINEAR], axis=-1).astype(np.complex128)
    for channel in ("RH", "RV"):
        expected = combined(quad, channel)
        # tol: float32 sums and the packed grid's rounding
        assert np.abs(compact.total(channel) - expected).max() < 1e-4 * np.abs(expected).max()


@pytest.mark.filterwarnings("ignore::sarmitsuba.core.errors.SarmitsubaWarning")  # no speckle, on purpose
def test_the_raster_shares_power_between_compact_channels() -> None:
    """Incoherent: RH = (HH + HV) / 2, RV = (HV + VV) / 2 in power, for every pixel without its speckle."""
    common: dict[str, Parameter] = {
        "slant_range": 1000.0,
        "look_angle_deg": 40.0,
        "azimuth_resolution": 1.0,
        "bandwidth": 150e6,
        "image_extent_azimuth": 12.0,
        "image_extent_range": 12.0,
        "polarisation": "HH,HV,VH,VV,RH,RV",
    }
    scene = make_scene(
        plate(40.0, 40.0),
        (ROUGH,),
        common,
        settings=TraceSettings(method="raster", max_depth=1, effects={"speckle": "off"}),
    )
    power = {name: render(scene).rcs(name) for name in scene.radar.channels}
    assert power["RH"] == pytest.approx(0.5 * (power["HH"] + power["VH"]), rel=1e-4)
    assert power["RV"] == pytest.approx(0.5 * (power["HV"] + power["VV"]), rel=1e-4)
    assert power["HV"].mean() > 0.01 * power["HH"].mean()
