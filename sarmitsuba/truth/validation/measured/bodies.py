"""Bodies of the Austin RCS Benchmark Suite as triangle lists, in metres, in the axes of its tables.

Every mesh shares the vertices of its edges; outward normals are those of the triangles' winding.
"""

import json
from collections.abc import Sequence
from itertools import pairwise

import numpy as np

from sarmitsuba.core.arrays import F64
from sarmitsuba.truth.validation.measured.azimuth_tables import FOLDER
from sarmitsuba.truth.validation.targets import Mesh

# plate, m: width along y, height along z, thickness along x
PLATE_WIDTH, PLATE_HEIGHT, PLATE_THICKNESS = 0.26670, 0.15240, 1.6256e-3
# dielectric plate: thickness, m, and relative permittivity at 7 GHz
DIELECTRIC_THICKNESS, DIELECTRIC_PERMITTIVITY = 1.5e-3, 2.61 - 0.0346j
ALMOND_LENGTH = 0.252374
# facets of the almond: rings from the round end to the widest place, on to the tip, and around
ALMOND_RINGS, ALMOND_AROUND = (20, 40), 96
# prism, m: half length, heights of front and back, corner of the chamfers, half width along y
PRISM_FRONT, PRISM_CORNER, PRISM_BACK = 0.2, 0.092, -0.2
FRONT_HALF, BACK_HALF, PRISM_HALF_WIDTH = 0.052, 0.16, 0.065
# duct, m: half of the opening's height and width
DUCT_HALF_HEIGHT, DUCT_HALF_WIDTH = 0.042, 0.055


def plate() -> Mesh:
    """Rectangle in x = 0."""
    y, z = 0.5 * PLATE_WIDTH, 0.5 * PLATE_HEIGHT
    vertices = np.array([[0.0, -y, -z], [0.0, y, -z], [0.0, y, z], [0.0, -y, z]])
    return vertices, np.array([[0, 1, 2], [0, 2, 3]], dtype=np.int32)


def thick_plate() -> Mesh:
    """Box in place of that rectangle."""
    x, z = 0.5 * PLATE_THICKNESS, 0.5 * PLATE_HEIGHT
    return _extrude_outline([(x, -z), (x, z), (-x, z), (-x, -z)], 0.5 * PLATE_WIDTH)


def prism() -> Mesh:
    """Hexagon in the x-z plane extruded along y, without its front open."""
    return _extrude_outline(_hexagon(), PRISM_HALF_WIDTH)


def almond() -> Mesh:
    r"""NASA almond, tip at +x, flat side in the x-y plane; corners of the facets lie on it.

    With the length d and :math:`t = x / d` the half axes along y and z are

    .. math:: b = 0.193333 d \sqrt{1 - (t / 0.416667)^2}, \quad -0.416667 \le t \le 0

    .. math:: b = 4.83345 d \left(\sqrt{1 - (t / 2.08335)^2} - 0.96\right), \quad 0 \le t \le 0.583333

    and b / 3 (Woo et al., IEEE Antennas and Propagation Magazine 35(1), 1993).
    """
    back, front = ALMOND_RINGS
    # rings of the round end are equally spaced in angle
    t = np.concatenate(
        [
            -0.416667 * np.cos(np.linspace(0.0, 0.5 * np.pi, back + 1))[1:-1],
            np.linspace(0.0, 0.583333, front + 1)[:-1],
        ]
    )
    half_axis = np.where(
        t < 0.0,
        0.193333 * np.sqrt(np.clip(1.0 - (t / 0.416667) ** 2, 0.0, None)),
        4.83345 * (np.sqrt(1.0 - (t / 2.08335) ** 2) - 0.96),
    )
    psi = 2.0 * np.pi * np.arange(ALMOND_AROUND) / ALMOND_AROUND
    rings = np.stack(
        np.broadcast_arrays(
            t[:, None], np.outer(half_axis, np.cos(psi)), np.outer(half_axis, np.sin(psi)) / 3.0
        ),
        axis=2,
    )
    ends = np.array([[-0.416667, 0.0, 0.0], [0.583333, 0.0, 0.0]])
    vertices = ALMOND_LENGTH * np.concatenate([rings.reshape(-1, 3), ends])
    n, i = t.size * ALMOND_AROUND, np.arange(ALMOND_AROUND)
    j = np.roll(i, -1)
    faces = [np.column_stack([np.full(ALMOND_AROUND, n), j, i])]
    for first in range(0, n - ALMOND_AROUND, ALMOND_AROUND):
        a, b = first + i, first + j
        faces += [
            np.column_stack([a, b, b + ALMOND_AROUND]),
            np.column_stack([a, b + ALMOND_AROUND, a + ALMOND_AROUND]),
        ]
    last = n - ALMOND_AROUND
    faces.append(np.column_stack([np.full(ALMOND_AROUND, n + 1), last + i, last + j]))
    return vertices, np.concatenate(faces).astype(np.int32)


def duct() -> Mesh:
    """The prism with a curved duct of constant width, open at +x; 20 mm thick walls about the opening's corners."""
    stored = json.loads((FOLDER / "duct_walls.json").read_text(encoding="utf-8"))
    lower, upper = (1e-6 * np.asarray(stored[name], dtype=np.float64) for name in ("lower", "upper"))
    outer, inner = PRISM_HALF_WIDTH, DUCT_HALF_WIDTH
    vertices, faces = thick = _extrude_outline(_hexagon(), outer)
    # corners of the prism's front, and those of the opening
    rim = [
        (PRISM_FRONT, y, z)
        for y, z in ((-outer, -FRONT_HALF), (outer, -FRONT_HALF), (outer, FRONT_HALF), (-outer, FRONT_HALF))
    ]
    hole = [
        (PRISM_FRONT, y, z)
        for y, z in (
            (-inner, -DUCT_HALF_HEIGHT),
            (inner, -DUCT_HALF_HEIGHT),
            (inner, DUCT_HALF_HEIGHT),
            (-inner, DUCT_HALF_HEIGHT),
        )
    ]
    front = (vertices[faces][..., 0] > PRISM_FRONT - 1e-9).all(axis=1)
    triangles = [thick[0][faces[~front]]]
    for k in range(4):
        a, b, c, d = rim[k], rim[(k + 1) % 4], hole[(k + 1) % 4], hole[k]
        triangles.append(np.array([[a, b, c], [a, c, d]]))

    def at(wall: F64, y: float) -> F64:
        return np.column_stack([wall[:, 0], np.full(len(wall), y), wall[:, 1]])

    for wall, sign in ((lower, 1), (upper, -1)):
        near, far = at(wall, -inner), at(wall, inner)
        for i in range(len(wall) - 1):
            pair = np.array([[near[i], far[i], far[i + 1]], [near[i], far[i + 1], near[i + 1]]])
            triangles.append(pair[:, ::sign])
    for y, sign in ((-inner, 1), (inner, -1)):
        triangles.append(_connect_polylines(at(lower, y), at(upper, y))[:, ::sign])
    end = [
        (*wall[-1:, 0], y, *wall[-1:, 1])
        for wall, y in ((lower, -inner), (lower, inner), (upper, inner), (upper, -inner))
    ]
    triangles.append(np.array([[end[0], end[1], end[2]], [end[0], end[2], end[3]]]))
    corners = np.concatenate(triangles).reshape(-1, 3)
    shared, number = np.unique(np.round(corners, 12) + 0.0, axis=0, return_inverse=True)
    return shared, number.reshape(-1, 3).astype(np.int32)


def _hexagon() -> list[tuple[float, float]]:
    """Outline of the prism, x and z, m."""
    half = [(PRISM_FRONT, FRONT_HALF), (PRISM_CORNER, BACK_HALF), (PRISM_BACK, BACK_HALF)]
    return [*half, *((x, -z) for x, z in reversed(half))]


def _extrude_outline(outline: Sequence[tuple[float, float]], half_width: float) -> Mesh:
    """Convex outline in x and z, counter-clockwise from x to z, from -half_width to half_width along y."""
    n = len(outline)
    vertices = np.array([[x, y, z] for y in (-half_width, half_width) for x, z in outline])
    faces = [[0, i, i + 1] for i in range(1, n - 1)] + [[n, n + i + 1, n + i] for i in range(1, n - 1)]
    for i, j in pairwise([*range(n), 0]):
        faces += [[i, n + i, n + j], [i, n + j, j]]
    return vertices, np.array(faces, dtype=np.int32)


def _connect_polylines(first: F64, second: F64) -> F64:
    """Triangles (n, 3, 3) of the strip between two polylines, which advance together by their lengths."""
    along = [np.cumsum([0.0, *np.linalg.norm(np.diff(line, axis=0), axis=1)]) for line in (first, second)]
    along = [s / s[-1] for s in along]
    i = j = 0
    out = []
    while i < len(first) - 1 or j < len(second) - 1:
        if j == len(second) - 1 or (i < len(first) - 1 and along[0][i + 1] <= along[1][j + 1]):
            out.append([first[i], first[i + 1], second[j]])
            i += 1
        else:
            out.append([first[i], second[j + 1], second[j]])
            j += 1
    return np.array(out)
