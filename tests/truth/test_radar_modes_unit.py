"""Steering laws, tracks and footprints of the radar modes."""

from dataclasses import replace

import numpy as np
import pytest

from sarmitsuba.analysis.image_quality import image_quality
from sarmitsuba.core.errors import DataError, RadarError
from sarmitsuba.loading.load import load_scene
from sarmitsuba.radar.builder import build_radar
from sarmitsuba.radar.description import RadarInput
from sarmitsuba.radar.image_request import Extent
from sarmitsuba.radar.radar import Radar
from sarmitsuba.radar.swath import illuminate_points, outline
from sarmitsuba.scene.geometry import PointTarget
from sarmitsuba.scene.scene import Scene
from sarmitsuba.simulation.execution.render import simulate
from sarmitsuba.truth.validation.chain import make_scene
from sarmitsuba.view.notebook import scene_plan
from tests.support.unweighted import focus, render

GAUSSIAN = {"pattern": "gaussian", "azimuth_beamwidth_deg": 2.0, "elevation_beamwidth_deg": 6.0}
IMAGE = {"image_extent_azimuth": 120.0, "image_extent_range": 80.0}


def radar_of(film: dict | None = None, **sensor: object) -> Radar:
    extent = Extent.of_box(np.array([-60.0, -60.0, 0.0]), np.array([60.0, 60.0, 5.0]))
    usual = {} if "orbit_altitude" in sensor else {"slant_range": 5e3, "look_angle_deg": 40.0}
    given = {**usual, **sensor}
    return build_radar(RadarInput.read(given, IMAGE if film is None else film), extent)[0]


@pytest.mark.parametrize("seed", [1, 2, 3])
def test_the_beam_turns_about_the_point_of_its_sliding_factor(seed: int) -> None:
    rng = np.random.default_rng(seed)
    factor, squint = rng.uniform(0.2, 0.9), rng.uniform(-12.0, 12.0)
    drawn = {
        "heading_deg": rng.uniform(-180.0, 180.0),
        "look_side": str(rng.choice(["left", "right"])),
        "squint_angle_deg": squint,
        "azimuth_resolution": 0.8,
    }
    radar = radar_of(mode="sliding_spotlight", sliding_factor=factor, **drawn, **GAUSSIAN)
    # where lines of sight meet: least squares over their normal planes
    line, position = radar.pointing.boresight, radar.track.position
    across = np.eye(3) - line[:, :, None] * line[:, None, :]
    meet = np.linalg.solve(across.sum(axis=0), np.einsum("nij,nj->i", across, position))
    distance = float(np.linalg.norm(meet - radar.track.center_position))
    assert distance == pytest.approx(
        5e3 / (1.0 - factor), rel=1e-6
    )  # tol: conditioning of nearly parallel lines
    assert radar.footprint_speed == pytest.approx(factor, rel=1e-4)  # tol: differences over two pulses
    # at the aim point's distance from the track the footprint has moved so many times as far as the antenna
    along = radar.track.along
    closest = 5e3 * np.cos(np.radians(squint))
    sine = line @ along
    spot = position @ along + closest * sine / np.sqrt(1.0 - sine**2)
    assert np.ptp(spot) / np.ptp(position @ along) == pytest.approx(factor, rel=1e-9)  # tol: rounding


def test_a_sliding_factor_of_one_is_stripmap() -> None:
    drawn = {"heading_deg": 70.0, "squint_angle_deg": 5.0, "azimuth_resolution": 0.8, **GAUSSIAN}
    strip = radar_of(mode="stripmap", **drawn)
    slid = radar_of(mode="sliding_spotlight", sliding_factor=1.0, **drawn)
    assert slid.half_aperture == pytest.approx(strip.half_aperture, rel=1e-9)  # tol: rounding
    middle = strip.track.center_index
    np.testing.assert_allclose(
        slid.pointing.boresight[0], strip.pointing.boresight[middle], atol=1e-12
    )  # tol: rounding


@pytest.mark.parametrize("squint", [0.0, 10.0])
def test_a_sliding_track_holds_the_aperture_of_every_corner(squint: float) -> None:
    drawn = {"mode": "sliding_spotlight", "sliding_factor": 0.4, "azimuth_resolution": 0.5}
    radar = radar_of(squint_angle_deg=squint, heading_deg=200.0, **drawn, **GAUSSIAN)
    axes = np.stack([radar.track.along, radar.across])
    offsets = []
    for corner in np.array([[60.0, 40.0], [60.0, -40.0], [-60.0, 40.0], [-60.0, -40.0]]) @ axes:
        line = corner - radar.track.position
        sine = line @ radar.track.along / np.linalg.norm(line, axis=1)
        offsets.append(sine - radar.pointing.boresight @ radar.track.along)
    first, last = np.array(offsets)[:, 0], np.array(offsets)[:, -1]
    assert (first >= radar.half_aperture).all() and (last <= -radar.half_aperture).all()
    # and is no longer than that: the worst corner's aperture begins or ends with the track
    spare = np.concatenate([first, -last]).min() / radar.half_aperture
    assert spare < 1.01  # tol: two pulses more, and rows of the box between these corners


def test_a_beam_that_never_passes_the_image_is_refused() -> None:
    with pytest.raises(
        RadarError, match=r"0\.001 of the antenna's speed and never passes over the whole image"
    ):
        radar_of(mode="sliding_spotlight", sliding_factor=0.001, azimuth_resolution=0.5, **GAUSSIAN)


def test_frequency_domain_focusers_take_a_beam_that_turns() -> None:
    parameters = {
        "mode": "sliding_spotlight",
        "slant_range": 2e3,
        "azimuth_resolution": 1.0,
        "image_extent_azimuth": 20.0,
        "image_extent_range": 20.0,
        **GAUSSIAN,
    }
    scene = make_scene(None, (), parameters, points=[PointTarget("p", np.zeros(3), 1.0)])
    raw = simulate(scene)
    exact = focus(raw, request=scene.image, focuser="backprojection")
    for name in ("omega_k", "range_doppler", "chirp_scaling"):
        image = focus(raw, request=scene.image, focuser=name)
        error = np.linalg.norm(image.data - exact.data) / np.linalg.norm(exact.data)
        assert 20.0 * np.log10(error) < -32.0  # tol: a time-bandwidth product of 18
    assert focus(raw, request=scene.image, focuser="auto,error=-50").metadata["focus"]["method"] in (
        "backprojection",
        "factorised",
    )


def test_a_circle_is_level_closed_and_looks_at_its_axis() -> None:
    radar = radar_of(mode="circular", heading_deg=30.0, look_side="left", center_frequency=1e9)
    track, n = radar.track, radar.track.n_pulses
    out = track.position - radar.aim_point
    np.testing.assert_allclose(np.linalg.norm(out, axis=1), 5e3, rtol=1e-12)  # tol: rounding
    np.testing.assert_allclose(out[:, 2], 5e3 * np.cos(np.radians(40.0)), rtol=1e-12)  # tol: rounding
    np.testing.assert_allclose(radar.pointing.boresight, -out / 5e3, atol=1e-12)  # tol: rounding
    np.testing.assert_allclose(np.einsum("ij,ij->i", track.velocity, out), 0.0, atol=1e-6)  # tol: rounding
    np.testing.assert_allclose(np.linalg.norm(track.velocity, axis=1), 100.0, rtol=1e-12)  # tol: rounding
    # every step is the same, that from the last pulse to the first too; the aim point on the left: anticlockwise
    angle = np.unwrap(np.arctan2(out[:, 1], out[:, 0]))
    np.testing.assert_allclose(np.diff(angle), 2.0 * np.pi / n, rtol=1e-9)  # tol: rounding
    heading = np.array([np.sin(np.radians(30.0)), np.cos(np.radians(30.0)), 0.0])
    half = 0.5 * (track.velocity[n // 2] + track.velocity[(n - 1) // 2])
    np.testing.assert_allclose(half / np.linalg.norm(half), heading, atol=1e-12)  # tol: rounding
    arc = radar_of(mode="circular", arc_deg=90.0, n_pulses=151, center_frequency=1e8, bandwidth=5e7)
    swept = np.ptp(np.unwrap(np.arctan2(*(arc.track.position - arc.aim_point)[:, 1::-1].T)))
    assert np.degrees(swept) == pytest.approx(90.0 * 150 / 151, rel=1e-9)  # tol: rounding
    assert not arc.all_round and radar.all_round


def test_the_pulses_of_a_circle_sample_the_image_at_every_instant() -> None:
    radar = radar_of(mode="circular", center_frequency=1e9)
    corners = np.array([[60.0, 40.0, 0.0], [60.0, -40.0, 0.0], [-60.0, 40.0, 0.0], [-60.0, -40.0, 0.0]])
    corners[:, :2] = corners[:, :2] @ np.stack([radar.track.along, radar.across])[:, :2]
    line = corners[:, None] - radar.track.position
    line /= np.linalg.norm(line, axis=-1, keepdims=True)
    doppler = 2.0 / radar.waveform.wavelength * np.einsum("pnc,nc->pn", line, radar.track.velocity)
    prf = 1.0 / np.diff(radar.track.time).mean()
    assert 1.0 < prf / np.ptp(doppler, axis=0).max() < 1.4  # tol: a margin of 1.25, and the box's height


@pytest.mark.parametrize(
    ("sensor", "film", "line"),
    [
        ({"squint_angle_deg": 5.0}, {}, "squint_angle_deg = 5 deg, but mode = circular has no squint"),
        ({}, {"image_grid": "slant"}, "image_grid = slant, but mode = circular looks from all sides"),
        (
            {"azimuth_resolution": 1.0},
            {},
            "azimuth_resolution = 1 m has no effect with mode = circular, whose arc_deg",
        ),
        ({"n_pulses": 10, "prf": 1.0}, {}, "n_pulses = 10 and prf = 1 Hz set the length of the track"),
        ({"mode": "spotlight", "arc_deg": 90.0}, {}, "arc_deg has no effect with mode = spotlight"),
        (
            {"orbit_altitude": 5e5, "incidence_angle_deg": 35.0},
            {},
            "orbit_altitude has no effect with mode = circular",
        ),
    ],
)
def test_what_a_circle_cannot_do_is_said_in_a_line(sensor: dict, film: dict, line: str) -> None:
    given = {"mode": "circular", **sensor}
    with pytest.raises(RadarError, match=line):
        radar_of(film=film, **given)


def test_one_look_and_lobes_are_refused_all_round() -> None:
    parameters = {"mode": "circular", "slant_range": 500.0, "center_frequency": 0.3e9, "bandwidth": 100e6}
    scene = make_scene(
        None,
        (),
        {**parameters, "image_extent_azimuth": 3.0, "image_extent_range": 3.0},
        points=[PointTarget("p", np.zeros(3), 1.0)],
    )
    for method in ("image", "raster"):
        with pytest.raises(RadarError, match=f"method {method} takes one look, but the track goes round"):
            render(scene, method=method)
    image = render(scene)
    with pytest.raises(DataError, match="a circular aperture has no carrier"):
        image_quality(image)


@pytest.mark.parametrize("seed", [1, 2, 3])
def test_the_outline_is_the_half_power_contour_on_the_ground(seed: int) -> None:
    rng = np.random.default_rng(seed)
    look, widths = rng.uniform(25.0, 55.0), rng.uniform(1.0, 6.0, 2)
    drawn = {
        "heading_deg": rng.uniform(-180.0, 180.0),
        "look_side": str(rng.choice(["left", "right"])),
        "look_angle_deg": look,
        "azimuth_beamwidth_deg": widths[0],
        "elevation_beamwidth_deg": widths[1],
    }
    for pattern in ("gaussian", "rectangular"):
        radar = radar_of(mode="stripmap", pattern=pattern, **drawn)
        edge = outline(radar, radar.track.center_index, height=2.0)
        np.testing.assert_allclose(edge[:, 2], 2.0, atol=1e-9)  # tol: rounding
        np.testing.assert_array_equal(edge[0], edge[-1])
        # along the track R tan(theta / 2) off, across it where the ray at look +- theta / 2 comes down
        foot = radar.track.position[radar.track.center_index]
        height = foot[2] - 2.0
        x, y = (edge - foot) @ radar.track.along, (edge - foot) @ radar.across
        near, far = (height * np.tan(np.radians(look + s * 0.5 * widths[1])) for s in (-1.0, 1.0))
        assert (y.min(), y.max()) == pytest.approx((near, far), rel=1e-6)  # tol: the contour's nodes
        reach = height / np.cos(np.radians(look)) * np.tan(np.radians(0.5 * widths[0]))
        assert x[0] == pytest.approx(reach, rel=1e-9)  # tol: rounding


def test_what_has_its_whole_aperture() -> None:
    beam = {"azimuth_resolution": 1.5, **GAUSSIAN}
    strip = radar_of(mode="stripmap", heading_deg=40.0, **beam)
    flown = float(np.linalg.norm(np.ptp(strip.track.position, axis=0)))
    aperture = 2.0 * 5e3 * strip.half_aperture
    x = np.linspace(-300.0, 300.0, 401)
    got = illuminate_points(strip, x[:, None] * strip.track.along)
    half = 0.5 * (flown - aperture)
    # tol: steps of 1.5 m
    assert np.ptp(x[got.whole]) == pytest.approx(2.0 * half, abs=5.0)
    wide = 0.5 * flown + 5e3 * np.tan(np.radians(1.0))
    assert np.ptp(x[got.ever]) == pytest.approx(min(2.0 * wide, 600.0), abs=5.0)
    spot = radar_of(mode="spotlight", **beam)
    held = illuminate_points(spot, x[:, None] * spot.track.along)
    assert np.ptp(x[held.whole]) == pytest.approx(2.0 * 5e3 * np.tan(np.radians(1.0)), abs=6.0)
    with pytest.raises(RadarError, match="isotropic illuminates everything and has no outline"):
        outline(replace(spot, antenna=radar_of().antenna), 0)


def test_plans_show_the_beam() -> None:
    parameters = {"slant_range": 5e3, "azimuth_resolution": 1.0, **IMAGE}
    points = [PointTarget("p", np.zeros(3), 1.0)]
    plain = make_scene(None, (), parameters, points=points)
    with_beam = make_scene(None, (), {**parameters, **GAUSSIAN}, points=points)
    bare, beam, whole = (
        scene_plan(s, whole_beam=w).axes[0]
        for s, w in ((plain, False), (with_beam, False), (with_beam, True))
    )
    assert len(beam.lines) == len(bare.lines) + 3  # first, middle and last pulse
    assert beam.get_xlim() == bare.get_xlim()
    edge = outline(with_beam.radar, 0)
    assert whole.get_xlim()[0] < edge[:, 0].min() and whole.get_ylim()[0] < edge[:, 1].min()


@pytest.mark.parametrize("radar", ["spaceborne_x", "drone_ku", "sentinel1_stripmap"])
def test_spare_pulses_of_small_images_are_said(radar: str) -> None:
    """The note's number is what a spotlight without prf has, and larger images have no note."""

    def loaded(**other: str) -> Scene:
        size = dict.fromkeys(["range_film.image_extent_azimuth", "range_film.image_extent_range"], "20")
        return load_scene("trihedral", radar=radar, parameters={**size, **other})

    small = loaded()
    (note,) = (note for note in small.notes if "pulses, where an image" in note)
    assert f"gives {small.radar.track.n_pulses} pulses" in note
    spotlight = loaded(**{"sar_antenna.mode": "spotlight", "sar_antenna.prf": "0"})
    assert f"20 m in azimuth needs {spotlight.radar.track.n_pulses} at" in note
    assert small.radar.track.n_pulses >= 10 * spotlight.radar.track.n_pulses
    wide = (
        {"range_film.image_extent_azimuth": "3000"}
        if radar != "drone_ku"
        else {"sar_antenna.n_pulses": "900"}
    )
    for other in (spotlight, loaded(**wide, **({"sar_antenna.prf": "0"} if radar == "drone_ku" else {}))):
        assert not any("pulses, where an image" in note for note in other.notes)
