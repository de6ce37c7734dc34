"""Interferograms of points whose echoes are written out here: phases, baselines, heights; statistics; refusals."""

from dataclasses import replace

import numpy as np
import pytest

from sarmitsuba.analysis.interferometry import height_map, independent_looks, interferogram, unwrapped_phase
from sarmitsuba.core.arrays import C128, F64
from sarmitsuba.core.constants import SPEED_OF_LIGHT
from sarmitsuba.core.errors import DataError
from sarmitsuba.radar.collection import Flight
from sarmitsuba.radar.radar import Radar
from sarmitsuba.radar.track import Track
from sarmitsuba.scene.geometry import PointTarget
from sarmitsuba.scene.scene import Scene
from sarmitsuba.signal.image import ImageGrid, SarImage
from sarmitsuba.signal.raw_data import Layer, RawData
from sarmitsuba.truth import theory
from sarmitsuba.truth.validation.chain import Parameter, make_scene
from tests.support.unweighted import focus

WAVELENGTH = SPEED_OF_LIGHT / 9.65e9


def drawn(seed: int) -> dict[str, Parameter]:
    """A radar of any heading, side, look, squint, mode and grid, from the air or from space."""
    rng = np.random.default_rng([seed, 15])
    cell = float(rng.uniform(0.6, 1.5))
    far = bool(seed % 2)
    given: dict[str, Parameter] = {
        "mode": ("spotlight", "stripmap")[seed // 2 % 2],
        "slant_range": 600e3 if far else float(rng.uniform(4e3, 12e3)),
        "speed": 7500.0 if far else 120.0,
        "look_angle_deg": float(rng.uniform(25.0, 55.0)),
        "heading_deg": float(rng.uniform(0.0, 360.0)),
        "look_side": ("left", "right")[rng.integers(2)],
        "squint_angle_deg": float(rng.uniform(-6.0, 6.0)),
        "center_frequency": 9.65e9,
        "bandwidth": SPEED_OF_LIGHT / 2.0 / cell,
        "azimuth_resolution": 4.0 * cell if far else cell,
        "image_grid": ("ground", "slant")[rng.integers(2)],
        "image_extent_azimuth": 100.0 if far else 40.0,
        "image_extent_range": 50.0,
    }
    if given["mode"] == "stripmap":  # apertures of the pixels' own
        given |= {
            "pattern": "rectangular",
            "antenna_length": 6.0 * cell if far else 1.5 * cell,
            "antenna_height": 0.1,
        }
    return given


def without_pattern(given: dict[str, Parameter]) -> dict[str, Parameter]:
    """The same in spotlight: all points share one aperture."""
    return {k: v for k, v in given.items() if not k.startswith(("antenna", "pattern"))} | {
        "mode": "spotlight"
    }


def scene(given: dict[str, Parameter], **more: Parameter) -> Scene:
    return make_scene(None, (), {**given, **more}, points=(PointTarget("aim", np.zeros(3), 1.0),))


def echoes(radar: Radar, point: F64) -> RawData:
    """Range-compressed echoes of a point of any two antennas, from its distances alone."""
    ways = [
        np.linalg.norm(point - track.position, axis=1)
        for track in (radar.track, radar.receiver or radar.track)
    ]
    r = 0.5 * (ways[0] + ways[1])
    window = radar.window
    samples = window.start_range[:, None] + window.sample_spacing * np.arange(window.n_samples)
    data = np.exp(-4j * np.pi / radar.waveform.wavelength * r)[:, None] * np.sinc(
        (samples - r[:, None]) / radar.waveform.range_cell
    )
    return RawData(data[None].astype(np.complex64), (Layer("VV"),), "compressed", radar, {})


def on_an_orbit(seed: int) -> dict[str, Parameter]:
    """A drawn radar on an orbit over the rotating Earth, in both modes and passes."""
    rng = np.random.default_rng([seed, 17])
    flown = ("slant_range", "speed", "look_angle_deg", "heading_deg", "squint_angle_deg", "look_side")
    given = {k: v for k, v in drawn(2 * seed + 1).items() if k not in flown}
    return given | {
        "orbit_altitude": float(rng.uniform(500e3, 700e3)),
        "orbit_inclination_deg": 97.5,
        "orbit_pass": ("ascending", "descending")[rng.integers(2)],
        "look_side": ("left", "right")[rng.integers(2)],
        "incidence_angle_deg": float(rng.uniform(25.0, 50.0)),
        "latitude_deg": float(rng.uniform(-60.0, 60.0)),
    }


def pair(
    seed: int, passes: int, share: float = 0.03, given: dict[str, Parameter] | None = None
) -> tuple[SarImage, SarImage, F64, Scene, F64]:
    """Both images of one drawn point, the point, the first's scene, and the baseline in the scene frame."""
    rng = np.random.default_rng([seed, 16])
    given = given or (drawn(seed) if passes == 2 else without_pattern(drawn(seed)))
    first = scene(given)
    point = rng.uniform((-5.0, -5.0, -12.0), (5.0, 5.0, 12.0))
    critical = theory.critical_baseline(
        WAVELENGTH,
        float(np.linalg.norm(first.radar.track.center_position)),
        np.radians(float(given["look_angle_deg" if "look_angle_deg" in given else "incidence_angle_deg"])),
        first.radar.waveform.range_cell,
        passes=passes,
    )
    angle = rng.uniform(0.0, 2.0 * np.pi)
    along, across, up = share * critical * np.array([0.05, np.cos(angle), np.sin(angle)])
    if passes == 2:
        radar = scene(given, pass_offset_along=along, pass_offset_across=across, pass_offset_up=up).radar
    else:
        track = first.radar.track
        radar = scene(given, pass_offset_across=across, pass_offset_up=up).radar
        receiver = track.moved(radar.track.center_position - track.center_position)
        farther = 0.5 * (np.linalg.norm(receiver.position, axis=1) - np.linalg.norm(track.position, axis=1))
        window = replace(first.radar.window, start_range=first.radar.window.start_range + farther)
        radar = replace(first.radar, receiver=receiver, window=window)
    request = first.image
    one = focus(echoes(first.radar, point), request=request)
    two = focus(echoes(radar, point), one.grid)
    moved = (radar.receiver or radar.track).center_position - first.radar.track.center_position
    return one, two, point, first, moved


@pytest.mark.parametrize("passes", [2, 1])
@pytest.mark.parametrize("seed", range(8))
def test_a_point_of_any_height_is_found_where_it_is(seed: int, passes: int) -> None:
    """Its pixel's range, Doppler and phase give the point itself, but for the pixel's own place along the beam."""
    check_point(passes, *pair(seed, passes))


@pytest.mark.parametrize("seed", range(4))
def test_a_point_is_found_from_an_orbit(seed: int) -> None:
    """The same, where velocities turn and climb."""
    check_point(2, *pair(seed, 2, given=on_an_orbit(seed)))


def check_point(passes: int, one: SarImage, two: SarImage, point: F64, first: Scene, moved: F64) -> None:
    both = interferogram(one, two, (1, 1))
    peak = np.unravel_index(int(np.argmax(both.powers[0])), both.grid.shape)
    found = height_map(both, lowest=-0.5 * both.baseline.height_of_ambiguity)
    dark = np.ones(both.grid.shape, dtype=bool)
    dark[peak] = False
    masked = height_map(both, lowest=-0.5 * both.baseline.height_of_ambiguity, shadow=dark)
    assert np.array_equal(masked.points[peak], found.points[peak]) and np.isnan(masked.z[dark]).all()
    missed = found.points[peak] - point
    antenna = both.views[0].look(point[None])
    sight = antenna.gradient(point[None])[0]
    flight = antenna.forward if antenna.forward.ndim == 1 else antenna.forward[0]
    normal = np.cross(sight, flight)
    normal /= np.linalg.norm(normal)
    sigma = (
        both.wavelength
        * both.baseline.slant_range
        / (2.0 * np.pi * passes)
        / abs(both.baseline.perpendicular)
    )
    print(passes, both.baseline, missed @ normal, sigma)
    # tol: 0.01 rad of interpolated profiles; and within the pixel the phase turns with a baseline along the flight
    turn = 2.0 * np.pi * passes / both.wavelength * abs(both.baseline.along) / both.baseline.slant_range
    assert abs(missed @ normal) < (0.01 + turn * abs(missed @ flight)) * sigma
    # tol: half a pixel; squint turns both a little
    assert abs(missed @ sight) < 0.55 * one.grid.range_spacing
    assert abs(missed @ flight) < 0.65 * max(one.grid.azimuth_spacing, one.grid.range_spacing)
    assert both.baseline.passes == passes
    length = np.linalg.norm([both.baseline.perpendicular, both.baseline.parallel, both.baseline.along])
    if first.radar.mode == "spotlight":  # in stripmap every pixel's apertures are where it is abeam of both
        assert length == pytest.approx(np.linalg.norm(moved), rel=1e-9)


@pytest.mark.parametrize("seed", range(4))
def test_the_flat_earth_and_the_wavenumber_are_those_of_theory(seed: int) -> None:
    """Broadside, where both have closed forms; the carriers put in again are those of the antennas' distances."""
    given = without_pattern(drawn(seed)) | {"squint_angle_deg": 0.0}
    first, second = scene(given), scene(given, pass_offset_across=12.0, pass_offset_up=-7.0)
    radar = first.radar
    one = focus(echoes(radar, np.zeros(3)), request=first.image)
    two = focus(echoes(second.radar, np.zeros(3)), one.grid)
    both = interferogram(one, two, (4, 4))
    centers = [s.radar.track.center_position for s in (first, second)]
    expected = theory.flat_earth_phase(*centers, both.positions(), both.wavelength)
    # tol: rounding of float64 at the ranges' size, 1e-10 m from space
    np.testing.assert_allclose(both.flat_earth_phase(), expected, atol=1e-6)
    turned = both.with_flat_earth() * np.exp(-1j * expected)
    np.testing.assert_allclose(turned, both.values, atol=1e-5 * np.abs(both.values).max())
    b = both.baseline
    assert b.height_of_ambiguity == pytest.approx(
        theory.height_of_ambiguity(both.wavelength, b.slant_range, b.incidence, abs(b.perpendicular))
    )
    middle = tuple(n // 2 for n in both.grid.shape)
    # tol: the image's middle is not exactly a block's, and waves are spherical
    assert abs(both.vertical_wavenumber()[middle]) == pytest.approx(
        2.0 * np.pi / b.height_of_ambiguity, rel=3e-3
    )
    # upwards is positive: a second antenna above the first sees heights turn backwards
    assert np.sign(both.vertical_wavenumber()[middle]) == -np.sign(b.perpendicular)


def white_pair(coherence: float, n: int = 192, phase: float = 0.7) -> tuple[SarImage, SarImage]:
    """Two images of Gaussian speckle of a given coherence, two pixels a cell, without any scene."""
    rng = np.random.default_rng(5)
    noise = rng.standard_normal((3, n // 2, n // 2)) + 1j * rng.standard_normal((3, n // 2, n // 2))
    spectrum = np.zeros((3, n, n), dtype=np.complex128)
    spectrum[:, : n // 2, : n // 2] = noise
    values = np.fft.ifft2(spectrum)
    common, a, b = values / np.sqrt(np.mean(np.abs(values) ** 2))
    one = np.sqrt(coherence) * common + np.sqrt(1.0 - coherence) * a
    two = (np.sqrt(coherence) * common + np.sqrt(1.0 - coherence) * b) * np.exp(-1j * phase)
    return of_values(one), of_values(two, up=3.0)


def of_values(values: C128, up: float = 0.0) -> SarImage:
    """An image of these pixels, half a cell of 1 m apart, seen from 5 km at 45 degrees."""
    n = values.shape[0]
    axis = 0.5 * (np.arange(n) - 0.5 * (n - 1))
    grid = ImageGrid("ground", axis, axis, np.zeros(3), np.array([0.0, 1.0, 0.0]), np.array([1.0, 0.0, 0.0]))
    track = Track.straight([-3535.0, 0.0, 3535.0 + up], [0.0, 100.0, 0.0], 100.0, 16)
    flight = Flight.of(track)
    return SarImage(
        values[None].astype(np.complex64),
        (Layer("VV"),),
        grid,
        WAVELENGTH,
        1.0,
        np.sqrt(0.5),
        np.full(n, np.pi / 4),
        {"focus": {"method": "backprojection", "flight": flight.as_dict()}},
    )


@pytest.mark.parametrize("coherence", [0.3, 0.7, 0.95])
def test_the_phase_scatters_as_theory_says(coherence: float) -> None:
    both = interferogram(*white_pair(coherence), (8, 8))
    # tol: four standard errors of 576 blocks, sqrt(2 / n) each; 4 x 4 cells and, since blocks have edges, a little more
    measured = theory.equivalent_number_of_looks(both.powers[0])
    assert both.independent_looks == pytest.approx(measured, rel=4.0 * np.sqrt(2.0 / 576.0))
    assert 16.0 < both.independent_looks < 21.0
    away = np.angle(np.exp(1j * (both.phase - 0.7)))
    cdf = theory.interferometric_phase_cdf(np.sort(away.ravel()), coherence, both.independent_looks)
    empirical = (np.arange(cdf.size) + 0.5) / cdf.size
    # tol: Kolmogorov's critical distance at 99.9 %
    assert np.abs(cdf - empirical).max() < 1.95 / np.sqrt(cdf.size)
    mean, sigma = both.coherence.mean(), both.coherence.std() / np.sqrt(both.coherence.size)
    expected = theory.expected_coherence(coherence, both.independent_looks)
    # tol: four standard errors; 0.01 because samples within a block are correlated, not independent
    assert abs(mean - expected) < 4.0 * sigma + 0.01
    found = height_map(both)
    assert (
        np.median(found.sigma)
        == pytest.approx(
            theory.interferometric_phase_sigma(coherence, 16.0) / abs(both.vertical_wavenumber().mean()),
            rel=0.25,
        )
        or coherence < 0.5
    )  # the bound is right from some coherence on only


def test_theory_of_the_phase() -> None:
    """Published limits: uniform without coherence; the Cramer-Rao bound with many looks; one look in closed form."""
    axis = np.linspace(-np.pi, np.pi, 721)
    np.testing.assert_allclose(theory.interferometric_phase_pdf(axis, 0.0, 3.0), 0.5 / np.pi)
    assert theory.interferometric_phase_sigma(0.0) == pytest.approx(np.pi / np.sqrt(3.0))
    bound = np.sqrt((1.0 - 0.8**2) / (2.0 * 64.0 * 0.8**2))
    assert theory.interferometric_phase_sigma(0.8, 64.0) == pytest.approx(bound, rel=0.02)
    beta = 0.6 * np.cos(axis)
    one = (1.0 - 0.36) / (2.0 * np.pi * (1.0 - beta**2))
    one *= 1.0 + beta * np.arccos(-beta) / np.sqrt(1.0 - beta**2)  # Bamler & Hartl 1998, eq. 41
    np.testing.assert_allclose(theory.interferometric_phase_pdf(axis, 0.6), one)
    # no coherence: sqrt(pi) Gamma(n + ...) / ... tends to sqrt(pi / 4 n)
    assert theory.expected_coherence(0.0, 100.0) == pytest.approx(np.sqrt(np.pi / 400.0), rel=0.01)


def test_a_ramp_is_unwrapped() -> None:
    """A hill of three fringes; its height comes back without jumps."""
    n = 96
    axis = 0.5 * (np.arange(n) - 0.5 * (n - 1))
    hill = 20.0 * np.exp(-(axis[:, None] ** 2 + axis**2) / 200.0) - 1.0
    one, two = white_pair(0.99, n, 0.0)
    two = replace(two, data=two.data * np.exp(-1j * hill)[None].astype(np.complex64))
    both = interferogram(one, two, (2, 2))
    found = unwrapped_phase(both)
    expected = hill.reshape(n // 2, 2, n // 2, 2).mean(axis=(1, 3))
    away = found - expected
    # tol: the phase's own scatter of 0.1 rad; none is a turn away
    assert np.abs(away).max() < 1.0 and np.abs(away).mean() < 0.1
    assert np.isnan(unwrapped_phase(interferogram(*white_pair(0.5), (4, 4)), 0.6)).any()
    place = height_map(both, found)
    assert np.ptp(place.z) == pytest.approx(np.ptp(found) / abs(both.vertical_wavenumber()).mean(), rel=0.05)


def test_the_common_band_brings_coherence_back() -> None:
    """Points at random on level ground at a third of the critical baseline, echoes written out here."""
    rng = np.random.default_rng(3)
    given = drawn(0) | {"image_grid": "ground", "image_extent_azimuth": 24.0, "image_extent_range": 50.0}
    first = scene(given)
    share = 0.35
    critical = theory.critical_baseline(
        WAVELENGTH,
        float(given["slant_range"]),
        np.radians(float(given["look_angle_deg"])),
        first.radar.waveform.range_cell,
    )
    second = scene(
        given, pass_offset_up=share * critical / np.sin(np.radians(float(given["look_angle_deg"])))
    )
    places = np.column_stack([rng.uniform(-32.0, 32.0, (900, 2)), np.zeros(900)])
    images: list[SarImage] = []
    for radar in (first.radar, second.radar):
        raw = echoes(radar, places[0])
        total = sum(
            echoes(radar, p).data * np.complex64(a)
            for p, a in zip(places, np.random.default_rng(4).standard_normal((900, 2)) @ [1, 1j], strict=True)
        )
        raw = replace(raw, data=np.asarray(total, dtype=np.complex64))
        images.append(focus(raw, images[0].grid if images else None, request=None if images else first.image))
    full, common = (interferogram(*images, band=band) for band in ("full", "common"))  # type: ignore[arg-type]
    share = abs(full.baseline.perpendicular) / full.baseline.critical

    def of_all(both: object) -> float:
        values, powers = both.values, both.powers  # type: ignore[attr-defined]
        return float(abs(values.sum()) / np.sqrt(powers[0].sum() * powers[1].sum()))

    print(share, of_all(full), of_all(common), full.independent_looks, common.independent_looks)
    # tol: three standard errors of some thousand cells, and 900 points are no continuous ground
    assert abs(of_all(full) - theory.baseline_coherence(share)) < 0.06
    assert of_all(common) > 0.93
    with pytest.raises(DataError, match=r"no common band: perpendicular baseline .* critical"):
        interferogram(images[0], replace(images[1], metadata=far_away(images[1])), band="common")


def far_away(image: SarImage) -> dict[str, object]:
    facts = dict(image.metadata["focus"])
    flight = Flight.from_dict(facts["flight"])
    facts["flight"] = replace(flight, center=flight.center + np.array([0.0, 0.0, 1e4])).as_dict()
    return {"focus": facts}


def test_what_makes_no_interferogram_is_refused_in_one_line() -> None:
    one, two = white_pair(0.5, 32)
    shifted = replace(two, grid=replace(two.grid, range=two.grid.range + 0.1))
    bare = replace(two, metadata={"focus": {}})
    raster = replace(two, metadata={"focus": {**two.metadata["focus"], "method": "raster"}})
    for other, text in (
        (shifted, "different grids; focus the second's raw data on the first's grid"),
        (replace(two, wavelength=0.05), "wavelengths of 0.0310666 m and 0.05 m"),
        (replace(two, layers=(Layer("HH"),)), "the second image has no channel VV, only HH"),
        (bare, "has no recorded track"),
        (raster, "is by method raster"),
    ):
        with pytest.raises(DataError, match=text) as caught:
            interferogram(one, other)
        assert "\n" not in str(caught.value)
    with pytest.raises(DataError, match="looks of 0 x 4 pixels in an image of 32 x 32"):
        interferogram(one, two, (0, 4))
    with pytest.raises(DataError, match="heights need a perpendicular baseline"):
        height_map(interferogram(one, one))
    with pytest.raises(DataError, match=r"no block has a coherence of 1\.1"):
        unwrapped_phase(interferogram(one, two), 1.1)


def test_looks_of_one_pixel_are_one() -> None:
    one, _ = white_pair(0.5, 32)
    assert independent_looks(one, (1, 1)) == pytest.approx(1.0)
    assert interferogram(one, one).looks == (8, 8)  # sixteen cells, square
    np.testing.assert_allclose(interferogram(one, one).coherence, 1.0)


def test_a_pass_without_offset_is_the_plain_track() -> None:
    given = drawn(2)
    plain, zero = scene(given).radar, scene(given, pass_offset_up=0.0).radar
    for name in ("position", "velocity", "time"):
        np.testing.assert_array_equal(getattr(plain.track, name), getattr(zero.track, name))
    np.testing.assert_array_equal(plain.pointing.boresight, zero.pointing.boresight)


@pytest.mark.parametrize("seed", range(4))
def test_a_pass_with_offset_is_parallel_and_looks_at_the_aim_point(seed: int) -> None:
    given = drawn(seed)
    plain, moved = (
        scene(given, **more).radar for more in ({}, {"pass_offset_across": 30.0, "pass_offset_up": 5.0})
    )
    shift = moved.track.position - plain.track.position
    right = np.array([plain.track.along[1], -plain.track.along[0], 0.0])
    np.testing.assert_allclose(shift, np.broadcast_to(30.0 * right + [0.0, 0.0, 5.0], shift.shape), atol=1e-6)
    middle = moved.track.center_index
    line = -moved.track.position[middle]
    # tol: the middle pulse is up to half a pulse from mid-aperture
    assert moved.pointing.boresight[middle] @ line / np.linalg.norm(line) > 1.0 - 1e-5
