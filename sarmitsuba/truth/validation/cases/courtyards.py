"""Paths over two diffuse scatterers: a bowl in closed form, and two plates by a sum over all pairs of their facets."""

import numpy as np

from sarmitsuba.core.arrays import F64
from sarmitsuba.core.units import db_from_power
from sarmitsuba.effects.flags import KernelFlags
from sarmitsuba.scene.geometry import Geometry
from sarmitsuba.scene.materials.material import Material
from sarmitsuba.scene.mesh.surface_samples import surface_samples
from sarmitsuba.tracing.kernel.leg import Surroundings
from sarmitsuba.tracing.kernel.scene_tables import build_trace_scene
from sarmitsuba.tracing.scatterers.pairs.pair_estimate import pair_echo
from sarmitsuba.tracing.scatterers.pairs.pair_search import find_pairs
from sarmitsuba.truth import theory
from sarmitsuba.truth.validation import targets
from sarmitsuba.truth.validation.band_sampling import wavelength
from sarmitsuba.truth.validation.cases import CASES, CaseEntry
from sarmitsuba.truth.validation.comparison import Case, Comparison

RADIUS, SEGMENTS, ALBEDO = 2.0, 96, 0.3
# m, between points, also where few looks are taken, and the antenna's distance
CELL, QUICK_CELL, FAR = 0.016, 0.03, 1e4
# of a plate's side
FACETS = 14
CHANNELS = ("HH", "HV", "VH", "VV")
# dB, a bowl of flat facets: its opening is a polygon
FACETS_DB = 0.01
UP = np.array([0.0, 0.0, 1.0])


def pair_power(
    geometry: Geometry, materials: tuple[Material, ...], to_radar: F64, up: F64, cell: float, seed: int
) -> tuple[F64, F64]:
    """Mean RCS of pairs in the four channels, m^2, and its relative standard errors."""
    lam = wavelength("X")
    scene = build_trace_scene(geometry, materials, lam)
    box = geometry.bounds + np.array([[-1.0], [1.0]])
    samples = surface_samples(scene.triangles, cell, box, seed)
    position = FAR * to_radar
    flags = KernelFlags(channels=CHANNELS, depolarisation=False)
    pairs = find_pairs(Surroundings.of(scene, flags, lam), samples, position[None], cell, box)
    echo = pair_echo(
        pairs, scene, position, np.zeros(3), flags, wavelength=lam, seed=seed, up=(up[0], up[1], up[2])
    )
    power = np.square(np.abs(echo.amplitude))
    return power.sum(axis=0), np.sqrt(np.square(power).sum(axis=0)) / power.sum(axis=0)


def bowl() -> targets.Mesh:
    """Lower half of a sphere, open above."""
    theta = np.linspace(0.5 * np.pi, np.pi, SEGMENTS // 4 + 1)
    phi = 2.0 * np.pi * np.arange(SEGMENTS) / SEGMENTS
    ring = np.stack([np.cos(phi), np.sin(phi), np.zeros(SEGMENTS)], axis=1)
    vertices = np.concatenate([RADIUS * (np.sin(t) * ring + np.cos(t) * UP) for t in theta])
    i, j = (a.ravel() for a in np.meshgrid(np.arange(theta.size - 1), np.arange(SEGMENTS), indexing="ij"))
    k = (j + 1) % SEGMENTS
    first, below = i * SEGMENTS, (i + 1) * SEGMENTS
    upper = np.stack([first + j, below + j, below + k], axis=1)
    lower = np.stack([first + j, below + k, first + k], axis=1)
    # the lowest ring is a point
    keep = np.concatenate([i < theta.size - 2, np.ones(i.size, dtype=bool)])
    return vertices, np.concatenate([upper, lower])[keep].astype(np.int32)


def tolerance_db(error: F64, more: float) -> float:
    """Four of the largest standard errors and more, dB."""
    return float(4.0 * 10.0 / np.log(10.0) * error.max() + more)


def bowl_case(quick: bool = False) -> Case:
    """Hemispherical bowl at drawn tilts of its axis and turns of the polarisation."""
    rng = np.random.default_rng(17)
    n, cell = (2, QUICK_CELL) if quick else (6, CELL)
    tilt, turn, azimuth = (rng.uniform(low, high, n) for low, high in ((0.1, 0.9), (0, np.pi), (0, 6.28)))
    geometry = targets.geometry([bowl()])
    material = Material("stone", pec=True, diffuse_law="lambert", diffuse_level_db=_level(ALBEDO))
    closed = theory.lambertian_bowl(RADIUS, ALBEDO, tilt, turn)
    rows = []
    for i in range(n):
        away = np.array([np.cos(azimuth[i]), np.sin(azimuth[i]), 0.0])
        to_radar = np.sin(tilt[i]) * away + np.cos(tilt[i]) * UP
        # along the opening's longer axis, and across it
        h = np.cross(-to_radar, UP) / np.sin(tilt[i])
        up = np.cos(turn[i]) * np.cross(h, -to_radar) - np.sin(turn[i]) * h
        rows.append(pair_power(geometry, (material,), to_radar, up, cell, i))
    power, error = (np.array(column) for column in zip(*rows, strict=True))
    return _case(
        "pairs_in_a_bowl",
        "Two diffuse scatterers in a row: a bowl",
        "sigma = pi A^2 a^2 cos^2 t (1 +- m^2 cos 4 chi), m = (1 - cos t) / (1 + cos t)",
        "form factor of a sphere (Modest 2013), parallel planes of incidence, both orders coherent",
        "tilt of the bowl's axis (deg)",
        np.degrees(tilt),
        {"HH": closed.co_h, "HV": closed.cross, "VH": closed.cross, "VV": closed.co_v},
        power,
        tolerance_db(error, FACETS_DB),
        f"four standard errors of the pairs drawn, and {FACETS_DB:g} dB of the facets",
        f"Radius {RADIUS:g} m, albedo {ALBEDO:g}; the polarisation turned by drawn angles.",
    )


def plates_case(quick: bool = False) -> Case:
    """A floor and a wall apart, from drawn directions, against the sum over all pairs of facets."""
    rng = np.random.default_rng(23)
    n, cell = (2, QUICK_CELL) if quick else (5, CELL)
    floor = targets.parallelogram([1.0, -2.0, 0.0], [4.0, 0.0, 0.0], [0.0, 4.0, 0.0])
    wall = targets.parallelogram([0.0, -2.0, 1.0], [0.0, 4.0, 0.0], [0.0, 0.0, 4.0])
    geometry = targets.geometry([floor, wall], [0, 1])
    albedo = (0.2, 0.4)
    materials = tuple(
        Material(f"m{i}", pec=True, diffuse_law="lambert", diffuse_level_db=_level(a))
        for i, a in enumerate(albedo)
    )
    grid = (np.arange(FACETS) + 0.5) / FACETS * 4.0
    u, v = (a.ravel() for a in np.meshgrid(grid, grid))
    one, none = np.ones(u.size), np.zeros(u.size)
    points = np.concatenate(
        [np.stack([u + 1.0, v - 2.0, none], axis=1), np.stack([none, v - 2.0, u + 1.0], axis=1)]
    )
    normals = np.concatenate([np.stack([none, none, one], axis=1), np.stack([one, none, none], axis=1)])
    area, reflect = np.full(2 * u.size, (4.0 / FACETS) ** 2), np.repeat(albedo, u.size)
    rows, closed = [], []
    for i in range(n):
        azimuth, elevation = rng.uniform(-1.2, 1.2), rng.uniform(0.3, 1.2)
        to_radar = np.array(
            [np.cos(elevation) * np.cos(azimuth), np.cos(elevation) * np.sin(azimuth), np.sin(elevation)]
        )
        h = np.cross(-to_radar, UP) / np.cos(elevation)
        own = theory.pair_sum(points, normals, area, reflect, to_radar, h, np.ones((area.size, area.size)))
        closed.append((own.co_h, own.cross, own.cross, own.co_v))
        rows.append(pair_power(geometry, materials, to_radar, UP, cell, i))
    power, error = (np.array(column) for column in zip(*rows, strict=True))
    return _case(
        "pairs_of_plates",
        "Two diffuse scatterers in a row: a floor and a wall",
        "sigma = 1/2 sum_AB |s_AB + s_BA|^2, |s_AB|^2 = 16 A_A A_B c c c c a_A a_B / (4 pi r^2)",
        "radiosity with polarisations kept in the planes of incidence, summed over 392 facets",
        "number of the drawn direction",
        np.arange(1.0, n + 1.0),
        dict(zip(CHANNELS, np.array(closed).T, strict=True)),
        power,
        tolerance_db(error, FACETS_DB),
        f"four standard errors of the pairs drawn, and {FACETS_DB:g} dB of the facets' size",
        "Both 4 m x 4 m, 1 m from their common line; albedos 0.2 and 0.4.",
    )


def _level(albedo: float) -> float:
    return float(db_from_power(np.array(4.0 * albedo)))


def _case(
    name: str,
    title: str,
    formula: str,
    source: str,
    x_label: str,
    x: F64,
    closed: dict[str, F64],
    power: F64,
    tolerance: float,
    reason: str,
    note: str,
) -> Case:
    order = np.argsort(x)
    comparisons = tuple(
        Comparison(
            channel,
            x[order],
            db_from_power(np.broadcast_to(closed[channel], x.shape)[order]),
            db_from_power(power[order, i]),
            tolerance=tolerance,
            reason=reason,
            shown=0,
        )
        for i, channel in enumerate(CHANNELS)
    )
    return Case(
        name=name,
        topic="rough",
        title=title,
        formula=formula,
        source=source,
        x_label=x_label,
        y_label="RCS (dBsm)",
        comparisons=comparisons,
        note=note,
    )


CASES.register(CaseEntry("pairs_in_a_bowl", "rough", bowl_case))
CASES.register(CaseEntry("pairs_of_plates", "rough", plates_case))
