"""Vegetation against closed forms: layer over ground, attenuation, trunks on ground, levels of presets."""

from dataclasses import replace

import numpy as np

from sarmitsuba.core.arrays import F64
from sarmitsuba.core.units import db_from_power, power_from_db
from sarmitsuba.loading.build import SceneMesh, SceneVolume, build_scene
from sarmitsuba.radar.description import RadarDescription
from sarmitsuba.radar.film import FilmDescription
from sarmitsuba.scene.materials.named_materials import MATERIALS
from sarmitsuba.scene.materials.vegetation.canopy import CANOPIES, water_cloud
from sarmitsuba.scene.mesh import tessellate
from sarmitsuba.scene.scene import Scene
from sarmitsuba.scene.settings import Switch, TraceSettings
from sarmitsuba.signal.image import SarImage
from sarmitsuba.simulation.execution.render import render
from sarmitsuba.truth import theory
from sarmitsuba.truth.validation.cases import CASES, CaseEntry
from sarmitsuba.truth.validation.chain import suppress_warnings
from sarmitsuba.truth.validation.comparison import Case, Comparison

BANDS = {"L": 1.27e9, "C": 5.4e9, "X": 9.65e9}
CHANNELS = ("HH", "VV", "HV")


def _square(half: float, height: float = 0.0) -> tuple[F64, list[list[int]]]:
    corners = [[-half, -half, height], [half, -half, height], [half, half, height], [-half, half, height]]
    return np.array(corners), [[0, 1, 2], [0, 2, 3]]


def _radar(look: float, heading: float, cell: float, **more: object) -> RadarDescription:
    values = {
        "slant_range": 8e3,
        "aim_x": 0.0,
        "aim_y": 0.0,
        "aim_z": 0.0,
        "center_frequency": 9.65e9,
        **more,
    }
    return RadarDescription(
        look_angle_deg=look,
        heading_deg=heading,
        bandwidth=149.896e6 / cell,
        azimuth_resolution=cell,
        polarisation="HH,VV,HV",
        **values,  # type: ignore[arg-type]
    )


def _image(scene: Scene) -> SarImage:
    with suppress_warnings():
        return render(scene, range_window="rectangular", azimuth_window="rectangular")


def layer(quick: bool = False) -> Case:
    """Mean sigma0 of a level layer over diffuse ground, drawn angles, headings, depths and extinctions."""
    rng = np.random.default_rng(171)
    n, half, cell = (1, 12.0, 0.5) if quick else (6, 20.0, 0.5)
    angles, want, got = np.zeros(n), np.zeros((3, n)), np.zeros((3, n))
    for i in range(n):
        look, heading, depth = rng.uniform(25.0, 55.0), rng.uniform(0.0, 360.0), rng.uniform(2.0, 5.0)
        kappa = rng.uniform(0.02, 0.25, 2)
        sigma_v = rng.uniform(0.02, 0.08, 2)
        cloud = water_cloud("cloud", (sigma_v[0], sigma_v[1]), (kappa[0], kappa[1]), 0.2)
        vertices, faces = tessellate.cube()
        margin = half * np.sqrt(2.0) + 8.0
        scene = build_scene(
            [
                SceneMesh(
                    *_square(margin + 4.0),
                    {
                        "permittivity_real": 6.0,
                        "rms_height": 0.05,
                        "diffuse_law": "constant_gamma",
                        "diffuse_level_db": -8.0,
                    },
                    "ground",
                )
            ],
            volumes=[
                SceneVolume(vertices * [margin, margin, depth / 2] + [0.0, 0.0, depth / 2], faces, cloud)
            ],
            radar=_radar(look, heading, cell),
            film=FilmDescription(image_extent_azimuth=2.0 * half, image_extent_range=2.0 * half),
            settings=TraceSettings(method="image", seed=i, max_depth=1),
        )
        image = _image(scene)
        theta = float(np.mean(image.incidence_angle))
        angles[i] = np.degrees(theta)
        extinction = (*kappa, kappa.mean())
        powers = (*sigma_v, 0.2 * np.sqrt(sigma_v.prod()))
        ground = power_from_db(-8.0) * np.cos(theta) * np.array([1.0, 1.0, 0.0])
        for c, channel in enumerate(CHANNELS):
            want[c, i] = theory.water_cloud_sigma0(powers[c], extinction[c], depth, theta, ground[c])
            got[c, i] = image.sigma0(channel).mean()
    order = np.argsort(angles)
    sigma = 10.0 / np.log(10.0) / np.sqrt((2.0 * half) ** 2 / cell**2)
    return Case(
        name="volume_layer",
        topic="vegetation",
        title="A layer of scatterers over ground",
        formula="sigma0 = sigma_v cos t / (2 k) (1 - exp(-2 k d / cos t)) + sigma0_ground exp(-2 k d / cos t)",
        source="Attema & Ulaby 1978 (water cloud); drawn angles, headings, depths, extinctions and levels",
        x_label="incidence angle (deg)",
        y_label="sigma0 (dB)",
        comparisons=tuple(
            Comparison(
                channel,
                angles[order],
                np.asarray(db_from_power(want[c, order])),
                np.asarray(db_from_power(got[c, order])),
                tolerance=0.3 if not quick else float(max(0.3, 4.0 * sigma)),
                reason=f"asked for; speckle of {2 * half / cell:.0f}^2 cells leaves {sigma:.2f} dB",
                unit="dB",
                shown=0,
            )
            for c, channel in enumerate(CHANNELS)
        ),
        note=f"Method image, cells of {cell} m, mean over {2 * half:g} m x {2 * half:g} m.",
    )


def crown_ground(quick: bool = False) -> Case:
    """Mean sigma0 of a layer over smooth ground, with one and with two ground reflections."""
    rng = np.random.default_rng(174)
    n, half, cell = (1, 12.0, 0.5) if quick else (5, 20.0, 0.5)
    angles, want, got = np.zeros(n), np.zeros((4, n)), np.zeros((4, n))
    vertices, faces = tessellate.cube()
    for i in range(n):
        look, heading, depth = rng.uniform(25.0, 55.0), rng.uniform(0.0, 360.0), rng.uniform(1.0, 3.0)
        kappa, sigma_v, eps = rng.uniform(0.02, 0.15, 2), rng.uniform(0.02, 0.08, 2), rng.uniform(5.0, 20.0)
        cloud = water_cloud("cloud", (sigma_v[0], sigma_v[1]), (kappa[0], kappa[1]), 0.2)
        margin = half * np.sqrt(2.0) + 14.0
        scene = build_scene(
            [SceneMesh(*_square(margin + 4.0), {"permittivity_real": eps}, "ground")],
            volumes=[
                SceneVolume(vertices * [margin, margin, depth / 2] + [0.0, 0.0, depth / 2], faces, cloud)
            ],
            radar=_radar(look, heading, cell),
            film=FilmDescription(image_extent_azimuth=2.0 * half, image_extent_range=2.0 * half),
            settings=TraceSettings(method="image", seed=i, keep_orders=True),
        )
        image = _image(scene)
        theta = float(np.mean(image.incidence_angle))
        angles[i] = np.degrees(theta)
        for c, reflection in enumerate(theory.fresnel(np.cos(theta), eps)):
            channel = CHANNELS[c]
            layers = zip(image.layers, image.data, strict=True)
            orders = {layer.order: data for layer, data in layers if layer.channel == channel}
            scale = image.sigma0(channel).mean() / np.mean(np.abs(sum(orders.values())) ** 2)
            closed = theory.crown_ground_sigma0(sigma_v[c], kappa[c], depth, theta, complex(reflection))
            for j, order in enumerate((2, 3)):
                want[2 * c + j, i] = closed[j]
                got[2 * c + j, i] = scale * np.mean(np.abs(orders[order]) ** 2)
    order_of = np.argsort(angles)
    sigma = 10.0 / np.log(10.0) / np.sqrt((2.0 * half) ** 2 / cell**2)
    return Case(
        name="crown_ground",
        topic="vegetation",
        title="A layer of scatterers by way of smooth ground",
        formula="once: 4 sigma_v d |G|^2 exp(-2 k d / cos t); both ways: the layer's own |G|^4 exp(-2 k d / cos t)",
        source="Ulaby, Sarabandi et al. 1990 (MIMICS), crown-ground and ground-crown-ground terms; Fresnel",
        x_label="incidence angle (deg)",
        y_label="sigma0 (dB)",
        comparisons=tuple(
            Comparison(
                f"{channel}, {way}",
                angles[order_of],
                np.asarray(db_from_power(want[2 * c + j, order_of])),
                np.asarray(db_from_power(got[2 * c + j, order_of])),
                tolerance=float(max(0.4, 4.0 * sigma)),
                reason=f"speckle: once over the ground all of a column is in one cell; {sigma:.2f} dB a look",
                unit="dB",
                shown=0,
            )
            for c, channel in enumerate(CHANNELS[:2])
            for j, way in enumerate(("once", "both ways"))
        ),
        note="Drawn angles, headings, depths, extinctions, levels and permittivities. A cloud returns over the ground "
        "what it returns backwards.",
    )


def attenuation(quick: bool = False) -> Case:
    """Return of a plate under a ball of leaves over that of the bare plate, ball and directions drawn."""
    rng = np.random.default_rng(172)
    n = 1 if quick else 8
    paths, want, got = np.zeros(n), np.zeros((2, n)), np.zeros((2, n))
    ball, faces = tessellate.sphere(1.0, 1e-3)
    for i in range(n):
        look, heading = rng.uniform(20.0, 60.0), rng.uniform(0.0, 360.0)
        radius, kappa = rng.uniform(1.0, 4.0), rng.uniform(0.05, 0.4, 2)
        middle = rng.uniform(-0.6, 0.6, 3) * radius + [0.0, 0.0, 1.0]
        dark = water_cloud("dark", (1e-12, 1e-12), (kappa[0], kappa[1]), 0.0)
        radar = _radar(look, heading, 1.0)
        film = FilmDescription(image_extent_azimuth=8.0, image_extent_range=8.0)
        direction = build_scene([SceneMesh(*_square(1.0), "pec", "plate")], radar=radar, film=film)
        to_radar = direction.radar.track.center_position / np.linalg.norm(
            direction.radar.track.center_position
        )
        turned = np.stack([np.cross(to_radar, [0.0, 0.0, 1.0]), np.zeros(3), to_radar])
        turned[0] /= np.linalg.norm(turned[0])
        turned[1] = np.cross(to_radar, turned[0])
        corners, triangles = _square(0.05)
        scene = build_scene(
            [SceneMesh(corners @ turned, triangles, "pec", "plate")],
            volumes=[SceneVolume(ball * radius + middle, faces, dark)],
            radar=radar,
            film=film,
            settings=TraceSettings(method="image"),
        )
        peaks = []
        for switch in ("on", "off"):
            switches: dict[str, Switch] = {"vegetation": switch}
            settings = replace(scene.settings, effects=switches)
            image = _image(replace(scene, settings=settings))
            peaks.append([image.rcs(channel).max() for channel in CHANNELS[:2]])
        path = float(theory.path_in_ball(np.zeros(3), to_radar, np.inf, middle, radius))
        paths[i] = path
        want[:, i] = -20.0 / np.log(10.0) * kappa * path
        got[:, i] = db_from_power(np.array(peaks[0]) / np.array(peaks[1]))
    order = np.argsort(paths)
    return Case(
        name="volume_attenuation",
        topic="vegetation",
        title="What a crown takes from what stands in it",
        formula="exp(-2 k s), s the way through the ball",
        source="extinction on both ways; way of a line through a sphere; drawn balls, directions and extinctions",
        x_label="way through the ball (m)",
        y_label="two-way attenuation (dB)",
        comparisons=tuple(
            Comparison(
                channel,
                paths[order],
                want[c, order],
                got[c, order],
                tolerance=0.05,
                reason="facets of the ball, 0.1 % of its radius, and 0.1 m of plate: times 8.7 k",
                unit="dB",
                shown=0,
            )
            for c, channel in enumerate(CHANNELS[:2])
        ),
        note="A plate of 0.1 m across the line of sight in a ball that returns nothing, H and V taken differently.",
    )


def trunks(quick: bool = False) -> Case:
    """Dihedral of an upright trunk and ground at L band, within an attenuating ball."""
    rng = np.random.default_rng(173)
    angles = np.array([35.0]) if quick else np.array([32.0, 38.0, 44.0, 50.0, 56.0])
    want, got = np.zeros((2, angles.size)), np.zeros((2, angles.size))
    frequency, height = BANDS["L"], 4.0
    wavelength = 299_792_458.0 / frequency
    wood, soil = (MATERIALS[name].permittivity(frequency) for name in ("fresh_wood", "medium_dry_ground"))
    ball, ball_faces = tessellate.sphere(1.0, 1e-3)
    for i, look in enumerate(angles):
        radius, kappa = rng.uniform(0.25, 0.4), rng.uniform(0.01, 0.05, 2)
        vertices, faces = tessellate.cylinder(radius, 0.0, height, wavelength / 512.0)
        dark = water_cloud("dark", (1e-12, 1e-12), (kappa[0], kappa[1]), 0.0)
        scene = build_scene(
            [
                SceneMesh(*_square(12.0), {"material": "medium_dry_ground", "smooth": True}, "ground"),
                SceneMesh(vertices, faces, {"material": "fresh_wood", "smooth": True}, "trunk", smooth=True),
            ],
            # so high that only legs along the lines of sight cross it
            volumes=[SceneVolume(ball * [9.0, 9.0, 2.0] + [0.0, 0.0, 8.0], ball_faces, dark)],
            radar=_radar(float(look), float(rng.uniform(0.0, 360.0)), 1.0, center_frequency=frequency),
            film=FilmDescription(
                image_extent_azimuth=4.0,
                image_extent_range=4.0,
                pixel_spacing_azimuth=0.1,
                pixel_spacing_range=0.1,
            ),
            settings=TraceSettings(method="image", max_depth=2),
        )
        image = _image(scene)
        theta = float(np.mean(image.incidence_angle))
        sight = np.array([np.sin(theta), 0.0, np.cos(theta)])
        # the mean path: over the ground in front of the trunk and up from its middle
        starts = np.stack([[0.0, 0.0, z] for z in np.linspace(0.0, height, 9)])
        fronts = np.stack([[z * np.tan(theta), 0.0, 0.0] for z in np.linspace(0.0, height, 9)])
        stretch, center = np.array([1.0, 1.0, 4.5]), np.array([0.0, 0.0, 36.0])
        length = np.linalg.norm(sight * stretch)
        path = sum(
            theory.path_in_ball(p * stretch, sight * stretch / length, np.inf, center, 9.0)
            for p in (starts, fronts)
        ) / (2.0 * length)
        rcs = theory.trunk_ground_rcs(radius, height, wavelength, theta, wood, soil)
        for c, channel in enumerate(CHANNELS[:2]):
            kept = np.mean(np.exp(-kappa[c] * path)) ** 2
            want[c, i] = db_from_power(rcs[c] * kept)
            got[c, i] = db_from_power(image.rcs(channel).max())
    return Case(
        name="trunk_ground",
        topic="vegetation",
        title="A trunk on ground at L band, seen through a crown",
        formula="sigma = 4 k a h^2 sin t |G_trunk(90 - t) G_ground(t)|^2 exp(-2 k s)",
        source="Ruck et al. 1970, 4.3-62, with the image in the ground; Fresnel; permittivity by Ulaby & El-Rayes 1987",
        x_label="look angle (deg)",
        y_label="radar cross section (dBsm)",
        comparisons=tuple(
            Comparison(
                channel,
                angles,
                want[c],
                got[c],
                tolerance=0.5,
                reason="k a of 7 to 11: so bent a mirror; the closed form has its reflection at one angle",
            )
            for c, channel in enumerate(CHANNELS[:2])
        ),
        note=f"Trunk {height:g} m high, radius drawn from 0.25 to 0.4 m, heading drawn. Steeper, VV meets the trunk "
        "near the Brewster angle, where both differ by more (1.5 dB at 25 deg).",
    )


# co-polar sigma0 at 40 degrees, dB: what 90 % of all trees return, about
PUBLISHED = {"L": (-19.0, -7.0), "C": (-17.0, -6.0), "X": (-16.0, -5.0)}


def presets(quick: bool = False) -> Case:
    """Sigma0 of deep canopies of the presets against the range of published measurements."""
    theta, depth = np.radians(40.0), 10.0
    x = np.arange(1.0, 4.0)
    middle = np.array([np.mean(PUBLISHED[band]) for band in BANDS])
    half = 0.5 * max(high - low for low, high in PUBLISHED.values())
    comparisons = []
    for name in ("conifer",) if quick else ("deciduous_summer", "deciduous_winter", "conifer"):
        media = [CANOPIES[name].medium(frequency) for frequency in BANDS.values()]
        at = [medium.at(float(np.cos(theta))) for medium in media]
        for c, channel in enumerate(CHANNELS[:2]):
            level = [theory.water_cloud_sigma0(power[c], kappa[c], depth, theta) for kappa, power in at]
            comparisons.append(
                Comparison(
                    f"{name}, {channel}",
                    x,
                    middle,
                    np.asarray(db_from_power(np.array(level))),
                    tolerance=half,
                    reason="half the range of 90 % of measurements; the theory here is the range's middle",
                    unit="dB",
                    shown=1,
                )
            )
    return Case(
        name="canopies",
        topic="vegetation",
        title="Canopies of the presets and measurements",
        formula="water cloud of 10 m with the preset's figures; L -19 ... -7, C -17 ... -6, X -16 ... -5 dB at 40 deg",
        source="ranges of trees as we remember Ulaby & Dobson 1989, Handbook of Radar Scattering Statistics for "
        "Terrain, rounded outwards; not read off the tables again",
        x_label="band: 1 L, 2 C, 3 X",
        y_label="sigma0 (dB)",
        comparisons=tuple(comparisons),
        note="Crowns alone, without trunks and ground.",
    )


for _name, _build in (
    ("volume_layer", layer),
    ("crown_ground", crown_ground),
    ("volume_attenuation", attenuation),
    ("trunk_ground", trunks),
    ("canopies", presets),
):
    CASES.register(CaseEntry(_name, "vegetation", _build))
