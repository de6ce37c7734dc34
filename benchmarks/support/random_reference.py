"""Brute-force references in plain NumPy for scenes of ``random_scenes``; nothing of the simulator is used.

Diffuse bodies: the sum of sigma0 dA over what the antenna sees, by points on the surface and a test of every one
against the triangles before it. Metal bodies: physical optics, Gordon's integral over every triangle for every
frequency and antenna position.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from benchmarks.support.random_scenes import Body, Draw, Radar, look_direction
from sarmitsuba.core.arrays import C128, F64, I64

SPEED_OF_LIGHT = 299_792_458.0

# points on the visible side; 0.3 % of the energy at random
POINTS = 40_000
# bins of the projected plane, each way, for the test of what stands before a point
BINS = 96


@dataclass(frozen=True)
class Diffuse:
    """Expected radar cross section of all that is lit, m^2, and how many resolution cells share it."""

    rcs: float
    cells: float


def antenna_positions(radar: Radar, n: int) -> F64:
    """(n, 3) m, spread evenly over the aperture that gives the azimuth resolution; the aim point is the origin."""
    middle = -radar.slant_range * look_direction(radar)
    heading = np.radians(radar.heading_deg)
    along = np.array([np.sin(heading), np.cos(heading), 0.0])
    length = radar.wavelength * radar.slant_range / (2.0 * radar.azimuth_resolution)
    # the middles of n equal parts
    return middle + ((np.arange(n) + 0.5) / n - 0.5)[:, None] * length * along


def aperture_weights(radar: Radar, position: F64) -> F64:
    r"""Weight of every antenna position in a pixel at the aim point: the beam's two-way amplitude squared, (n,).

    Once as the beam weighs the echo, once more by the matched filter. With a Gaussian beam of half-power width
    :math:`\Theta`, fixed to the track,

    .. math:: g(\alpha) = 2^{-\sin^2 \alpha / \sin^2(\Theta / 2)}, \quad w = g^2
    """
    if radar.pattern == "isotropic":
        return np.ones(len(position))
    if radar.pattern != "gaussian":
        raise ValueError(f"no reference for pattern {radar.pattern}")
    heading = np.radians(radar.heading_deg)
    along = np.array([np.sin(heading), np.cos(heading), 0.0])
    line = -position / np.linalg.norm(position, axis=1)[:, None]
    # the beam holds the direction to the aim point at mid-aperture, square to the track
    sine = (line @ along) / np.sin(np.radians(0.5 * radar.azimuth_beamwidth_deg))
    return np.asarray(2.0 ** (-2.0 * sine**2))


def diffuse(draw: Draw) -> Diffuse:
    """Energy that the laws predict for the lit area."""
    rng = np.random.default_rng([draw.seed, 77])
    position = antenna_positions(draw.radar, 3)
    triangles = np.concatenate([b.triangles for b in draw.bodies])
    owner = np.repeat(np.arange(len(draw.bodies)), [len(b.triangles) for b in draw.bodies])
    edge1, edge2 = triangles[:, 1] - triangles[:, 0], triangles[:, 2] - triangles[:, 0]
    cross = np.cross(edge1, edge2)
    area = 0.5 * np.linalg.norm(cross, axis=1)
    normal = cross / np.maximum(2.0 * area, 1e-300)[:, None]
    rcs, weights, places = 0.0, [], []
    for antenna in position:
        count = rng.multinomial(POINTS, area / area.sum())
        of = np.repeat(np.arange(len(area)), count)
        u, v = rng.random((2, of.size))
        over = u + v > 1.0
        u, v = np.where(over, 1.0 - u, u), np.where(over, 1.0 - v, v)
        point = triangles[of, 0] + u[:, None] * edge1[of] + v[:, None] * edge2[of]
        way = antenna - point
        distance = np.linalg.norm(way, axis=1)
        cosine = np.einsum("pi,pi->p", way, normal[of]) / distance
        closed = np.array([b.closed for b in draw.bodies])[owner[of]]
        cosine = np.where(closed, cosine, np.abs(cosine))
        lit = cosine > 0.0
        lit[lit] = ~_hidden(point[lit], of[lit], antenna, triangles)
        power = np.zeros(of.size)
        for i, body in enumerate(draw.bodies):
            mine = lit & (owner[of] == i)
            power[mine] = sigma0(body, cosine[mine])
        power *= area.sum() / POINTS
        rcs += power.sum() / len(position)
        weights.append(power)
        places.append(_cell_numbers(draw.radar, point, antenna))
    weight, place = np.concatenate(weights), np.concatenate(places)
    _, cell = np.unique(place, axis=0, return_inverse=True)
    by_cell = np.bincount(cell.reshape(-1), weight)
    cells = by_cell.sum() ** 2 / max(float((by_cell**2).sum()), 1e-300)
    return Diffuse(float(rcs), float(cells))


def sigma0(body: Body, cosine: F64) -> F64:
    """Laws of the scene format: level at every angle, times the cosine, or times its square."""
    power = {"constant": 0, "constant_gamma": 1, "lambert": 2}[body.law]
    return np.asarray(10.0 ** (body.level_db / 10.0) * cosine**power)


def _cell_numbers(radar: Radar, point: F64, antenna: F64) -> I64:
    heading = np.radians(radar.heading_deg)
    along = point @ np.array([np.sin(heading), np.cos(heading), 0.0])
    slant = np.linalg.norm(point - antenna, axis=1)
    return np.floor(np.column_stack([along / radar.azimuth_resolution, slant / radar.range_cell])).astype(
        np.int64
    )


def _hidden(point: F64, of: NDArray[np.intp], antenna: F64, triangles: F64) -> NDArray[np.bool_]:
    """Whether a triangle other than its own stands between a point and the antenna."""
    middle = triangles.reshape(-1, 3).mean(axis=0)
    w = antenna - middle
    w /= np.linalg.norm(w)
    a = np.cross(w, np.eye(3)[np.argmin(np.abs(w))])
    a /= np.linalg.norm(a)
    axes = np.stack([a, np.cross(w, a)], axis=1)

    def project(p: F64) -> F64:
        """Central projection onto the plane through the middle."""
        ray = p - antenna
        return np.asarray((antenna + ray * (((middle - antenna) @ w) / (ray @ w))[..., None] - middle) @ axes)

    flat, xy = project(triangles), project(point)
    low, high = flat.reshape(-1, 2).min(axis=0), flat.reshape(-1, 2).max(axis=0)
    step = np.maximum((high - low) / BINS, 1e-9)
    first = np.clip(((flat.min(axis=1) - low) / step).astype(int), 0, BINS - 1)
    last = np.clip(((flat.max(axis=1) - low) / step).astype(int), 0, BINS - 1)
    bin_of = np.clip(((xy - low) / step).astype(int), 0, BINS - 1)
    key = bin_of[:, 0] * BINS + bin_of[:, 1]
    order = np.argsort(key, kind="stable")
    starts = np.searchsorted(key[order], np.arange(BINS * BINS + 1))
    hidden = np.zeros(len(point), dtype=bool)
    size = np.abs(triangles).max()
    for cell in np.unique(key):
        i, j = divmod(int(cell), BINS)
        near = np.flatnonzero((first[:, 0] <= i) & (last[:, 0] >= i) & (first[:, 1] <= j) & (last[:, 1] >= j))
        mine = order[starts[cell] : starts[cell + 1]]
        for part in np.array_split(mine, 1 + mine.size * near.size // 2_000_000):
            hidden[part] = _blocked(point[part], of[part], antenna, triangles[near], near, 1e-7 * size)
    return hidden


def _cross(a: F64, b: F64) -> F64:
    """Vector products (..., 3); for small arrays in a fifth of the time of ``np.cross``."""
    (ax, ay, az), (bx, by, bz) = (np.moveaxis(v, -1, 0) for v in (a, b))
    return np.stack([ay * bz - az * by, az * bx - ax * bz, ax * by - ay * bx], axis=-1)


def _blocked(
    point: F64, of: NDArray[np.intp], antenna: F64, triangles: F64, number: NDArray[np.intp], slack: float
) -> NDArray[np.bool_]:
    """Segments from points to the antenna against triangles (Moeller and Trumbore 1997), all pairs."""
    direction = antenna - point
    e1, e2 = triangles[:, 1] - triangles[:, 0], triangles[:, 2] - triangles[:, 0]
    p = _cross(direction[:, None], e2[None])
    det = np.einsum("pti,ti->pt", p, e1)
    safe = np.where(np.abs(det) > 1e-300, det, 1.0)
    s = point[:, None] - triangles[None, :, 0]
    u = np.einsum("pti,pti->pt", s, p) / safe
    q = _cross(s, e1[None])
    v = np.einsum("pi,pti->pt", direction, q) / safe
    t = np.einsum("pti,ti->pt", q, e2) / safe
    far = t * np.linalg.norm(direction, axis=1)[:, None] > slack
    hit = (np.abs(det) > 1e-300) & (u >= 0) & (v >= 0) & (u + v <= 1) & far & (t < 1)
    hit &= of[:, None] != number[None]
    return np.asarray(hit.any(axis=1))


# ---------------------------------------------------------------- physical optics


def physical_optics(draw: Draw, position: F64, frequency: F64) -> C128:
    r"""Square root of the RCS with its phase, (n_frequency, n_position) complex128, m.

    .. math:: \frac{2 \sqrt\pi}{\lambda} \sum_t (n_t \cdot s_t) \int_t e^{-j 2 k |r - a|} dS

    over triangles that face the antenna, each in its own direction ``s_t`` (Gordon, IEEE TAP 23, 1975). Triangles
    are cut until the wave is plane over each.
    """
    body = draw.bodies[0]
    size = np.sqrt(0.002 * draw.radar.wavelength * draw.radar.slant_range)
    triangles = _cut(body.triangles, size)
    e1, e2 = triangles[:, 1] - triangles[:, 0], triangles[:, 2] - triangles[:, 0]
    cross = np.cross(e1, e2)
    norm = np.linalg.norm(cross, axis=1)
    keep = norm > 0
    triangles, normal = triangles[keep], cross[keep] / norm[keep, None]
    middle = triangles.mean(axis=1)
    out = np.zeros((len(frequency), len(position)), dtype=np.complex128)
    for j, antenna in enumerate(position):
        way = antenna - middle
        distance = np.linalg.norm(way, axis=1)
        s = way / distance[:, None]
        cosine = np.einsum("ti,ti->t", normal, s)
        lit = cosine > 0 if body.closed else np.abs(cosine) > 0
        corner = triangles[lit] - middle[lit][:, None]
        # path of a point of the triangle: distance - s . r
        for i, f in enumerate(frequency):
            k = 2.0 * np.pi * f / SPEED_OF_LIGHT
            integral = _gordon(2.0 * k * s[lit], corner, normal[lit])
            amplitude = np.sqrt(np.pi) * k / np.pi * np.abs(cosine[lit]) * integral
            out[i, j] = np.sum(amplitude * np.exp(-2j * k * distance[lit]))
    return out


def polygon_optics(corner: F64, antenna: F64, wavenumber: float) -> complex:
    """Square root of the RCS of one plane polygon (n, 3) in a plane wave, m."""
    middle = corner.mean(axis=0)
    normal = np.cross(corner[1] - corner[0], corner[2] - corner[0])
    normal /= np.linalg.norm(normal)
    way = antenna - middle
    distance = float(np.linalg.norm(way))
    cosine = float(normal @ way) / distance
    integral = _gordon((2.0 * wavenumber / distance * way)[None], (corner - middle)[None], normal[None])[0]
    return complex(wavenumber / np.sqrt(np.pi) * abs(cosine) * integral * np.exp(-2j * wavenumber * distance))


def _gordon(q: F64, corner: F64, normal: F64) -> C128:
    """Integral of ``exp(j q . r)`` over polygons (n, k, 3) about their middles."""
    across = q - np.einsum("ti,ti->t", q, normal)[:, None] * normal
    squared = np.einsum("ti,ti->t", across, across)
    edge = np.roll(corner, -1, axis=1) - corner
    middle = corner + 0.5 * edge
    area = 0.5 * np.linalg.norm(np.cross(corner, np.roll(corner, -1, axis=1)).sum(axis=1), axis=1)
    extent = np.abs(edge).max(axis=(1, 2))
    phase = np.einsum("ti,tki->tk", across, middle)
    half = 0.5 * np.einsum("ti,tki->tk", across, edge)
    turn = np.einsum("ti,tki->tk", np.cross(normal, across), edge)
    # mean over the edge of exp(j q . r) is exp(j q . middle) sinc(q . edge / 2)
    total = np.sum(turn * np.exp(1j * phase) * np.sinc(half / np.pi), axis=1)
    small = squared * extent**2 < 1e-6
    return np.asarray(np.where(small, area, total / (1j * np.where(small, 1.0, -squared)) * -1.0))


def _cut(triangles: F64, size: float) -> F64:
    """Cut triangles at the middle of their longest edge until none is longer than ``size``."""
    while True:
        edge = np.roll(triangles, -1, axis=1) - triangles
        length = np.linalg.norm(edge, axis=2)
        long = length.max(axis=1) > size
        if not long.any():
            return triangles
        k = length[long].argmax(axis=1)
        rows = np.arange(k.size)
        a, b, c = (triangles[long][rows, (k + i) % 3] for i in range(3))
        m = 0.5 * (a + b)
        triangles = np.concatenate(
            [triangles[~long], np.stack([a, m, c], axis=1), np.stack([m, b, c], axis=1)]
        )


def focused(h: C128, position: F64, frequency: F64, pixel: F64, weight: F64) -> C128:
    """Image of responses (n_frequency, n_position) at pixels (n, 3); frequencies weigh alike, positions as given."""
    out = np.zeros(len(pixel), dtype=np.complex128)
    k = 2.0 * np.pi * frequency / SPEED_OF_LIGHT
    for j, antenna in enumerate(position):
        distance = np.linalg.norm(pixel - antenna, axis=1)
        out += weight[j] * (np.exp(2j * distance[:, None] * k[None]) @ h[:, j])
    return out / (len(frequency) * weight.sum())
