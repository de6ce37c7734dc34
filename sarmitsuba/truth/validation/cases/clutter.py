"""Textured clutter and maps of surfaces: K statistics, autocorrelation, levels and places of maps, land cover."""

from collections.abc import Sequence
from dataclasses import replace
from functools import cache

import numpy as np
from scipy.signal.windows import taylor
from scipy.special import gammainc
from scipy.stats import kstest

from sarmitsuba.core.arrays import F64, I64
from sarmitsuba.core.constants import SPEED_OF_LIGHT
from sarmitsuba.core.units import db_from_power, power_from_db
from sarmitsuba.machine.backend import device_array, dr, mi
from sarmitsuba.scene.materials.map_materials import vary_material
from sarmitsuba.scene.materials.material import ClassMap, Material, SurfaceMaps
from sarmitsuba.scene.materials.texture import Bitmap, place_in_plan
from sarmitsuba.scene.scene import Scene
from sarmitsuba.scene.settings import TraceSettings
from sarmitsuba.signal.image import SarImage
from sarmitsuba.simulation.execution.render import render
from sarmitsuba.tracing.kernel.speckle import SurfacePlace
from sarmitsuba.tracing.kernel.surface_tables import SurfaceTables
from sarmitsuba.truth import theory
from sarmitsuba.truth.validation import targets
from sarmitsuba.truth.validation.cases import CASES, CaseEntry
from sarmitsuba.truth.validation.chain import ground_scene, suppress_warnings
from sarmitsuba.truth.validation.comparison import CONFIDENCE, CRITICAL_DISTANCE, Case, Comparison

LEVEL_DB = -10.0
# resolution cell and correlation length of the focused image, m; its pixels are a cell apart
CELL, LENGTH = 1.0, 6.0
WINDOW = "taylor:4:-35"
SEED = 3
# pixels of the image's rim, where the resolution cells of the edge lie
RIM = 8


def texture_at(shape: float, length: float, x: F64, y: F64, seed: int = SEED) -> F64:
    """Texture of the program (n,) at positions on level ground, m."""
    material = Material("ground", pec=True, texture_shape=shape, texture_length=length)
    tables = SurfaceTables.of(
        targets.plate(1.0, 1.0), np.arange(2), (material,), np.zeros(1, dtype=np.uint32)
    )
    assert tables is not None
    points = mi.Vector3d(device_array(mi.Float64, x), device_array(mi.Float64, y), mi.Float64(0.0))
    none = mi.UInt32(0)
    amplitude = tables.amplitude(
        none,
        none,
        dr.zeros(mi.UInt32, x.size),
        mi.Vector3f(0.0),
        SurfacePlace.of(points, mi.Vector3d(0.0, 0.0, 1.0)),
        mi.UInt32(seed),
        mi.Bool(True),
    )
    return np.asarray(amplitude.numpy(), dtype=np.float64) ** 2


def _ground(n_cells: float, material: Material | None = None, **changes: float) -> Scene:
    """Level ground, imaged in one look with pixels a cell apart."""
    scene = ground_scene(
        40.0,
        CELL,
        40e3,
        LEVEL_DB,
        n_cells=n_cells,
        settings=TraceSettings(method="image", seed=SEED, effects={"coherent": "off"}),
        image_grid="ground",
        pixel_spacing_azimuth=CELL,
        pixel_spacing_range=CELL / np.sin(np.radians(40.0)),
        **changes,
    )
    return scene if material is None else replace(scene, materials=(material,))


def _image(scene: Scene) -> SarImage:
    with suppress_warnings():
        return render(scene, range_window=WINDOW, azimuth_window=WINDOW)


@cache
def _clutter(shape: float, n_cells: float) -> F64:
    """Intensity relative to the given level, without the image's rim."""
    own = _ground(n_cells).materials[0]
    image = _image(_ground(n_cells, replace(own, texture_shape=shape, texture_length=LENGTH)))
    return np.asarray(image.sigma0()[RIM:-RIM, RIM:-RIM] / power_from_db(LEVEL_DB))


def k_distribution(quick: bool = False) -> Case:
    """Focused ground with a gamma texture against the K distribution: level, distribution, moments of 1 and 9 looks."""
    comparisons: list[Comparison] = []
    shapes, n_cells = ((1.0,), 450.0) if quick else ((0.5, 1.0, 8.0), 900.0)
    for shape in shapes:
        intensity = _clutter(shape, n_cells)
        left = theory.averaged_shape(shape, LENGTH, _responses())
        # in range they lie wider apart on the ground
        independent = intensity[:: round(2.2 * LENGTH / CELL), :: round(2.2 * LENGTH / CELL)].ravel()
        comparisons += _k_image(shape, left, intensity, independent)
    return Case(
        name="k_distribution",
        topic="statistics",
        title="K-distributed clutter",
        formula="P(I < x) = 1 - 2 / Gamma(nu) (nu x)^(nu/2) K_nu(2 sqrt(nu x)), <I^n> = product of gamma moments",
        source="Jakeman and Pusey (1976); Oliver and Quegan, section 5.3",
        x_label="intensity over mean, order of the moment, or number of looks",
        y_label="probability or moment",
        comparisons=tuple(comparisons),
        note=f"One look of {n_cells:g} x {n_cells:g} cells of {CELL:g} m, correlation length {LENGTH:g} m; a "
        "resolution cell averages the texture a little, by theory.averaged_shape. K-S: pixels 2.2 lengths apart.",
    )


def _responses() -> list[tuple[F64, F64]]:
    """Impulse response of the windowed image on the ground, azimuth and range: places (m) and power."""
    window = taylor(256, nbar=4, sll=35, sym=True)
    frequency = (np.arange(256) + 0.5) / 256.0 - 0.5
    place = np.linspace(-12.0, 12.0, 481)
    power = np.abs(np.exp(2j * np.pi * np.outer(place, frequency)) @ window) ** 2
    return [(place * CELL, power), (place * CELL / np.sin(np.radians(40.0)), power)]


def _k_image(shape: float, left: float, intensity: F64, independent: F64) -> list[Comparison]:
    """Comparisons of one shape; ``left`` of it after averaging."""
    # patches of texture that are independent, and relative errors of means over them
    patches = intensity.size * CELL**2 / np.sin(np.radians(40.0)) / (np.pi * LENGTH**2)
    error = np.sqrt(1.0 / left / patches + theory.k_moment(2, left) / intensity.size)
    test = kstest(independent, lambda x: theory.k_cdf(x, 1.0, left))
    level = np.linspace(0.05, 6.0, 60)
    empirical = np.searchsorted(np.sort(independent), level) / independent.size
    limit = CRITICAL_DISTANCE / np.sqrt(independent.size) + 0.25 * error
    out = [
        Comparison(
            f"mean level, nu = {shape:g}",
            np.ones(1),
            np.zeros(1),
            db_from_power(np.array([intensity.mean()])),
            tolerance=float(10.0 / np.log(10.0) * 4.0 * error),
            reason=f"4 standard errors of {patches:.0f} patches of texture",
            unit="dB",
        ),
        Comparison(
            f"K-S distance to the K distribution, nu = {shape:g}, n = {independent.size}",
            np.zeros(1),
            np.zeros(1),
            np.array([test.statistic]),
            tolerance=float(limit),
            reason=f"critical distance at {100 * CONFIDENCE:g} %, and a quarter of the mean's error",
            unit="",
        ),
        Comparison(
            f"distribution of intensity, nu = {shape:g}",
            level,
            theory.k_cdf(level, 1.0, left),
            empirical,
            tolerance=float(limit),
            reason="as above",
            unit="",
            shown=int(np.argmin(np.abs(level - np.log(2.0)))),
        ),
    ]
    # 3 x 3 looks: pixels two cells apart are independent speckle of nearly the same texture
    rows, columns = (2 * (n // 6) * 3 for n in intensity.shape)
    looks = intensity[:rows:2, :columns:2].reshape(rows // 6, 3, columns // 6, 3)
    mean = looks.mean(axis=(1, 3))
    lag = 2.0 * CELL * np.array([1.0, 1.0 / np.sin(np.radians(40.0))])
    offset = np.arange(3) - np.arange(3)[:, None]
    share = np.prod([theory.asked_correlation(offset * step, LENGTH).mean() for step in lag])
    # speckle of 9 looks, less what their textures differ
    several = 1.0 + share / left + 1.0 / 9.0 * (1.0 + 1.0 / left)
    for label, values, want in (
        ("second moment, 1 look", intensity, theory.k_moment(2, left)),
        ("second moment, 9 looks", mean, several),
    ):
        moments = np.square(values).mean() / values.mean() ** 2
        out.append(
            Comparison(
                f"{label}, nu = {shape:g}",
                np.full(1, 2.0),
                np.array([want]),
                np.array([moments]),
                tolerance=float(4.0 * want * np.sqrt(_second_variance(left) / patches + 20.0 / values.size)),
                reason="4 standard errors: texture's own second moment over independent patches, and speckle's",
                unit="",
            )
        )
    return out


def _second_variance(shape: float) -> float:
    """Relative variance of one sample of the texture's square over the square of its mean."""
    second, fourth = (theory.k_moment(n, shape, np.inf) for n in (2, 4))
    third = theory.k_moment(3, shape, np.inf)
    # of the ratio <t^2> / <t>^2, to first order
    return float((fourth / second**2 - 1.0) - 4.0 * (third / second - 1.0) + 4.0 * (second - 1.0))


def gamma_texture(quick: bool = False) -> Case:
    """Texture at random positions: gamma law, moments, autocorrelation in random directions."""
    comparisons: list[Comparison] = []
    rng = np.random.default_rng(17)
    n = 60_000 if quick else 400_000
    for shape in (0.3, 2.0) if quick else (0.1, 0.5, 2.0, 50.0):
        length = float(rng.uniform(0.5, 40.0))
        x, y = rng.uniform(-3e4, 3e4, (2, n)) * length
        tau = texture_at(shape, length, x, y)
        test = kstest(tau, lambda t, nu=shape: gammainc(nu, nu * np.maximum(t, 0.0)))
        comparisons.append(
            Comparison(
                f"K-S distance to the gamma law, nu = {shape:g}, n = {n}",
                np.zeros(1),
                np.zeros(1),
                np.array([test.statistic]),
                tolerance=float(CRITICAL_DISTANCE / np.sqrt(n)),
                reason=f"critical distance at {100 * CONFIDENCE:g} %; p = {test.pvalue:.3f}",
                unit="",
            )
        )
        order = np.array([1.0, 2.0, 3.0])
        want = np.array([theory.k_moment(k, shape, np.inf) for k in order])
        spread = np.array([theory.k_moment(2 * k, shape, np.inf) for k in order]) - want**2
        comparisons.append(
            Comparison(
                f"moments, nu = {shape:g}",
                order,
                np.ones(3),
                np.array([np.mean(tau**k) for k in order]) / want,
                tolerance=float(4.0 * np.max(np.sqrt(spread / n) / want)),
                reason="4 standard errors of the third moment",
                unit="",
            )
        )
        lag = np.linspace(0.25, 2.0, 8)
        turn = rng.uniform(0.0, 2.0 * np.pi, n)
        got = []
        for step in lag * length:
            other = texture_at(shape, length, x + step * np.cos(turn), y + step * np.sin(turn))
            got.append(shape * float(np.mean((tau - 1.0) * (other - 1.0))))
        # of a mean of products (tau - 1)(tau' - 1), at most that of their squares
        fourth = shape**2 * float(np.mean((tau - 1.0) ** 4))
        comparisons.append(
            Comparison(
                f"autocorrelation, nu = {shape:g}",
                lag,
                theory.asked_correlation(lag, 1.0),
                np.array(got),
                tolerance=float(0.025 + 4.0 * np.sqrt(fourth * np.exp(-(lag[0] ** 2)) / n)),
                reason="splines in place of the Gaussian asked for (0.025), and 4 standard errors",
                unit="",
                shown=3,
            )
        )
    return Case(
        name="gamma_texture",
        topic="statistics",
        title="Gamma texture of surfaces",
        formula="tau = F_nu^-1(Phi(g)): gamma of shape nu; autocorrelation exp(-(r / l)^2), 1/e at l",
        source="Tough and Ward (1999)",
        x_label="order of the moment, or distance over the correlation length",
        y_label="moment over theory, or autocorrelation",
        comparisons=tuple(comparisons),
        note="Places of level ground drawn at random over 60 000 correlation lengths, pairs in drawn directions.",
    )


def surface_maps(quick: bool = False) -> Case:
    """Level by texel of maps of sigma0, materials and their properties, at random rotations and headings."""
    comparisons: list[Comparison] = []
    n_cells = 150.0 if quick else 300.0
    rng = np.random.default_rng(23)
    for _ in range(1 if quick else 4):
        heading, turn = rng.uniform(0.0, 360.0, 2)
        asked = rng.permutation([-12.0, -8.0, -4.0, 0.0, 3.0, 6.0, 9.0, 12.0, 0.0]).reshape(3, 3)
        half = 0.5 * n_cells * CELL
        scene = _ground(n_cells, heading_deg=heading)
        own, even = scene.materials[0], _image(scene).sigma0()
        bitmap = Bitmap(power_from_db(asked), place_in_plan((-half, -half, half, half), _rotate_bitmap(turn)))
        mapped = replace(own, maps=SurfaceMaps(level=bitmap))
        image = _image(replace(scene, materials=(mapped,)))
        place = _places(image, half, turn)
        label = f"heading {heading:.0f} deg, map turned by {turn:.0f} deg"
        comparisons.append(
            _compare_places(
                f"sigma0_map, {label}",
                asked.ravel() + LEVEL_DB,
                [image.sigma0()[place == k].mean() / even[place == k].mean() for k in range(9)],
            )
        )
        materials = tuple(
            replace(own, name=f"class {k}", diffuse_level_db=LEVEL_DB + float(db))
            for k, db in enumerate(asked.ravel())
        )
        classes = ClassMap(replace(bitmap, values=np.arange(9).reshape(3, 3)), materials)
        image = _image(replace(scene, materials=(replace(own, maps=SurfaceMaps(classes=classes)),)))
        comparisons.append(
            _compare_places(
                f"land_cover, {label}",
                asked.ravel() + LEVEL_DB,
                [image.sigma0()[place == k].mean() / even[place == k].mean() for k in range(9)],
            )
        )
        soil, want = _soil(bitmap, rng)
        image = _image(replace(scene, materials=(soil,)))
        comparisons.append(
            _compare_places(
                f"permittivity_map and roughness_map, {label}",
                db_from_power(want),
                [image.sigma0()[place == k].mean() / even[place == k].mean() for k in range(9)],
            )
        )
    return Case(
        name="surface_maps",
        topic="radiometry",
        title="Maps of level and of land cover",
        formula="sigma0 of the texel at the place of every pixel; first-order theory of its permittivity and height",
        source="definition of the map; Ulaby, Moore and Fung, volume II (1982), chapter 12",
        x_label="texel",
        y_label="sigma0 (dB)",
        comparisons=tuple(comparisons),
        note=f"3 x 3 texels on {n_cells:g} x {n_cells:g} cells; mean over each texel less 3 cells along its edges, "
        "over the same mean of ground without a map, whose speckle is the same; one look.",
    )


def _soil(bitmap: Bitmap, rng: np.random.Generator) -> tuple[Material, F64]:
    """Slightly rough soil of drawn permittivities and rms heights, and the (9,) sigma0 (VV) of each texel."""
    permittivity, height = rng.uniform(4.0, 25.0, (3, 3)), rng.uniform(4e-4, 1.2e-3, (3, 3))
    soil = Material(
        "soil",
        permittivity=10.0 - 1.5j,
        rms_height=1e-3,
        correlation_length=0.02,
        diffuse_law="small_perturbation",
    )
    number, parts = vary_material(soil, permittivity, height)
    wavenumber = 2.0 * np.pi * 9.65e9 / SPEED_OF_LIGHT
    want = [
        theory.small_perturbation_sigma0(np.radians(40.0), e * (1.0 - 0.15j), wavenumber, s, 0.02)[1][0]
        for e, s in zip(permittivity.ravel(), height.ravel(), strict=True)
    ]
    return replace(soil, maps=SurfaceMaps(classes=ClassMap(replace(bitmap, values=number), parts))), np.array(
        want
    )


def _rotate_bitmap(turn: float) -> F64:
    """(3, 3) rotation of u and v about the middle of the bitmap, deg."""
    c, s = np.cos(np.radians(turn)), np.sin(np.radians(turn))
    return np.array([[c, -s, 0.5 - 0.5 * c + 0.5 * s], [s, c, 0.5 - 0.5 * s - 0.5 * c], [0.0, 0.0, 1.0]])


def _places(image: SarImage, half: float, turn: float) -> I64:
    """Number of the texel of each pixel, -1 within 3 cells of an edge or outside."""
    points = image.grid.positions()
    c, s = np.cos(np.radians(turn)), np.sin(np.radians(turn))
    # east and south from the middle, turned as u and v are
    east, south = points[..., 0] / (2.0 * half), -points[..., 1] / (2.0 * half)
    uv = np.stack([c * east - s * south, s * east + c * south], axis=-1) + 0.5
    third = 3.0 * uv
    inside = (
        np.abs(third - np.floor(third) - 0.5) < 0.5 - 3.0 * 3.0 * CELL / (2.0 * half) / np.sin(0.7)
    ).all(axis=-1)
    inside &= ((third > 0.0) & (third < 3.0)).all(axis=-1)
    row, column = np.floor(third[..., 1]).astype(int), np.floor(third[..., 0]).astype(int)
    return np.where(inside, 3 * row + column, -1)


def _compare_places(label: str, want: F64, ratio: Sequence[float]) -> Comparison:
    return Comparison(
        label,
        np.arange(9.0),
        want,
        LEVEL_DB + db_from_power(np.asarray(ratio)),
        tolerance=0.2,
        reason="asked for; side lobes of neighbours up to 24 dB stronger, and speckle that is the same in both",
        unit="dB",
    )


CASES.register(CaseEntry("k_distribution", "statistics", k_distribution))
CASES.register(CaseEntry("gamma_texture", "statistics", gamma_texture))
CASES.register(CaseEntry("surface_maps", "radiometry", surface_maps))
