"""The image-domain methods against the focused image of raw data: place, calibration, phase, statistics."""

from dataclasses import replace

import numpy as np
import pytest

from sarmitsuba.loading.load import load_scene
from sarmitsuba.scene.geometry import PointTarget
from sarmitsuba.scene.scene import Scene
from sarmitsuba.signal.focusing import default_grid
from sarmitsuba.signal.metrics import image_error_db
from sarmitsuba.simulation.execution.image import Imager
from sarmitsuba.simulation.execution.render import simulate
from sarmitsuba.simulation.execution.run import Run
from sarmitsuba.simulation.planning.pilot import plan_scene
from sarmitsuba.simulation.planning.sampling.density_plan import LOOK_SPACING, SamplingPlan
from sarmitsuba.simulation.planning.sampling.piece import crop
from tests.support.unweighted import focus, render


def points_only(**parameters: str) -> Scene:
    """Three ideal points of different RCS, phase and height, off the pixels."""
    scene = load_scene("point", parameters=parameters)
    middle = scene.points[0].position
    points = (
        PointTarget("a", middle, 1.0, 0.0),
        PointTarget("b", middle + np.array([3.13, -4.41, 0.0]), 4.0, 1.0),
        PointTarget("c", middle + np.array([-4.21, 3.17, 3.0]), 0.25, -2.0),
    )
    return replace(scene, points=points)


@pytest.mark.parametrize(
    ("parameters", "windows"),
    [
        ({}, {}),
        ({}, {"range_window": "hamming", "azimuth_window": "taylor"}),
        ({"range_film.image_grid": "ground"}, {}),
        ({"sar_antenna.squint_angle_deg": "8", "sar_antenna.mode": "spotlight"}, {}),
    ],
    ids=["slant", "windows", "ground", "squint"],
)
def test_points_match_the_focused_image(parameters: dict[str, str], windows: dict[str, str]) -> None:
    # Rationale: for points the only approximations of `image` are one look for the aperture and a finite image: peaks
    # agree in value and phase, and the side lobes to the wrap-around of their tails.
    scene = points_only(**parameters)
    exact = render(scene, method="hybrid", **windows)
    quick = render(scene, method="image", **windows)
    a, b = exact.total(), quick.total()
    peak = np.unravel_index(np.abs(a).argmax(), a.shape)
    # tol: wrap-around of the side lobes of a grid that ends 24 cells beyond the image, 0.3 %
    assert abs(b[peak] / a[peak] - 1.0) < 0.02
    # tol: the same over all pixels; squint adds the change of the response over the image
    assert image_error_db(b, a) < -25.0
    assert quick.azimuth_resolution_cell == pytest.approx(exact.azimuth_resolution_cell, rel=1e-6)
    assert np.array_equal(quick.grid.range, exact.grid.range)


@pytest.mark.parametrize("name", ["flat_ground", "dihedral", "courtyard", "tower"])
def test_every_ray_spacing_that_a_run_advises_changes_its_rays(name: str) -> None:
    """Rays for one kind of return (diffuse, coherent), one lattice for both, and two lattices."""
    scene = load_scene(name)
    plan = SamplingPlan.of(scene, plan_scene(scene, pilot=False).flags)
    denser = plan.spacings.at(0.5)

    def lattices(**spacings: float) -> object:
        changed = replace(scene, settings=replace(scene.settings, **spacings))  # type: ignore[arg-type]
        return plan.obeying(changed, plan.flags).purposes()

    for setting in denser:
        assert lattices(**{k: v for k, v in denser.items() if k != setting}) != lattices(**denser), setting


def test_patterned_stripmap_has_apertures_of_its_pixels() -> None:
    # Rationale: with a beam fixed to the track every pixel has an aperture of its own, about its own broadside.
    scene = points_only(
        **{
            "sar_antenna.pattern": "gaussian",
            "sar_antenna.azimuth_beamwidth_deg": "0.8",
            "sar_antenna.elevation_beamwidth_deg": "20",
        }
    )
    grid = default_grid(scene.radar, scene.image)
    imager = Imager(Run(scene), grid)
    assert imager.look.grid.fan is not None and imager.look.grid.fan.curvature == pytest.approx(0.0, abs=1e-9)
    a = render(scene, method="hybrid", grid=grid).total()
    b = imager.image().total()
    peak = np.unravel_index(np.abs(a).argmax(), a.shape)
    # tol: 0.05 dB and 0.3 deg: gridding
    assert abs(b[peak] / a[peak] - 1.0) < 0.006
    assert image_error_db(b, a) < -30.0  # tol: side lobes that lie beyond the pulse rate


def test_dihedral_double_bounce_has_the_same_value_and_phase() -> None:
    scene = load_scene("dihedral")
    raw = simulate(scene)
    grid = default_grid(scene.radar, scene.image)
    a, b = focus(raw, grid), render(scene, method="image", grid=grid)
    for channel in a.channels:
        x, y = a.total(channel), b.total(channel)
        peak = np.unravel_index(np.abs(x).argmax(), x.shape)
        # tol: the same rays; block synthesis (-40 dB) and side-lobe wrap
        assert abs(y[peak] / x[peak] - 1.0) < 0.015


def test_tower_agrees_in_clutter_layover_and_orders() -> None:
    # Rationale: cells keep their scatterers, so even the speckle is the same; what differs is how the view changes
    # over the aperture.
    scene = crop(load_scene("tower"), 0.4, 0.1)
    scene = replace(scene, settings=replace(scene.settings, keep_orders=True, max_depth=2))
    a, b = (render(scene, method=m) for m in ("hybrid", "image"))
    assert a.layers == b.layers
    assert image_error_db(b.total(), a.total()) < -20.0
    for x, y in zip(a.data, b.data, strict=True):
        # tol: view changes over the aperture, and the window's faded edge
        assert image_error_db(y, x) < -14.0


def test_raster_has_the_clutter_level_and_speckle_of_flat_ground() -> None:
    # Rationale: the expected intensity of flat ground is sigma0 times the cell, and one look has mean = std.
    scene = load_scene("flat_ground")
    image = render(scene, method="raster")
    inner = image.sigma0()[12:-12, 12:-12]
    looks = (
        inner.size
        * (image.grid.azimuth_spacing / image.azimuth_resolution_cell)
        * (image.grid.range_spacing / image.range_resolution_cell)
    )
    sigma = 1.0 / np.sqrt(looks)
    # tol: 4 sigma of speckle, and 0.1 dB for sampling the surface
    assert abs(inner.mean() / 0.1 - 1.0) < 4.0 * sigma + 0.025
    # tol: 4 sigma; the std of an exponential's sample std is about sqrt(2) sigma
    assert abs(inner.std() / inner.mean() - 1.0) < 8.0 * sigma


def test_imager_repeats_itself_and_passes_differ() -> None:
    scene = crop(load_scene("tower"), 0.2, 0.05)
    imager = Imager(Run(scene))
    first, again, other = (
        imager.image().total(),
        imager.image().total(),
        imager.image(pass_index=1).total(),
    )
    # tol: float32 sums in whatever order threads finish
    assert image_error_db(again, first) < -90.0
    assert -90.0 < image_error_db(other, first) < -10.0


def test_one_look_takes_fewer_coherent_rays_where_they_are_sparse_already() -> None:
    city = load_scene("buildings16")
    sampling = SamplingPlan.of(city, plan_scene(city).flags)
    look = sampling.of_one_look().spacings
    assert look.coherent == pytest.approx(LOOK_SPACING * sampling.spacings.coherent)
    # diffuse rays stay: wider ones would blur the rims of shadows
    assert look.diffuse == sampling.spacings.diffuse
    asked = SamplingPlan.of(replace(city, settings=replace(city.settings, ray_spacing=0.3)), sampling.flags)
    assert asked.of_one_look() is asked and asked.spacings.coherent == 0.3
    small = load_scene("dihedral")  # several rays per wavelength: a small target's shape needs them
    sampling = SamplingPlan.of(small, plan_scene(small).flags)
    assert sampling.of_one_look() is sampling


@pytest.mark.filterwarnings(
    "ignore:.*the image is not usable"
)  # few pulses; the bits are compared, not the level
@pytest.mark.parametrize("depth", ["2", "3"])
def test_layers_by_bounces_do_not_depend_on_how_deep_rays_are_followed(depth: str) -> None:
    # Rationale: an echo back along its chain has 2 n - 1 bounces where its ray has n, so that two bounces of rays
    # suffice for the third line of the bridge; it must not be filed under two.
    radar = {"sar_antenna.bandwidth": "100e6", "sar_antenna.azimuth_resolution": "3"}
    radar |= {"range_film.image_extent_azimuth": "60", "sar_path.keep_orders": "true"}
    deep, less = (
        render(load_scene("bridge", parameters=radar | {"sar_path.max_depth": n})) for n in ("4", depth)
    )
    orders = {(layer.order, layer.subset): x for layer, x in zip(deep.layers, deep.data, strict=True)}
    for layer, x in zip(less.layers, less.data, strict=True):
        # tol: other numbers of layers compile other kernels, whose sums differ by rounding
        assert image_error_db(x, orders[layer.order, layer.subset]) < -80.0
    assert max(layer.order for layer in less.layers) == 3
