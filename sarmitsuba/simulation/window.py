"""Which part of the scene is lit by rays, and how densely."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from sarmitsuba.constants import SUBSET_SHARES
from sarmitsuba.effects.flags import KernelFlags
from sarmitsuba.errors import RadarError
from sarmitsuba.scene.geometry import Geometry
from sarmitsuba.scene.scene import Scene
from sarmitsuba.trace.launch import (
    LaunchFrame,
    LaunchGrid,
    Purpose,
    frame_towards,
    lattice,
    morton,
    window_of,
)

F64 = NDArray[np.float64]

# rays a wavelength that curved and small parts want (a sphere of ka = 60 is then within 0.1 dB of physical optics)
RAYS_PER_WAVELENGTH = 4.5
# rays of one pass up to which the whole window gets RAYS_PER_WAVELENGTH; beyond, tubes of several wavelengths serve
FINE_RAYS = 2_000_000
# a tube's footprint on level ground over a scatterer cell: up to one, tubes share their area among the cells they
# overlap and leave none out
FOOTPRINT_PER_CELL = 1.0
# scatterer cells a resolution cell, per axis: at one or more the speckle of a pixel is exactly Gaussian
CELLS_PER_RESOLUTION = 1.4


@dataclass(frozen=True, eq=False)
class LaunchWindow:
    """Lit part of the scene.

    Parameters
    ----------
    box : (2, 3) float64, m, scene frame; everything inside is lit at full weight
    center : (3,) float64, m, scene frame; the launch plane's centre
    frame : launch plane of the mid-aperture line of sight
    half_x, half_y : m, half extents of the window in the plane
    taper : m, fade-out beyond; 0 where the scene ends within the window
    incidence : rad, on level ground at the centre
    """

    box: F64
    center: F64
    frame: LaunchFrame
    half_x: float
    half_y: float
    taper: float
    incidence: float

    @property
    def area(self) -> float:
        """Area of the window with its fade-out, m^2."""
        return 4.0 * (self.half_x + self.taper) * (self.half_y + self.taper)


def launch_window(scene: Scene) -> LaunchWindow:
    """Find the window that lights all geometry which can reach the requested image.

    Tall objects beyond the far edge lay over into the image, so the box reaches further out by their height over
    the tangent of the incidence angle.

    Raises
    ------
    RadarError
        When no geometry lies within the image's footprint.
    """
    radar, image = scene.radar, scene.image
    low, high = scene.geometry.bounds
    along, across = radar.track.along, radar.across
    antenna = radar.track.center_position
    middle = np.array([image.center_x, image.center_y, image.height])
    look = middle - antenna
    incidence = float(np.arccos(np.clip(-look[2] / np.linalg.norm(look), -1.0, 1.0)))

    # image footprint and geometry in track-aligned axes (along, across, up), relative to the image's centre
    axes = np.stack([along, across, np.array([0.0, 0.0, 1.0])])
    local = (scene.geometry.vertices - middle) @ axes.T
    g_low, g_high = local.min(axis=0), local.max(axis=0)
    reach = max(0.0, float(g_high[2])) / max(np.tan(incidence), 0.1)
    sink = max(0.0, float(-g_low[2])) / max(np.tan(incidence), 0.1)
    ha, hr = 0.5 * image.extent_azimuth, 0.5 * image.extent_range
    i_low = np.array([-ha, -hr - sink, g_low[2]])
    i_high = np.array([ha, hr + reach, g_high[2]])
    b_low, b_high = np.maximum(i_low, g_low), np.minimum(i_high, g_high)
    if (b_low > b_high).any():
        where = "azimuth" if b_low[0] > b_high[0] else "range"
        raise RadarError(
            f"{scene.name}: the image ({image.extent_azimuth:g} m x {image.extent_range:g} m about "
            f"({image.center_x:g}, {image.center_y:g}) m) misses all geometry in {where}, which spans "
            f"x {low[0]:g} ... {high[0]:g} m, y {low[1]:g} ... {high[1]:g} m; move image_center_x, image_center_y "
            f"or enlarge the image"
        )
    cut = bool((g_low[:2] < i_low[:2] - 1e-6).any() or (g_high[:2] > i_high[:2] + 1e-6).any())

    corners = np.array(
        [
            [x, y, z]
            for x in (b_low[0], b_high[0])
            for y in (b_low[1], b_high[1])
            for z in (b_low[2], b_high[2])
        ]
    )
    corners = corners @ axes + middle
    center = 0.5 * (corners.min(axis=0) + corners.max(axis=0))
    frame = frame_towards(antenna[None], center, along)
    spans = [
        window_of(corners, radar.track.position[i], frame)
        for i in {0, radar.track.center_index, radar.track.n_pulses - 1}
    ]
    lo = np.min([s[0] for s in spans], axis=0)
    hi = np.max([s[1] for s in spans], axis=0)
    shift = 0.5 * (lo + hi)
    center = center + frame.axis_x[0] * shift[0] + frame.axis_y[0] * shift[1]
    half = 0.5 * (hi - lo)
    frame = LaunchFrame(center[None], frame.axis_x, frame.axis_y)
    # five per cent of the window, at least ten resolution cells, keeps the frame's edge lobe below the clutter
    taper = max(0.05 * float(half.max()), 10.0 * radar.waveform.range_cell) if cut else 0.0
    box = np.stack([corners.min(axis=0), corners.max(axis=0)])
    return LaunchWindow(box, center, frame, float(half[0]), float(half[1]), taper, incidence)


def share_of_small_facets(geometry: Geometry, spacing: float) -> float:
    """Share of the surface in smooth pieces' facets narrower than the rays' spacing: what tubes cannot resolve.

    Single flat facets of any size telescope to their rims; it is the small facets of curved surfaces that need
    several rays each. Flat pieces cut into small triangles count as one facet.
    """
    v, f = geometry.vertices, geometry.faces
    a, b = v[f[:, 1]] - v[f[:, 0]], v[f[:, 2]] - v[f[:, 0]]
    normal = np.cross(a, b)
    area = 0.5 * np.linalg.norm(normal, axis=1)
    normal /= np.maximum(2.0 * area, 1e-300)[:, None]
    group = geometry.face_group
    n = int(group.max()) + 1
    total = np.bincount(group, area, n)
    mean = np.stack([np.bincount(group, area * normal[:, i], n) for i in range(3)], axis=1)
    # a flat group's mean normal has length one
    curved = np.linalg.norm(mean, axis=1) < (1.0 - 1e-6) * total
    longest = np.sqrt(np.maximum.reduce([(e * e).sum(axis=1) for e in (a, b, a - b)]))
    narrow = 2.0 * area < spacing * np.maximum(longest, 1e-300)
    small = narrow & curved[group]
    return float(area[small].sum() / max(area.sum(), 1e-300))


def azimuth_cell(scene: Scene) -> float:
    """Azimuth resolution cell lambda / (2 theta) of the whole aperture at the image centre, m."""
    track = scene.radar.track
    middle = np.array([scene.image.center_x, scene.image.center_y, scene.image.height])
    first, last = track.position[0] - middle, track.position[-1] - middle
    mean_range = 0.5 * (np.linalg.norm(first) + np.linalg.norm(last))
    cosine = first @ last / (np.linalg.norm(first) * np.linalg.norm(last))
    # small angles lose all digits in the cosine: take the sine there
    sine = np.linalg.norm(np.cross(first, last)) / (np.linalg.norm(first) * np.linalg.norm(last))
    angle = float(np.arctan2(sine, cosine))
    if track.n_pulses < 2 or angle == 0.0:
        return float(mean_range)
    return float(scene.radar.waveform.wavelength / (2.0 * angle))


def scatterer_cell(scene: Scene, incidence: float) -> float:
    """Edge of the diffuse scatterers' cells: as asked, or just below the finer ground resolution, m."""
    if scene.settings.scatterer_cell > 0:
        return scene.settings.scatterer_cell
    finest = min(azimuth_cell(scene), scene.radar.waveform.range_cell) / CELLS_PER_RESOLUTION
    return float(2.0 ** (0.5 * np.floor(2.0 * np.log2(finest))))


def ray_spacing(scene: Scene, window: LaunchWindow, diffuse: bool, coherent: bool) -> float:
    """Distance between rays: as asked, or what the finest need among those present gives, m.

    Coherent tubes want ``RAYS_PER_WAVELENGTH`` where that is affordable (``FINE_RAYS``), else half a resolution
    cell; diffuse cells see :func:`diffuse_spacing`.
    """
    if scene.settings.ray_spacing > 0:
        return scene.settings.ray_spacing
    needs = [diffuse_spacing(scene, window)] if diffuse else []
    if coherent:
        fine = scene.radar.waveform.wavelength / RAYS_PER_WAVELENGTH
        if window.area / fine**2 <= FINE_RAYS:
            needs.append(fine)
        else:
            half_cell = 0.5 * min(azimuth_cell(scene), scene.radar.waveform.range_cell)
            needs.append(min(half_cell, np.sqrt(window.area / 1e5)))
    return float(min(needs))


def diffuse_spacing(scene: Scene, window: LaunchWindow) -> float:
    """Distance between the rays of diffuse returns: as asked, or footprints as large as the cells, m.

    The footprint is longest on level ground (over the cosine of the incidence angle) or, where the scene has any,
    on walls (over its sine).
    """
    if scene.settings.diffuse_ray_spacing > 0:
        return scene.settings.diffuse_ray_spacing
    v = scene.geometry.vertices[scene.geometry.faces]
    normal = np.cross(v[:, 1] - v[:, 0], v[:, 2] - v[:, 0])
    area = np.linalg.norm(normal, axis=1)
    steep = float(area[np.abs(normal[:, 2]) < 0.5 * area].sum()) > 0.01 * float(area.sum())
    slant = np.cos(window.incidence)
    if steep:
        slant = min(slant, np.sin(window.incidence))
    ground = scene.radar.waveform.range_cell / max(np.sin(window.incidence), 0.05)
    return float(FOOTPRINT_PER_CELL * min(azimuth_cell(scene), ground) / 1.05 * max(slant, 0.2))


def cell_grid(scene: Scene, window: LaunchWindow) -> LaunchGrid:
    """One ray through the middle of every scatterer cell of level ground, its tube the cell itself.

    The launch plane is the surface: all visible geometry must lie in one level plane. The cells are those that
    :class:`sarmitsuba.trace.speckle.CellFrame` finds, aligned with the scene's axes. No pass or subset differs.
    """
    cell = scatterer_cell(scene, window.incidence)
    geometry, antenna = scene.geometry, scene.radar.track.center_position
    visible = ~np.array([m.invisible for m in scene.materials], dtype=bool)[geometry.face_material]
    ground = geometry.vertices[geometry.faces[visible].ravel()]
    level = 0.5 * float(ground[:, 2].min() + ground[:, 2].max())
    hx, hy = window.half_x + window.taper, window.half_y + window.taper
    frame = window.frame
    rim = [frame.center[0] + x * frame.axis_x[0] + y * frame.axis_y[0] for x in (-hx, hx) for y in (-hy, hy)]
    ray = np.array(rim) - antenna
    rim = antenna + ray * ((level - antenna[2]) / ray[:, 2])[:, None]
    low = np.maximum(rim.min(axis=0), ground.min(axis=0))[:2]
    high = np.minimum(rim.max(axis=0), ground.max(axis=0))[:2]
    first, last = np.floor(low / cell), np.floor(high / cell)
    middle = np.floor(0.5 * (first + last))  # the plane's centre: float32 coordinates start there
    rows, columns = (np.arange(a, b + 1.0) for a, b in zip(first, last, strict=True))
    parts = []
    step = max(1, 4_000_000 // columns.size)  # bounds the temporary arrays of one slab
    for start in range(0, rows.size, step):
        i, j = rows[start : start + step, None], columns[None, :]
        seen = _on_level(antenna, frame, (i + 0.5) * cell, (j + 0.5) * cell, level)
        beyond = [np.abs(v) - half for v, half in zip(seen, (window.half_x, window.half_y), strict=True)]
        keep = (beyond[0] <= window.taper) & (beyond[1] <= window.taper)
        fade = [
            0.5 + 0.5 * np.cos(np.pi * np.clip(b[keep] / max(window.taper, 1e-6), 0.0, 1.0)) for b in beyond
        ]
        a, b = np.nonzero(keep)
        xy = np.stack([i[a, 0] - middle[0] + 0.5, columns[b] - middle[1] + 0.5], axis=1) * cell
        parts.append((xy, fade[0] * fade[1]))
    xy, weight = (np.concatenate(a) for a in zip(*parts, strict=True))
    order = np.argsort(morton(xy[:, 0], xy[:, 1], float(np.abs(xy).max(initial=cell))), kind="stable")
    x, y = np.ascontiguousarray(xy[order].T, dtype=np.float32)
    plane = LaunchFrame(
        np.array([[middle[0] * cell, middle[1] * cell, level]]),
        np.array([[1.0, 0.0, 0.0]]),
        np.array([[0.0, 1.0, 0.0]]),
    )
    return LaunchGrid(
        x,
        y,
        cell,
        0.0,
        window.half_x,
        window.half_y,
        window.taper,
        "diffuse",
        plane,
        weight[order].astype(np.float32) if window.taper > 0 else None,
    )


def _on_level(antenna: F64, frame: LaunchFrame, x: F64, y: F64, z: float) -> tuple[F64, F64]:
    """What :func:`sarmitsuba.trace.launch.project` gives for a grid of points (x, y) of one level."""
    ux, uy = frame.axis_x[0], frame.axis_y[0]
    w = np.cross(ux, uy)

    def along(v: F64) -> F64:
        return np.asarray((x - antenna[0]) * v[0] + ((y - antenna[1]) * v[1] + (z - antenna[2]) * v[2]))

    offset = frame.center[0] - antenna
    t = (offset @ w) / along(w)
    return t * along(ux) - offset @ ux, t * along(uy) - offset @ uy


def ray_lattices(
    scene: Scene, window: LaunchWindow, flags: KernelFlags, *, draw: int = 0, subset: int = 0
) -> tuple[LaunchGrid, ...]:
    """Lattices that together sample one pulse: one for all returns, or a coarser one of its own for the diffuse.

    Diffuse returns depend on their cells and hardly on the rays, so they need far fewer rays than coherent tubes.

    Parameters
    ----------
    draw : number of the independent lattice (ray subsets, passes)
    subset : 1 and 2 share out the coherent rays by ``SUBSET_SHARES``; both have all diffuse rays, because footprints
        wider than a cell would leave cells out
    """
    sparser = float(1.0 / np.sqrt(SUBSET_SHARES[subset]))

    def build(spacing: float, purpose: Purpose) -> LaunchGrid:
        return lattice(
            window.half_x,
            window.half_y,
            spacing,
            taper=window.taper,
            seed=scene.settings.seed,
            draw=draw,
            purpose=purpose,
        )

    if flags.diffuse and not (flags.footprint_splitting or flags.coherent or flags.multi_bounce):
        return (cell_grid(scene, window),)
    if not (flags.diffuse and flags.coherent):
        kind: Purpose = "diffuse" if flags.diffuse else "coherent"
        spacing = ray_spacing(scene, window, flags.diffuse, flags.coherent)
        return (build(spacing if flags.diffuse else sparser * spacing, kind),)
    coherent = sparser * ray_spacing(scene, window, False, True)
    diffuse = diffuse_spacing(scene, window)
    if scene.settings.ray_spacing > 0 and scene.settings.diffuse_ray_spacing == 0:
        diffuse = max(diffuse, coherent / sparser)
    if 0.8 < diffuse / coherent < 1.25:  # a second launch would cost more than the few rays it saves
        return (build(min(coherent, diffuse), "all"),)
    return (build(coherent, "coherent"), build(diffuse, "diffuse"))


__all__ = [
    "FOOTPRINT_PER_CELL",
    "RAYS_PER_WAVELENGTH",
    "LaunchWindow",
    "azimuth_cell",
    "cell_grid",
    "diffuse_spacing",
    "launch_window",
    "ray_lattices",
    "ray_spacing",
    "scatterer_cell",
    "share_of_small_facets",
]
