import warnings
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from sarmitsuba.core.constants import SPEED_OF_LIGHT
from sarmitsuba.core.errors import ExtensionError, RadarError, SarmitsubaWarning
from sarmitsuba.radar.builder import build_radar
from sarmitsuba.radar.description import RadarInput
from sarmitsuba.radar.image_request import Extent
from sarmitsuba.radar.mode import MODES, AimGeometry

SMALL = np.array([[-1.0, -1.0, 0.0], [1.0, 1.0, 1.0]])


def described(film: dict | None = None, folder: Path = Path(), **sensor: object) -> RadarInput:
    film = film or {}
    return RadarInput.read(
        sensor,
        film,
        'scene.xml: sensor "radar"',
        "scene.xml: film range_film",
        folder,
    )


def build(bounds: np.ndarray = SMALL, film: dict | None = None, **sensor: object):
    return build_radar(described(film, **sensor), Extent.of_box(*bounds))


def test_broadside_geometry() -> None:
    radar, _, _ = build(slant_range=10e3, look_angle_deg=30.0, heading_deg=90.0, look_side="left")
    # flying east, looking left (north): the antenna stands south of the aim point
    np.testing.assert_allclose(
        radar.track.center_position, [0.0, -5000.0, 10e3 * np.cos(np.pi / 6)], atol=1e-9
    )  # tol: rounding
    np.testing.assert_allclose(radar.track.along, [1, 0, 0], atol=1e-12)  # tol: rounding
    np.testing.assert_allclose(radar.across, [0, 1, 0], atol=1e-12)  # tol: rounding
    assert radar.look_side == "left"


def test_squint_and_look_angle_are_what_they_say() -> None:
    radar, _, _ = build(squint_angle_deg=15.0, look_angle_deg=40.0, heading_deg=33.0)
    sight = -radar.track.center_position / 10e3
    along = np.array([np.sin(np.radians(33)), np.cos(np.radians(33)), 0])
    assert np.linalg.norm(radar.track.center_position) == pytest.approx(10e3, rel=1e-12)  # tol: rounding
    assert np.degrees(np.arcsin(sight @ along)) == pytest.approx(15.0, rel=1e-10)  # tol: rounding
    assert np.degrees(np.arccos(-sight[2])) == pytest.approx(40.0, rel=1e-10)  # tol: rounding
    assert sight @ np.array([along[1], -along[0], 0]) > 0  # to the right


def test_squint_beyond_the_look_angle_is_refused() -> None:
    with pytest.raises(
        RadarError, match="squint_angle_deg = 45 deg is not smaller than look_angle_deg = 30 deg"
    ):
        build(squint_angle_deg=45.0, look_angle_deg=30.0)


def test_aperture_gives_the_resolution_asked_for() -> None:
    radar, _, _ = build(azimuth_resolution=0.25)
    prf = 1.0 / np.diff(radar.track.time)[0]
    length = radar.track.n_pulses * 100.0 / prf
    cell = radar.waveform.wavelength * 10e3 / (2 * length)
    assert cell == pytest.approx(0.25, rel=1.0 / radar.track.n_pulses)  # tol: whole number of pulses


def test_automatic_prf_covers_the_doppler_bandwidth() -> None:
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        for sensor in ({}, {"n_pulses": 300}, {"mode": "spotlight"}, {"squint_angle_deg": 20.0}):
            build(np.array([[-100.0, -50, 0], [100, 50, 20]]), **sensor)


def test_prf_follows_from_pulses_and_resolution() -> None:
    radar, _, _ = build(n_pulses=1000, azimuth_resolution=0.5)
    length = radar.waveform.wavelength * 10e3 / (2 * 0.5)
    assert 1.0 / np.diff(radar.track.time)[0] == pytest.approx(
        1000 * 100.0 / length, rel=1e-9
    )  # tol: rounding


def test_an_aperture_described_twice_is_refused() -> None:
    with pytest.raises(RadarError, match="describe the aperture twice"):
        build(n_pulses=100, prf=500.0, azimuth_resolution=0.5)


def test_a_low_prf_is_said() -> None:
    with pytest.warns(
        SarmitsubaWarning,
        match=r"^scene.xml: sensor \"radar\": prf = 20 Hz is below .* Hz of the image; raise prf to .* Hz, or narrow",
    ):
        build(prf=20.0)


def test_a_narrow_beam_needs_less_prf() -> None:
    wide = np.array([[-900.0, -50, 0], [900, 50, 20]])
    film = {"image_extent_azimuth": 1800.0, "image_extent_range": 200.0}
    beam = {"pattern": "gaussian", "azimuth_beamwidth_deg": 1.0, "elevation_beamwidth_deg": 5.0}
    isotropic, _, _ = build(wide, film)
    narrow, _, _ = build(wide, film, **beam)
    assert np.diff(narrow.track.time)[0] > 2 * np.diff(isotropic.track.time)[0]


def test_range_ambiguity_is_said() -> None:
    with pytest.warns(SarmitsubaWarning, match="longer than the unambiguous range"):
        build(slant_range=5e5, prf=1e5, n_pulses=10, pulse_width=2e-5)


def test_window_holds_the_scene_and_its_multiple_bounces() -> None:
    box = np.array([[-50.0, -50, 0], [50, 50, 30]])
    radar, image, _ = build(box)
    corners = np.array([[x, y, z] for x in box[:, 0] for y in box[:, 1] for z in box[:, 2]])
    ranges = np.linalg.norm(corners[None] - radar.track.position[::50, None], axis=2)
    start = radar.window.start_range[::50]
    assert (ranges.min(axis=1) - start > 30.0).all()
    assert (start + radar.window.extent - ranges.max(axis=1) > 30.0).all()
    assert radar.window.sample_spacing == pytest.approx(SPEED_OF_LIGHT / (2 * 1.2 * 300e6))  # tol: rounding
    assert np.ptp(radar.window.start_range) == 0.0
    assert image.extent_azimuth > 100.0


def test_window_follows_a_squinted_aim_point_in_whole_samples() -> None:
    radar, _, _ = build(squint_angle_deg=20.0)
    to_aim = np.linalg.norm(radar.track.position, axis=1)
    assert np.ptp(to_aim) > 50.0
    inside = to_aim - radar.window.start_range
    assert inside.min() > 0 and inside.max() < radar.window.extent
    steps = np.diff(radar.window.start_range) / radar.window.sample_spacing
    np.testing.assert_allclose(steps, np.round(steps), atol=1e-6)  # tol: rounding of 1e4 m over 0.4 m


def test_a_hundred_thousand_pulses_are_no_loop() -> None:
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        radar, _, _ = build(n_pulses=100_000, prf=1000.0, slant_range=1e6)
    assert radar.window.start_range.shape == (100_000,)
    assert radar.pointing.boresight.shape == (100_000, 3)


@pytest.mark.parametrize("mode", ["stripmap", "spotlight"])
def test_pointing_is_an_orthonormal_triad(mode: str) -> None:
    radar, _, _ = build(mode=mode, squint_angle_deg=10.0, n_pulses=64, prf=200.0)
    p = radar.pointing
    triad = np.stack([p.boresight, p.azimuth_axis, p.elevation_axis], axis=1)
    product = np.einsum("nij,nkj->nik", triad, triad)
    np.testing.assert_allclose(
        product, np.broadcast_to(np.eye(3), product.shape), atol=1e-12
    )  # tol: rounding
    assert (p.azimuth_axis @ radar.track.along > 0).all() and (p.elevation_axis[:, 2] > 0).all()
    to_aim = -radar.track.position / np.linalg.norm(radar.track.position, axis=1, keepdims=True)
    off = np.degrees(np.arccos(np.clip(np.einsum("ij,ij->i", p.boresight, to_aim), -1, 1)))
    if mode == "spotlight":
        assert off.max() < 1e-5
    else:
        np.testing.assert_allclose(p.boresight, p.boresight[:1].repeat(64, 0), atol=1e-12)  # tol: rounding
        assert off.max() > 0.05


def test_beamwidth_from_the_aperture_size() -> None:
    radar, _, _ = build(pattern="rectangular", antenna_length=2.0, antenna_height=0.5)
    # half power of sinc^2 at sin(angle) = 0.4429 lambda / L
    assert np.sin(radar.antenna.azimuth_beamwidth / 2) == pytest.approx(
        0.4429465 * radar.waveform.wavelength / 2.0, rel=1e-6
    )  # tol: printed digits


def test_track_file_in_file_coordinates(tmp_path: Path) -> None:
    t = np.arange(40) * 0.01
    rows = np.stack([t, 1e6 - 3000 + 0 * t, 2e6 + 100 * (t - 0.2), 4000 + 0 * t], axis=1)
    np.savetxt(tmp_path / "track.csv", rows, delimiter=",", header="time_s, x_m, y_m, z_m", fmt="%.17g")
    offset = np.array([1e6, 2e6, 0.0])
    given = described(folder=tmp_path, track_file="track.csv", aim_x=1e6, aim_y=2e6)
    radar, image, _ = build_radar(given, Extent.of_box(*SMALL), offset)
    np.testing.assert_allclose(radar.track.position[:, 0], -3000.0, atol=1e-9)  # tol: float64 at 1e6
    assert radar.look_side == "right"
    assert (image.center_x, image.center_y) == (0.0, 0.0)
    with pytest.raises(RadarError, match="prf has no effect beside track_file"):
        build_radar(
            described(folder=tmp_path, track_file="track.csv", prf=5.0), Extent.of_box(*SMALL), offset
        )
    with pytest.raises(RadarError, match="look_side = left, but the aim point"):
        build_radar(
            described(folder=tmp_path, track_file="track.csv", aim_x=1e6, aim_y=2e6, look_side="left"),
            Extent.of_box(*SMALL),
            offset,
        )


@pytest.mark.parametrize(
    ("bounds", "film", "sensor", "text"),
    [
        (
            SMALL,
            {"near_range": 9000.0, "far_range": 9100.0},
            {},
            "does not hold the scene, whose slant ranges",
        ),
        (SMALL, {"near_range": 200.0, "far_range": 100.0}, {}, "near_range = 200 m is not below far_range"),
        (np.add(SMALL, [5e4, 0, 0]), {}, {"aim_x": 0.0}, "they do not overlap; move the aim point"),
        (SMALL, {"image_center_x": 3000.0}, {}, "they do not overlap"),
        (SMALL, {"image_height": 8000.0}, {}, "image_height = 8000 m is not below the antenna at 7071"),
        (SMALL, {"image_center_x": -8000.0}, {}, "on the side it does not look to"),
        (SMALL, {"image_extent_range": 2e4}, {}, "reaches past the ground track"),
        (SMALL, {"sampling_rate": 1e8}, {}, "below the bandwidth"),
        (SMALL, {}, {"polarisation": "HH,HH"}, "is not a list of channels"),
        (SMALL, {}, {"polarisation": ""}, "is not a list of channels"),
        (SMALL, {}, {"azimuth_beamwidth_deg": 2.0}, "no effect with pattern = isotropic"),
        (
            SMALL,
            {},
            {"pattern": "gaussian", "azimuth_beamwidth_deg": 2.0},
            "needs one of elevation_beamwidth_deg",
        ),
        (SMALL, {}, {"azimuth_resolution": 1e-4}, "more than four slant ranges"),
        (
            SMALL,
            {},
            {"n_pulses": 5, "prf": 1e-50},
            "make an aperture of 5e.52 m, more than four slant ranges",
        ),
        (SMALL, {"pixel_spacing_range": 1e-9}, {}, "pixels is larger than"),
        (np.add(SMALL, [0, 0, 8000.0]), {"image_center_x": 0.0}, {"aim_z": 0.0}, "below the whole scene"),
        (SMALL, {}, {"bandwidth": 1e11}, "must be below twice"),
    ],
)
def test_radars_that_cannot_see_are_refused(bounds, film, sensor, text) -> None:
    with pytest.raises(RadarError, match=text) as caught:
        build(bounds, film, **sensor)
    assert "\n" not in str(caught.value)


def test_scene_outside_the_beam_is_refused() -> None:
    beam = {"pattern": "gaussian", "azimuth_beamwidth_deg": 0.2, "elevation_beamwidth_deg": 1.0}
    film = {"image_extent_azimuth": 2000.0, "image_extent_range": 2000.0}
    with pytest.raises(RadarError, match=r"outside the beam, .* deg off in azimuth"):
        build(np.array([[300.0, 300, 0], [310, 310, 5]]), film, aim_x=0.0, aim_y=0.0, **beam)


def test_a_window_that_cuts_the_image_is_said() -> None:
    with pytest.warns(SarmitsubaWarning, match="cuts the image"):
        build(film={"near_range": 10e3})


def test_huge_geometry_gets_a_bounded_image() -> None:
    _, image, notes = build(np.array([[-5000.0, -5000, 0], [5000, 5000, 10]]), azimuth_resolution=0.5)
    assert image.extent_azimuth == pytest.approx(1024.0)  # tol: rounding
    assert any("(image_extent_azimuth); raise image_extent_limit" in note for note in notes)


def test_every_mode_holds_the_beam_on_the_aim_point_at_mid_aperture() -> None:
    assert set(MODES.names) >= {"stripmap", "spotlight"}
    for mode in MODES:
        others = {
            "circular": {"arc_deg": 0.1},
            "scansar": {"prf": 200.0},
            "tops": {"prf": 200.0, "steering_rate_deg": 1.0, **BEAM},
        }
        squint = others.get(mode.name, {"squint_angle_deg": 12.0, "prf": 200.0})
        radar, _, _ = build(mode=mode.name, n_pulses=33, **squint)
        assert radar.mode_law is mode and mode.doc
        sight = -radar.track.center_position / np.linalg.norm(radar.track.center_position)
        np.testing.assert_allclose(radar.pointing.boresight[16], sight, atol=1e-12)  # tol: rounding


@pytest.mark.parametrize("mode", list(MODES), ids=lambda mode: mode.name)
def test_aperture_and_azimuth_cell_are_inverse(mode) -> None:
    geometry = AimGeometry(
        np.zeros(3), np.array([-3e3, -500.0, 4e3]), np.array([0, 1.0, 0]), np.array([1.0, 0, 0])
    )
    length = mode.aperture_length(geometry, 0.03, 0.4)
    assert mode.azimuth_cell(geometry, 0.03, length) == pytest.approx(0.4, rel=1e-12)  # tol: rounding


def test_an_unknown_mode_is_refused_with_the_names() -> None:
    with pytest.raises(RadarError, match=r'mode = "spotligth" is not one of .*; did you mean "spotlight"'):
        build(mode="spotligth")
    radar, _, _ = build()
    with pytest.raises(ExtensionError, match="radar mode 'elsewhere' is unknown"):
        _ = replace(radar, mode="elsewhere").mode_law


BEAM = {"pattern": "gaussian", "azimuth_beamwidth_deg": 4.0, "elevation_beamwidth_deg": 20.0}


@pytest.mark.parametrize("squint", [0.0, 20.0])
@pytest.mark.parametrize("azimuth_beamwidth_deg", [4.0, 0.4])
def test_stripmap_flies_aperture_and_image(squint: float, azimuth_beamwidth_deg: float) -> None:
    # every corner's band, out to the beam's null at most, lies within the track; and nothing is ambiguous
    film = {"image_extent_azimuth": 300.0, "image_extent_range": 200.0}
    beam = {**BEAM, "azimuth_beamwidth_deg": azimuth_beamwidth_deg}
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        radar, _, _ = build(film=film, azimuth_resolution=1.0, squint_angle_deg=squint, **beam)
    # aperture 0.15 km of 1 m cells at 10 km; null of the Gaussian beam of 0.4 deg at 0.0079
    wavelength = radar.waveform.wavelength
    null = np.sin(np.radians(0.5 * azimuth_beamwidth_deg)) / 0.442946 * np.cos(np.radians(squint))
    half = min(0.5 * wavelength / 2.0 * np.cos(np.radians(squint)), null)
    assert radar.half_aperture == pytest.approx(half, rel=1e-3)  # tol: sine for angle
    for x in (-100.0, 100.0):
        for y in (-150.0, 150.0):
            line = np.array([x, y, 0.0]) - radar.track.position
            sine = line @ radar.track.along / np.linalg.norm(line, axis=1)
            offset = sine - np.sin(np.radians(squint))
            assert offset.max() > half and offset.min() < -half
    flown = float(np.linalg.norm(np.ptp(radar.track.position, axis=0)))
    needed = 300.0 + 2.0 * half * 10e3 / np.cos(np.radians(squint)) ** 3
    # squint shears the image: 100 m across by the tangent over the sine of the look angle, on both sides
    needed += 2.0 * 100.0 * np.sin(np.radians(45.0)) * np.tan(np.radians(squint))
    assert flown == pytest.approx(needed, rel=0.05)  # tol: the image's own spread of ranges


def test_one_aperture_for_all_keeps_its_track() -> None:
    film = {"image_extent_azimuth": 300.0, "image_extent_range": 200.0}
    short, _, _ = build(film=film, azimuth_resolution=1.0)
    given, _, _ = build(film=film, n_pulses=256, **BEAM)
    spot, _, _ = build(film=film, azimuth_resolution=1.0, mode="spotlight", **BEAM)
    for radar in (short, given, spot):
        assert np.isinf(radar.half_aperture)
    assert given.track.n_pulses == 256
    assert np.linalg.norm(np.ptp(short.track.position, axis=0)) == pytest.approx(
        156.0, rel=0.01
    )  # tol: a pulse
    both, _, _ = build(film=film, azimuth_resolution=1.0, n_pulses=600, **BEAM)
    assert both.track.n_pulses == 600 and np.linalg.norm(np.ptp(both.track.position, axis=0)) > 450.0
