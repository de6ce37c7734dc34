"""Wide bands: spectra of echoes against physical optics, slabs and permittivities taken at every frequency."""

from collections.abc import Callable
from dataclasses import replace
from functools import partial

import numpy as np
import pytest
import trimesh

from sarmitsuba import PointTarget, RadarDescription, RawData, Scene, SceneMesh, build_scene, simulate
from sarmitsuba.core.arrays import C128, F64
from sarmitsuba.core.constants import SPEED_OF_LIGHT
from sarmitsuba.core.errors import SarmitsubaWarning
from sarmitsuba.effects.plan import plan_effects
from sarmitsuba.radar.film import FilmDescription
from sarmitsuba.scene.materials.material import Material
from sarmitsuba.scene.materials.named_materials import MATERIALS
from sarmitsuba.signal.sub_bands import SubBands
from sarmitsuba.simulation.execution.path_table import trace_paths
from sarmitsuba.truth import theory
from tests.support.unweighted import focus, render

pytestmark = pytest.mark.filterwarnings("ignore:.*(edge_diffraction|wideband|coherent) is switched off")
SQUARE = [[0, 1, 2], [0, 2, 3]]
# B / fc = 0.8
FREQUENCY, BANDWIDTH = 3e9, 2.4e9


def scene_of(
    shapes: list[SceneMesh],
    points: tuple[PointTarget, ...] = (),
    *,
    frequency: float = FREQUENCY,
    bandwidth: float = BANDWIDTH,
    look: float = 45.0,
    polarisation: str = "VV",
    **settings: str | float,
) -> Scene:
    """Shapes about the origin under a spotlight radar, 500 m away."""
    radar = RadarDescription(
        center_frequency=frequency,
        bandwidth=bandwidth,
        slant_range=500.0,
        heading_deg=37.0,
        look_angle_deg=look,
        polarisation=polarisation,
        azimuth_resolution=2.0 * 3e9 / frequency,
        aim_x=0.0,
        aim_y=0.0,
        aim_z=0.0,
    )
    film = FilmDescription(image_extent_azimuth=12.0, image_extent_range=12.0)
    return build_scene(shapes, points, radar=radar, film=film).replace(edge_diffraction="off", **settings)


LINE_OF_SIGHT = scene_of([SceneMesh(np.eye(3), [[0, 1, 2]], "pec", "any")]).radar.track.center_position


def facing(center: F64, sides: tuple[float, float], azimuth: float = 0.0, tilt: float = 0.0) -> F64:
    """(4, 3) corners of a plate whose normal is off the line of sight by two angles, degrees."""
    line = LINE_OF_SIGHT / np.linalg.norm(LINE_OF_SIGHT)
    across = np.cross([0.0, 0.0, 1.0], line)
    across /= np.linalg.norm(across)
    a, t = np.radians([azimuth, tilt])
    n = line * np.cos(a) * np.cos(t) + across * np.sin(a) * np.cos(t) + np.cross(line, across) * np.sin(t)
    u = np.cross(n, [0.3, 0.2, 1.0])
    u /= np.linalg.norm(u)
    u, v = u * sides[0], np.cross(n, u) * sides[1]
    return center + np.array([-u - v, u - v, u + v, v - u]) * 0.5


def spectrum(raw: RawData, pulse: int, frequency: F64, center: float = 0.0, width: float = np.inf) -> C128:
    """Spectrum of a pulse's echo within a gate about the slant range of the origin plus ``center``."""
    radar = raw.radar
    window, carrier = radar.window, radar.waveform.center_frequency
    r = window.start_range[pulse] + window.sample_spacing * np.arange(window.n_samples)
    r = r - np.linalg.norm(radar.track.position[pulse])
    samples = raw.data[0, pulse].astype(np.complex128)
    samples[np.abs(r - center) > width] = 0.0
    turn = np.exp(-4j * np.pi / SPEED_OF_LIGHT * np.outer(frequency - carrier, r))
    return np.asarray(turn @ samples)


def band(scene: Scene, n: int = 48) -> F64:
    """Frequencies over the inner 94 % of the band."""
    wave = scene.radar.waveform
    return wave.center_frequency + np.linspace(-0.47, 0.47, n) * wave.bandwidth


def physical_optics(scene: Scene, pulse: int, corners: F64, frequency: F64, n: int = 64) -> C128:
    """Amplitude of a conducting plate over frequency: its surface integral by quadrature, and no tubes."""
    antenna = scene.radar.track.position[pulse]
    node, weight = np.polynomial.legendre.leggauss(n)
    p0, u, v = corners[0], corners[1] - corners[0], corners[3] - corners[0]
    grid = p0 + 0.5 * (1.0 + node)[:, None, None] * u + 0.5 * (1.0 + node)[None, :, None] * v
    leg = grid - antenna
    distance = np.linalg.norm(leg, axis=-1)
    projected = 0.25 * np.outer(weight, weight) * np.abs(leg @ np.cross(u, v)) / distance**3
    k = 2.0 * np.pi / SPEED_OF_LIGHT * frequency
    turns = np.exp(-2j * k[:, None, None] * (distance - np.linalg.norm(antenna)))
    return np.asarray(k / np.sqrt(np.pi) * (projected * turns).sum(axis=(1, 2)))


def limited(raw: RawData, pulse: int, amplitude: Callable[[F64], C128], n_frequencies: int = 301) -> RawData:
    """Every pulse as one should be, of an amplitude over frequency: the band's part of it at the window's samples."""
    radar = raw.radar
    carrier, bandwidth, window = radar.waveform.center_frequency, radar.waveform.bandwidth, radar.window
    node, weight = np.polynomial.legendre.leggauss(n_frequencies)
    f = carrier + 0.5 * bandwidth * node
    r = window.start_range[pulse] + window.sample_spacing * np.arange(window.n_samples)
    middle = np.linalg.norm(radar.track.position[pulse])
    turn = np.exp(4j * np.pi / SPEED_OF_LIGHT * np.outer(f - carrier, r - middle))
    carried = radar.amplitude_constant * np.exp(-4j * np.pi * carrier / SPEED_OF_LIGHT * middle)
    samples = carried * ((0.5 * weight * amplitude(f)) @ turn)
    return replace(raw, data=np.broadcast_to(samples, raw.data.shape))


@pytest.mark.parametrize("seed", [0, *(pytest.param(n, marks=pytest.mark.slow) for n in (1, 2, 3))])
def test_drawn_plates_follow_physical_optics_at_every_frequency(seed: int) -> None:
    """B / fc = 0.8: the spectrum of a pulse within 0.05 dB where it is not in a null; without the effect 1 to 4 dB."""
    rng = np.random.default_rng(seed)
    sides, azimuth, tilt = tuple(rng.uniform(0.4, 1.0, 2)), rng.uniform(-40.0, 40.0), rng.uniform(-35.0, 35.0)
    corners = facing(np.zeros(3), sides, azimuth, tilt)
    errors = {}
    for switch in ("auto", "off"):
        scene = scene_of(
            [SceneMesh(corners, SQUARE, "pec", "plate")], method="raw", wideband=switch, gridding_width=6
        )
        raw = simulate(scene)
        pulse = scene.radar.track.n_pulses // 3
        wanted = limited(raw, pulse, partial(physical_optics, scene, pulse, corners))
        f = band(scene)
        got, exact = spectrum(raw, pulse, f), spectrum(wanted, pulse, f)
        seen = np.abs(exact) > 0.3 * np.abs(exact).max()
        errors[switch] = float(np.abs(20.0 * np.log10(np.abs(got[seen] / exact[seen]))).max())
    # tol: interpolation over the band, -51 dB; nulls are left out
    assert errors["auto"] < 0.05, errors
    assert errors["off"] > 0.5, errors


def double_bounce(
    scene: Scene, pulse: int, axes: F64, sides: tuple[float, float, float], frequency: F64
) -> C128:
    """Amplitude of a dihedral's two paths: physical optics of each face where the other lights it, from its image.

    ``axes``: rows along the floor to the radar, along the fold, up; ``sides``: depth of the floor, fold, wall, m.
    """
    x, y, z = (scene.radar.track.position[pulse] @ axes.T).tolist()
    depth, width, height = sides
    k, total, n = 2.0 * np.pi / SPEED_OF_LIGHT * frequency, np.zeros(len(frequency), np.complex128), 360
    along = width * ((np.arange(n) + 0.5) / n - 0.5)
    # a face as the half plane that stands on the mirror: antenna over the mirror, before the face
    for over, before, mirror, face in ((z, x, depth, height), (x, z, height, depth)):
        up = (face * (np.arange(n) + 0.5) / n)[:, None]
        share = up / (up + over)  # of the way from the image to the face, beyond the mirror
        lit = (before * share <= mirror) & (np.abs(along + (y - along) * share) <= 0.5 * width)
        back = np.sqrt(before**2 + (y - along) ** 2 + (over - up) ** 2)[lit]
        out = np.sqrt(before**2 + (y - along) ** 2 + (over + up) ** 2)[lit]
        weight = face * width / n**2 * before / (out**2 * back)
        shift = 0.5 * (out + back) - np.linalg.norm([x, y, z])
        total += np.array([f / np.sqrt(np.pi) * (weight * np.exp(-2j * f * shift)).sum() for f in k])
    return total


@pytest.mark.slow
@pytest.mark.parametrize("seed", [0, 1, 2])
def test_a_drawn_dihedral_follows_physical_optics_at_every_frequency(seed: int) -> None:
    """The double bounce of a square corner turned up to 10 degrees, B / fc = 0.8, each frequency within 0.05 dB."""
    rng = np.random.default_rng(seed)
    sides = tuple(rng.uniform(0.5, 1.0, 3))
    level = LINE_OF_SIGHT * [1.0, 1.0, 0.0]
    a = np.arctan2(level[1], level[0]) + np.radians(rng.uniform(3.0, 10.0))
    axes = np.array([[np.cos(a), np.sin(a), 0.0], [-np.sin(a), np.cos(a), 0.0], [0.0, 0.0, 1.0]])
    p, f, u = sides[0] * axes[0], 0.5 * sides[1] * axes[1], sides[2] * axes[2]
    shapes = [
        SceneMesh(np.array([-f, p - f, p + f, f]), SQUARE, "pec", "floor"),
        SceneMesh(np.array([-f, f, f + u, u - f]), SQUARE, "pec", "wall"),
    ]
    scene = scene_of(shapes, method="raw", gridding_width=6, keep_orders=True, max_depth=2)
    raw = simulate(scene)
    double = next(i for i, layer in enumerate(raw.layers) if layer.order == 2)
    frequency, pulse = band(scene, 24), scene.radar.track.n_pulses // 3
    alone = replace(raw, data=raw.data[double:], layers=raw.layers[double:])
    wanted = limited(alone, pulse, partial(double_bounce, scene, pulse, axes, sides))
    got, exact = spectrum(alone, pulse, frequency), spectrum(wanted, pulse, frequency)
    seen = np.abs(exact) > 0.3 * np.abs(exact).max()
    ratio = 20.0 * np.log10(np.abs(got[seen] / exact[seen]))
    # tol: what the polarisation off the corner's plane takes, the same at all frequencies
    assert abs(np.median(ratio)) < 0.3
    # tol: 0.05 dB, and what the shares of both chains of a corner change where a facet ends
    assert np.abs(ratio - np.median(ratio)).max() < 0.08, ratio


@pytest.mark.slow
def test_a_sphere_follows_physical_optics_at_every_frequency() -> None:
    """A curved body, ka = 60 at the carrier, B / fc = 0.8: its specular return in HH and VV."""
    radius = 60.0 * SPEED_OF_LIGHT / (2.0 * np.pi * FREQUENCY)
    ball = trimesh.creation.icosphere(subdivisions=5, radius=radius)
    mesh = SceneMesh(ball.vertices, ball.faces, "pec", "ball", smooth=True)
    errors = {}
    for switch in ("auto", "off"):
        scene = scene_of([mesh], method="raw", gridding_width=6, wideband=switch, polarisation="HH,VV")
        raw = simulate(scene)
        pulse, frequency = scene.radar.track.n_pulses // 3, band(scene, 24)
        away = float(np.linalg.norm(scene.radar.track.position[pulse]))

        def amplitude(f: F64, away: float = away) -> C128:
            each = [theory.sphere_po_amplitude(radius, SPEED_OF_LIGHT / x) for x in f]
            return np.array(each) / away**2

        for i, channel in enumerate(raw.channels):
            alone = replace(raw, data=raw.data[i : i + 1], layers=raw.layers[i : i + 1])
            # a gate about the specular point: the false return of the shadow's edge stays out
            got = spectrum(alone, pulse, frequency, -radius, 0.6)
            exact = spectrum(limited(alone, pulse, amplitude), pulse, frequency, -radius, 0.6)
            errors[switch, channel] = float(np.abs(20.0 * np.log10(np.abs(got / exact))).max())
    print(errors)
    for channel in ("HH", "VV"):
        # tol: 20480 facets, the antenna 500 m away, and interpolation over the band, -51 dB
        assert errors["auto", channel] < 0.06, errors
        assert errors["off", channel] > 2.0, errors


@pytest.mark.slow
def test_the_focused_level_is_that_of_physical_optics() -> None:
    """A plate 4 degrees off its glint: its image and that of physical optics at every frequency and pulse."""
    corners = facing(np.zeros(3), (0.5, 0.4), 3.0, 3.0)
    peaks = {}
    for switch in ("auto", "off"):
        scene = scene_of([SceneMesh(corners, SQUARE, "pec", "plate")], method="raw", wideband=switch)
        raw = simulate(scene)
        peaks[switch] = np.abs(focus(raw).data[0]).max()
    exact = np.zeros(raw.data.shape, dtype=np.complex64)
    for k in range(exact.shape[1]):
        exact[:, k] = limited(raw, k, partial(physical_optics, scene, k, corners, n=24), 81).data[:, k]
    wanted = np.abs(focus(replace(raw, data=exact)).data[0]).max()
    # tol: interpolation over the band -51 dB, gridding -44 dB of a contribution
    errors = {switch: abs(20.0 * np.log10(peak / wanted)) for switch, peak in peaks.items()}
    assert errors["auto"] < 0.02, errors
    assert errors["off"] > 0.1, errors


@pytest.mark.parametrize(
    ("kind", "frequency", "bandwidth"),
    [("sea_water", 0.43e9, 0.3e9), pytest.param("wet_ground", 1.3e9, 0.6e9, marks=pytest.mark.slow)],
)
def test_permittivity_is_that_of_every_frequency(kind: str, frequency: float, bandwidth: float) -> None:
    """Echo of a plate at normal incidence over that of a conductor: Fresnel's coefficient at each frequency."""
    corners = facing(np.zeros(3), (3.0, 2.5))
    spectra = {}
    for material in (kind, "pec"):
        scene = scene_of(
            [SceneMesh(corners, SQUARE, {"material": material, "smooth": True}, "plate")],
            frequency=frequency,
            bandwidth=bandwidth,
            method="raw",
            key_pulse_interval=1,
            wideband="on",
            roughness="off",
            diffuse="off",
        )
        raw = simulate(scene)
        f = band(scene)
        spectra[material] = spectrum(raw, raw.radar.track.n_pulses // 2, f)
    got = spectra[kind] / spectra["pec"]
    wanted = np.array([theory.fresnel(1.0, MATERIALS[kind].permittivity(x))[0] for x in f]) / -1.0
    at_carrier = -theory.fresnel(1.0, MATERIALS[kind].permittivity(frequency))[0]
    # tol: interpolation leaves -51 dB, gridding as much
    assert np.abs(got - wanted).max() < 0.003
    assert np.abs(wanted - at_carrier).max() > 0.01


@pytest.mark.slow
def test_a_slab_reflects_as_at_every_frequency() -> None:
    """A wall of concrete, 12 cm thick, at normal incidence: its fringes over the band, within 0.1 dB of the peak."""
    thickness, frequency, bandwidth = 0.12, 1.5e9, 0.6e9
    corners = facing(np.zeros(3), (2.0, 1.5))
    slab = Material("slab", permittivity=5.2 - 0.2j, thickness=thickness)
    spectra = {}
    for material in (slab, Material("metal", pec=True)):
        scene = scene_of(
            [SceneMesh(corners, SQUARE, material, "plate")],
            frequency=frequency,
            bandwidth=bandwidth,
            method="raw",
        )
        raw = simulate(scene)
        f = band(scene)
        spectra[material.name] = spectrum(raw, raw.radar.track.n_pulses // 2, f)
    got = spectra["slab"] / spectra["metal"]
    wanted = [-theory.slab(1.0, slab.permittivity, thickness, SPEED_OF_LIGHT / x).r_te for x in f]
    assert np.abs(wanted).max() > 2.0 * np.abs(wanted).min()  # fringes
    assert np.abs(got - np.array(wanted)).max() < 0.006  # tol: interpolation -51 dB, gridding, both spectra


@pytest.mark.slow
@pytest.mark.parametrize("what", ["point", "plate"])
def test_a_pane_lets_through_what_it_does_at_every_frequency(what: str) -> None:
    """Spectrum of a target behind a pane of 3 cm over that without it: the square of the pane's factor."""
    thickness, frequency, bandwidth, tilt = 0.03, 3e9, 1.2e9, 0.0 if what == "point" else 20.0
    line = LINE_OF_SIGHT / np.linalg.norm(LINE_OF_SIGHT)
    pane = Material("pane", permittivity=6.3 - 0.1j, thickness=thickness)
    target = SceneMesh(facing(np.zeros(3), (0.6, 0.5)), SQUARE, "pec", "target")
    window = SceneMesh(facing(3.0 * line, (4.0, 4.0), 0.0, tilt), SQUARE, pane, "pane")
    point = (PointTarget("point", np.zeros(3), 1.0),)
    cases = {
        "point": {"behind": ([window], point), "free": ([], point)},
        "plate": {"behind": ([window, target], ()), "free": ([target], ())},
    }[what]
    settings = {"coherent": "off"} if what == "point" else {}
    spectra = {}
    for where, (shapes, points) in cases.items():
        more = settings if shapes else {}
        scene = scene_of(shapes, points, frequency=frequency, bandwidth=bandwidth, method="raw", **more)
        raw = simulate(scene)
        f = band(scene, 24)
        spectra[where] = spectrum(raw, raw.radar.track.n_pulses // 2, f, width=1.5)
    got = np.abs(spectra["behind"] / spectra["free"])
    cosine = float(np.cos(np.radians(tilt)))
    wanted = [
        np.abs(theory.slab_insertion(cosine, pane.permittivity, thickness, SPEED_OF_LIGHT / x)[1]) ** 2
        for x in f
    ]
    assert np.ptp(wanted) > 0.15  # the pane's resonance lies in the band
    # tol: tails of the response beyond the gate, those of the pane's own echo in it
    assert np.abs(got - np.array(wanted)).max() < 0.02


def test_hybrid_and_image_agree_with_raw() -> None:
    """Every method has the same image of a plate and an ideal point beside it, and the point is flat over the band."""
    corners = facing(np.zeros(3), (0.42, 0.41), 11.0, -16.0)
    point = PointTarget("point", np.array([2.0, 2.0, 0.0]), 0.1)
    images = {}
    for method in ("raw", "hybrid", "image"):
        scene = scene_of([SceneMesh(corners, SQUARE, "pec", "plate")], (point,), method=method)
        images[method] = render(scene).data[0]
    for method in ("hybrid", "image"):
        a, b = images["raw"], images[method]
        assert abs(np.vdot(a, b)) > 0.999 * np.linalg.norm(a) * np.linalg.norm(b)


@pytest.mark.slow
def test_looks_of_a_strip_follow_the_band() -> None:
    """Stripmap, B / fc = 0.3: the image of looks is nearer to that of raw data with the effect than without it."""
    radar = RadarDescription(
        mode="stripmap",
        pattern="gaussian",
        center_frequency=FREQUENCY,
        bandwidth=0.3 * FREQUENCY,
        slant_range=500.0,
        heading_deg=37.0,
        look_angle_deg=45.0,
        azimuth_resolution=0.5,
        azimuth_beamwidth_deg=9.0,
        elevation_beamwidth_deg=30.0,
        aim_x=0.0,
        aim_y=0.0,
        aim_z=0.0,
        prf=400.0,
    )
    film = FilmDescription(image_extent_azimuth=10.0, image_extent_range=10.0)
    plate = SceneMesh(facing(np.zeros(3), (0.42, 0.41), 3.0, -16.0), SQUARE, "pec", "plate")
    scene = build_scene([plate], radar=radar, film=film).replace(edge_diffraction="off")
    images = {
        (method, switch): render(scene.replace(method=method, wideband=switch)).data[0]
        for method, switch in (("raw", "on"), ("raw", "off"), ("image", "on"), ("image", "off"))
    }

    def apart(a: tuple[str, str], b: tuple[str, str]) -> float:
        x, y = images[a], images[b]
        return float(1.0 - abs(np.vdot(x, y)) / (np.linalg.norm(x) * np.linalg.norm(y)))

    with_it, without = apart(("raw", "on"), ("image", "on")), apart(("raw", "on"), ("image", "off"))
    looks = apart(("raw", "off"), ("image", "off"))  # what the looks themselves leave out
    print(with_it, without, looks)
    assert with_it < 0.8 * without
    assert with_it < looks + 5e-4


def test_a_narrow_band_is_traced_at_the_carrier() -> None:
    """On where the rms of f over the band, B / fc / sqrt(12), is 10 dB above the tolerance of -40 dB: from 0.11 on."""
    corners = facing(np.zeros(3), (0.5, 0.5))
    for bandwidth, count in ((0.09e9, 1), (0.3e9, 1), (0.36e9, 2), (0.6e9, 3)):
        scene = scene_of([SceneMesh(corners, SQUARE, "pec", "plate")], bandwidth=bandwidth, method="raw")
        plan = plan_effects(scene)
        decision = plan.decision("wideband")
        assert plan.sub_bands == count, bandwidth
        error = 20.0 * np.log10(bandwidth / FREQUENCY / np.sqrt(12.0))
        assert abs(decision.error_db - error) < 0.2  # tol: the corner's law, 1/f, is no line
        assert ("in quadrature to the peak" in decision.why) == (bandwidth == 0.3e9)
    assert plan_effects(scene.replace(wideband="off"), warn=False).sub_bands == 1


def test_diffuse_returns_of_a_narrow_band_are_traced_at_the_carrier() -> None:
    """Rough walls whose law grows faster than f: off at 3 % of bandwidth, with the error that is left; on at 15 %."""
    rough = Material(
        "rough", 5.0 - 0.3j, diffuse_law="small_slope", rms_height=0.0005, correlation_length=0.002
    )
    for bandwidth, count in ((0.3e9, 1), (1.5e9, 2)):
        scene = scene_of(
            [SceneMesh(facing(np.zeros(3), (0.5, 0.5)), SQUARE, rough, "wall")],
            frequency=10e9,
            bandwidth=bandwidth,
        )
        plan = plan_effects(scene.replace(coherent="off", roughness="off"), warn=False)
        decision = plan.decision("wideband")
        assert plan.sub_bands == count, decision
        assert "the diffuse return of rough" in decision.why
        linear = 20.0 * np.log10(bandwidth / 10e9 / np.sqrt(12.0))
        assert 3.0 < decision.error_db - linear < 6.5, decision  # sqrt(sigma0) as f^1.5 to f^2
        assert decision.error_db > -40.0


def sea_scene(frequency: float, share: float, look: float) -> Scene:
    """A square of sea, 30 range cells wide."""
    half = 15.0 * SPEED_OF_LIGHT / (2.0 * frequency * share)
    square = half * np.array([[-1.0, -1.0, 0.0], [1.0, -1.0, 0.0], [1.0, 1.0, 0.0], [-1.0, 1.0, 0.0]])
    sea = {"material": "sea_water", "diffuse_law": "sea", "wind_speed": 6.0}
    return scene_of(
        [SceneMesh(square, SQUARE, sea, "sea")],
        frequency=frequency,
        bandwidth=share * frequency,
        look=look,
        coherent="off",
        max_depth=1,
    )


CASES_OF_SEA = [(5.4e9, 0.05, 50.0), (3e9, 0.08, 60.0), (1.3e9, 0.05, 25.0)]


@pytest.mark.parametrize(("frequency", "share", "look"), CASES_OF_SEA)
def test_the_drift_of_bragg_waves_is_in_the_stated_change(
    frequency: float, share: float, look: float
) -> None:
    """Mean over band and track of the phase that the waves of the other frequencies gain on the carrier's."""
    scene = sea_scene(frequency, share, look)
    band_of = frequency * (1.0 + share * np.linspace(-0.5, 0.5, 101))
    short = 4.0 * np.pi / SPEED_OF_LIGHT * band_of * np.sin(np.radians(look))
    omega = np.sqrt(9.81 * short + 9.81 / 370.0**2 * short**3)
    gained = np.outer(scene.radar.track.time, omega - omega[50] * band_of / frequency)
    change = 10.0 * np.log10(np.mean(np.abs(np.exp(1j * gained) - 1.0) ** 2))
    decision = plan_effects(scene, warn=False).decision("wideband")
    # tol: incidence varies over the image
    assert decision.error_db > change - 1.0, (decision, change)
    assert decision.error_db < max(change, -40.0) + 1.0, (decision, change)  # -40 dB: the law of sigma0


@pytest.mark.slow
@pytest.mark.parametrize(("frequency", "share", "look"), CASES_OF_SEA)
def test_images_of_the_sea_change_as_stated(frequency: float, share: float, look: float) -> None:
    scene = sea_scene(frequency, share, look)
    stated = plan_effects(scene, warn=False).decision("wideband").error_db
    off, on = (render(scene.replace(wideband=switch)).data for switch in ("off", "on"))
    change = 10.0 * np.log10(np.sum(np.abs(off - on) ** 2) / np.sum(np.abs(on) ** 2))
    assert change < stated + 1.5, (change, stated)  # tol: speckle of the image, weights of the aperture
    assert change > stated - 12.0, (change, stated)  # tol: laws that are bounds


@pytest.mark.parametrize(("power", "bandwidth"), [(1, 0.11), (-1, 0.11), (3.5, 0.031)])
def test_random_scatterers_keep_their_mean_power(power: float, bandwidth: float) -> None:
    """Clutter whose amplitudes are a power of f over the band: the mean power and the statistics of a flat one."""
    rng = np.random.default_rng(int(10 * power) % 97)
    node, weight = np.polynomial.legendre.leggauss(120)
    amplitude = (1.0 + 0.5 * bandwidth * node) ** power
    places, cells = rng.uniform(-40.0, 40.0, 4000), np.arange(-30.0, 30.0)
    phases = np.exp(2j * np.pi * rng.random(4000))
    spectrum_of_clutter = np.exp(-1j * np.pi * np.outer(node, places)) @ phases
    got, flat = (
        np.exp(1j * np.pi * np.outer(cells, node)) @ (0.5 * weight * a * spectrum_of_clutter)
        for a in (amplitude, np.ones_like(node))
    )
    error = 10.0 * np.log10(np.mean(np.abs(got - flat) ** 2) / np.mean(np.abs(flat) ** 2))
    stated = 20.0 * np.log10(abs(power) * bandwidth / np.sqrt(12.0))
    assert abs(error - stated) < 1.5  # tol: 60 cells of speckle
    powers = np.mean(np.abs(got) ** 2), np.mean(np.abs(flat) ** 2)
    # tol: of first order in the error, -30 dB, times the correlation left between 60 cells, 1 / sqrt(60)
    assert abs(10.0 * np.log10(powers[0] / powers[1])) < 0.05


@pytest.mark.parametrize(("power", "bandwidth"), [(1, 0.11), (-1, 0.11), (3.5, 0.031)])
def test_what_is_odd_about_the_carrier_moves_neither_level_nor_place(power: float, bandwidth: float) -> None:
    """At B / fc = 0.11 a return as f or 1/f has the peak and the place of a flat one, and -30 dB of it beside them."""
    carrier = 1.0
    node, weight = np.polynomial.legendre.leggauss(200)
    amplitude = (1.0 + 0.5 * bandwidth / carrier * node) ** power
    cells = np.linspace(-3.0, 3.0, 6001)
    got, flat = (
        np.exp(1j * np.pi * np.outer(cells, node)) @ (0.5 * weight * a)
        for a in (amplitude, np.ones_like(node))
    )
    assert abs(np.abs(got).max() - 1.0) < 1.1e-3  # tol: of second order, (B / fc)^2 / 12
    assert abs(cells[np.abs(got).argmax()]) < 1e-9
    assert np.abs(got - flat).max() < 10.0 ** (-25.0 / 20.0)
    beside = np.abs(got[np.argmin(np.abs(cells - 1.0))])
    assert 0.01 < beside < 0.03  # the first null of a flat return


def test_a_table_of_paths_says_that_it_holds_the_carrier() -> None:
    """A path has one amplitude in a table."""
    scene = scene_of([SceneMesh(facing(np.zeros(3), (0.5, 0.5)), SQUARE, "pec", "plate")])
    with pytest.warns(SarmitsubaWarning, match="amplitudes at the carrier"):
        trace_paths(scene)


def test_shares_sum_to_one_and_are_exact_for_powers() -> None:
    """Interpolation from n frequencies has every power of f up to n - 1, and the response is that of its share."""
    for count in (1, 2, 5, 9):
        bands = SubBands(10.0, 8.0, count)
        f = np.linspace(6.0, 14.0, 33)
        shares = bands.shares(f)
        for power in range(count):
            np.testing.assert_allclose(bands.frequencies**power @ shares, f**power, rtol=1e-9)
        node, weight = np.polynomial.legendre.leggauss(60)
        x = np.array([-3.3, -0.2, 0.0, 1.0, 4.7])
        turn = np.exp(1j * np.pi * np.outer(node, x))
        for i in range(count):
            wanted = 0.5 * (weight * bands.shares(10.0 + 4.0 * node)[i]) @ turn
            np.testing.assert_allclose(bands.response(i, x), wanted, atol=1e-9)
