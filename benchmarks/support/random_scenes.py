"""Scenes drawn by seed: shapes, sizes, places, materials and radars that nobody chose.

Every draw is plain data (triangles in NumPy, numbers of the radar) and writes itself as an ordinary scene file, so
that a reference can be worked out from the draw without a line of the simulator.
"""

from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import trimesh

from benchmarks.support.random_shapes import box, frame, gabled, polygon, terrain, turned
from sarmitsuba.core.arrays import F64

SPEED_OF_LIGHT = 299_792_458.0
# carrier in Hz and the bandwidths that such radars have
BANDS = {
    "L": (1.3e9, (60e6, 200e6)),
    "C": (5.4e9, (80e6, 400e6)),
    "X": (9.65e9, (150e6, 900e6)),
    "Ku": (16e9, (0.3e9, 1.2e9)),
}

# copies of a small scene lie over so many resolution cells, and have so many triangles, at most
WIDEST = 120.0
MOST_FACES = 40_000


@dataclass(frozen=True)
class Radar:
    """Numbers of the sensor, in the units of the scene file."""

    band: str
    center_frequency: float
    bandwidth: float
    azimuth_resolution: float
    slant_range: float
    look_angle_deg: float
    heading_deg: float
    look_side: str
    mode: str
    polarisation: str
    pattern: str = "isotropic"
    azimuth_beamwidth_deg: float = 0.0

    @property
    def wavelength(self) -> float:
        """M."""
        return SPEED_OF_LIGHT / self.center_frequency

    @property
    def range_cell(self) -> float:
        """Slant range, m."""
        return SPEED_OF_LIGHT / (2.0 * self.bandwidth)


@dataclass(frozen=True, eq=False)
class Body:
    """One object: triangles (n, 3, 3) in m, closed (seen from outside) or open (seen from both sides).

    Smooth without a law: a metal where the permittivity is 0.
    """

    kind: str
    triangles: F64
    closed: bool
    law: str = "none"
    level_db: float = 0.0
    permittivity: float = 0.0


@dataclass(frozen=True, eq=False)
class Draw:
    """A scene.

    Parameters
    ----------
    seed, topic : what drew it
    bodies, radar : what there is and what sees it
    extent : m, of the image on the ground, both axes
    ray_spacing : m; 0: automatic
    method : of the scene file; empty: automatic
    """

    seed: int
    topic: str
    bodies: tuple[Body, ...]
    radar: Radar
    extent: float
    ray_spacing: float = 0.0
    method: str = ""

    @property
    def size(self) -> float:
        """Largest extent of a body along an axis, m."""
        return max(float(np.ptp(b.triangles.reshape(-1, 3), axis=0).max()) for b in self.bodies)

    def write(self, folder: Path) -> Path:
        """Write the scene file with its meshes and return its path."""
        folder.mkdir(parents=True, exist_ok=True)
        r = self.radar
        spacing = f'<float name="ray_spacing" value="{self.ray_spacing!r}"/>' if self.ray_spacing else ""
        if self.method:
            spacing += f'<string name="method" value="{self.method}"/>'
        # the references are physical optics, and facets lit by one another
        spacing += '<string name="edge_diffraction" value="off"/>'
        text = ['<scene version="3.0.0">', f'<integrator type="sar_path">{spacing}</integrator>']
        text.append('<sensor type="sar_antenna">')
        for name in ("mode", "look_side", "polarisation", "pattern"):
            text.append(f'<string name="{name}" value="{getattr(r, name)}"/>')
        for name in (
            *(
                "center_frequency",
                "bandwidth",
                "azimuth_resolution",
                "slant_range",
                "look_angle_deg",
                "heading_deg",
            ),
            "azimuth_beamwidth_deg",
        ):
            value = getattr(r, name)
            if name != "azimuth_beamwidth_deg" or value > 0:
                text.append(f'<float name="{name}" value="{value!r}"/>')
        # where the references have it; by default it is in the middle of the ground
        text += [f'<float name="aim_{axis}" value="0"/>' for axis in "xyz"]
        if r.pattern != "isotropic":
            text.append('<float name="elevation_beamwidth_deg" value="30"/>')
        text.append('<film type="range_film">')
        for name in ("azimuth", "range"):
            text.append(f'<float name="image_extent_{name}" value="{self.extent!r}"/>')
        text += ["</film>", "</sensor>"]
        for i, body in enumerate(self.bodies):
            text.append(f'<bsdf type="radar_material" id="m{i}">')
            if body.law == "none" and body.permittivity:
                text.append(f'<float name="permittivity_real" value="{body.permittivity!r}"/>')
            elif body.law == "none":
                text.append('<string name="material" value="pec"/>')
            else:
                # rougher than a wavelength: nothing of the coherent wave is left
                text += [
                    '<float name="permittivity_real" value="6"/>',
                    f'<float name="rms_height" value="{1.5 * r.wavelength!r}"/>',
                    f'<string name="diffuse_law" value="{body.law}"/>',
                    f'<float name="diffuse_level_db" value="{body.level_db!r}"/>',
                ]
            text.append("</bsdf>")
            mesh = trimesh.Trimesh(
                body.triangles.reshape(-1, 3),
                np.arange(3 * len(body.triangles)).reshape(-1, 3),
                process=False,
            )
            mesh.merge_vertices()
            mesh.export(folder / f"b{i}.ply")
            text.append(
                f'<shape type="ply" id="b{i}"><string name="filename" value="b{i}.ply"/><ref id="m{i}"/></shape>'
            )
        path = folder / f"{self.topic}_{self.seed}.xml"
        path.write_text("\n".join([*text, "</scene>\n"]), encoding="utf-8")
        return path


# ---------------------------------------------------------------- draws


def draw_radar(rng: np.random.Generator, bands: tuple[str, ...] = ("L", "C", "X", "Ku")) -> Radar:
    """Radar of any band, heading, look, side and mode."""
    band = str(rng.choice(bands))
    carrier, (low, high) = BANDS[band]
    bandwidth = float(np.exp(rng.uniform(np.log(low), np.log(high))))
    cell = SPEED_OF_LIGHT / (2.0 * bandwidth)
    mode = str(rng.choice(["stripmap", "spotlight"]))
    resolution = float(cell * rng.uniform(0.6, 1.6))
    slant_range = float(rng.uniform(3e3, 12e3))
    pattern, beam = "isotropic", 0.0
    if mode == "stripmap" and rng.random() < 0.5:
        # the beam just holds the Doppler band of the resolution
        pattern, beam = "gaussian", float(np.degrees(0.9 * SPEED_OF_LIGHT / carrier / (2.0 * resolution)))
    return Radar(
        band,
        carrier,
        bandwidth,
        resolution,
        slant_range,
        float(rng.uniform(20.0, 65.0)),
        float(rng.uniform(0.0, 360.0)),
        str(rng.choice(["left", "right"])),
        mode,
        str(rng.choice(["VV", "HH"])),
        pattern,
        beam,
    )


def draw_diffuse(seed: int) -> Draw:
    """Rough bodies of any size, with or without ground and a second body that hides some of them."""
    rng = np.random.default_rng([seed, 1])
    radar = draw_radar(rng)
    cell = max(radar.range_cell, radar.azimuth_resolution)
    size = float(np.exp(rng.uniform(np.log(cell / 3.0), np.log(50.0 * cell))))
    shapes: dict[str, Callable[[], tuple[F64, bool, bool]]] = {
        "box": lambda: (box(size * rng.uniform(0.3, 1.0, 3)), True, True),
        "tilted box": lambda: (box(size * rng.uniform(0.3, 1.0, 3)), True, False),
        "gabled": lambda: (gabled(rng, size * rng.uniform(0.3, 1.0, 3)), True, True),
        "post": lambda: (box(np.array([0.03, 0.03, 1.0]) * size), True, True),
        "sphere": lambda: (np.asarray(trimesh.creation.icosphere(4, 0.5 * size).triangles), True, False),
        "cylinder": lambda: (
            np.asarray(trimesh.creation.cylinder(0.3 * size, size, sections=48).triangles),
            True,
            False,
        ),
        "frame": lambda: (frame(size, size * rng.uniform(0.02, 0.2)), False, False),
        "terrain": lambda: (
            terrain(rng, size, size / rng.integers(2, 50), rng.uniform(0.02, 0.4)),
            False,
            True,
        ),
        "plate": lambda: (
            polygon(size * np.array([[-0.5, -0.3], [0.5, -0.3], [0.5, 0.3], [-0.5, 0.3]])),
            False,
            False,
        ),
        "cut plate": lambda: (terrain(rng, size, size / rng.integers(3, 50), 1e-9), False, False),
    }
    law = ("lambert", "constant", "constant_gamma")

    def body(lift: bool) -> Body:
        kind = str(rng.choice(list(shapes)))
        triangles, closed, upright = shapes[kind]()
        triangles = turned(triangles, rng, upright=upright)
        if lift:
            triangles = triangles - [0.0, 0.0, triangles[:, :, 2].min()]
        return Body(kind, triangles, closed, str(rng.choice(law)), float(rng.uniform(-15.0, 0.0)))

    bodies = [body(True)]
    if rng.random() < 0.3:  # another in the way or behind
        other = body(True)
        shift = np.array([*rng.uniform(-size, size, 2), 0.0])
        bodies.append(Body(other.kind, other.triangles + shift, other.closed, other.law, other.level_db))
    if rng.random() < 0.3:
        # the ground ends within the image
        side = 2.5 * size + 4.0 * cell
        ground = turned(terrain(rng, side, side / rng.integers(1, 30), 1e-9), rng, upright=True)
        bodies.append(
            Body(
                "ground",
                ground - [0.0, 0.0, 0.013],
                False,
                str(rng.choice(law)),
                float(rng.uniform(-15.0, 0.0)),
            )
        )
    reach = max(float(np.abs(b.triangles).max()) for b in bodies)
    return Draw(seed, "diffuse", tuple(bodies), radar, 2.0 * reach * 2.2 + 60.0 * cell)


def side_by_side(draw: Draw, most: int) -> tuple[Draw, int]:
    """Up to ``most`` copies of a diffuse scene, far enough apart not to hide each other, and how many; 1 if large.

    Each has speckle of its own, and lies elsewhere against the lattices of scatterers and rays.
    """
    r = draw.radar
    cell = max(r.range_cell, r.azimuth_resolution)
    points = np.concatenate([b.triangles.reshape(-1, 3) for b in draw.bodies])
    reach = float(np.linalg.norm(points[:, :2], axis=1).max())
    height = float(np.ptp(points[:, 2]))
    # shadow and layover fall across the track, either way
    slope = max(np.tan(np.radians(r.look_angle_deg)), 1.0 / np.tan(np.radians(r.look_angle_deg)))
    pitch = np.array([2.0 * reach + 3.0 * cell, 2.0 * reach + slope * height + 3.0 * cell])
    n = np.maximum((WIDEST * cell / pitch).astype(int), 1)
    n = np.minimum(n, max(1, int(np.sqrt(most) + 0.999)))
    faces = sum(len(b.triangles) for b in draw.bodies)
    while n.prod() > 1 and n.prod() * faces > MOST_FACES:
        n = np.maximum(n - 1, 1)
    heading = np.radians(r.heading_deg)
    along = np.array([np.sin(heading), np.cos(heading), 0.0])
    across = np.array([along[1], -along[0], 0.0])
    i, j = ((np.arange(k) - 0.5 * (k - 1)) * p for k, p in zip(n, pitch, strict=True))
    place = (i[:, None, None] * along + j[None, :, None] * across).reshape(-1, 3)
    bodies = tuple(
        replace(b, triangles=(b.triangles[None] + place[:, None, None]).reshape(-1, 3, 3))
        for b in draw.bodies
    )
    extent = draw.extent + 1.5 * float(((n - 1) * pitch).max())
    return replace(draw, bodies=bodies, extent=extent), int(n.prod())


def draw_metal(seed: int) -> Draw:
    """A single smooth metal body that is convex or flat: physical optics has one bounce and no shadow."""
    rng = np.random.default_rng([seed, 2])
    radar = draw_radar(rng, ("L", "C", "X"))
    size = float(np.exp(rng.uniform(np.log(6.0), np.log(60.0)))) * radar.wavelength
    n = int(rng.integers(3, 9))
    angle = np.sort(rng.uniform(0.0, 2.0 * np.pi, n))
    while np.diff(angle, append=angle[0] + 2 * np.pi).max() > 0.9 * np.pi:
        angle = np.sort(rng.uniform(0.0, 2.0 * np.pi, n))
    ring = 0.5 * size * np.column_stack([np.cos(angle), np.sin(angle)])  # on a circle: convex
    arm = size * rng.uniform(0.15, 0.5)
    corner = (
        size * np.array([[0, 0], [1, 0], [1, arm / size], [arm / size, arm / size], [arm / size, 1], [0, 1]])
        - size / 2
    )
    shapes: dict[str, Callable[[], tuple[F64, bool]]] = {
        "box": lambda: (box(size * rng.uniform(0.3, 1.0, 3)), True),
        "gabled": lambda: (gabled(rng, size * rng.uniform(0.3, 1.0, 3)), True),
        "polygon": lambda: (polygon(ring), False),
        "L": lambda: (polygon(corner), False),
        "frame": lambda: (frame(size, size * rng.uniform(0.05, 0.2)), False),
        "sphere": lambda: (np.asarray(trimesh.creation.icosphere(5, 0.5 * size).triangles), True),
        "cylinder": lambda: (
            np.asarray(trimesh.creation.cylinder(0.25 * size, size, sections=180).triangles),
            True,
        ),
    }
    kind = str(rng.choice(list(shapes)))
    triangles, closed = shapes[kind]()
    triangles = turned(triangles, rng, upright=False)
    if (
        not closed or rng.random() < 0.5
    ):  # facing the radar to a few lobe widths, else there is only side lobe
        triangles = _facing(triangles, radar, rng, 3.0 * radar.wavelength / size)
    cell = max(radar.range_cell, radar.azimuth_resolution)
    return Draw(seed, "metal", (Body(kind, triangles, closed),), radar, 2.2 * size + 60.0 * cell)


def _facing(triangles: F64, radar: Radar, rng: np.random.Generator, spread: float) -> F64:
    """Turn the largest face towards the antenna, off by a random angle of standard deviation ``spread`` rad."""
    normal = np.cross(triangles[:, 1] - triangles[:, 0], triangles[:, 2] - triangles[:, 0])
    n = normal[np.argmax(np.linalg.norm(normal, axis=1))]
    n = n / np.linalg.norm(n)
    target = -look_direction(radar) + spread * rng.standard_normal(3)
    target /= np.linalg.norm(target)
    return triangles @ trimesh.geometry.align_vectors(n, target)[:3, :3].T


def look_direction(radar: Radar) -> F64:
    """Unit vector from the antenna at mid-aperture to the aim point, east north up."""
    heading, look = np.radians(radar.heading_deg), np.radians(radar.look_angle_deg)
    along = np.array([np.sin(heading), np.cos(heading)])
    right = np.array([along[1], -along[0]])
    across = right if radar.look_side == "right" else -right
    return np.array([*(across * np.sin(look)), -np.cos(look)])


def draw_metal_coarse(seed: int) -> Draw:
    """A flat-faced body of ``draw_metal`` with rays as far apart as a large scene has them: up to 8 wavelengths."""
    rng = np.random.default_rng([seed, 3])
    for k in range(100):
        draw = draw_metal(1000 * seed + k)
        if draw.bodies[0].kind not in ("sphere", "cylinder"):
            break
    return replace(draw, seed=seed, topic="metal_coarse", ray_spacing=_far_apart(draw.radar, rng))


def _far_apart(radar: Radar, rng: np.random.Generator) -> float:
    """Distance between rays of 1 to 8 wavelengths, up to half a resolution cell, m."""
    cell = min(radar.range_cell, radar.azimuth_resolution)
    return min(float(rng.uniform(1.0, 8.0)) * radar.wavelength, 0.5 * cell)


def draw_fine(seed: int) -> Draw:
    """Two or three bodies on ground or without: shadows, mirrors, double bounces."""
    return _several_bodies(seed, np.random.default_rng([seed, 4]))


def draw_fine_coarse(seed: int) -> Draw:
    """Bodies of ``draw_fine`` with rays 1 to 8 wavelengths apart."""
    rng = np.random.default_rng([seed, 4])
    draw = _several_bodies(seed, rng)
    return replace(draw, topic="fine_coarse", ray_spacing=_far_apart(draw.radar, rng))


def _several_bodies(seed: int, rng: np.random.Generator) -> Draw:
    radar = draw_radar(rng, ("L", "C"))
    size = float(rng.uniform(6.0, 25.0)) * radar.wavelength
    shapes: dict[str, Callable[[], tuple[F64, bool, bool]]] = {
        "box": lambda: (box(size * rng.uniform(0.3, 1.0, 3)), True, True),
        "gabled": lambda: (gabled(rng, size * rng.uniform(0.3, 1.0, 3)), True, True),
        "tilted box": lambda: (box(size * rng.uniform(0.3, 1.0, 3)), True, False),
        "post": lambda: (box(np.array([0.06, 0.06, 1.0]) * size), True, True),
        "sphere": lambda: (np.asarray(trimesh.creation.icosphere(4, 0.4 * size).triangles), True, False),
        "plate": lambda: (
            polygon(size * np.array([[-0.5, -0.3], [0.5, -0.3], [0.5, 0.3], [-0.5, 0.3]])),
            False,
            False,
        ),
    }
    bodies = []
    for i in range(int(rng.integers(2, 4))):
        kind = str(rng.choice(list(shapes)))
        triangles, closed, upright = shapes[kind]()
        triangles = turned(triangles, rng, upright=upright)
        if kind == "plate":
            triangles = _facing(triangles, radar, rng, 0.3)
        triangles = triangles - [0.0, 0.0, triangles[:, :, 2].min()]
        if i:
            triangles = triangles + np.array([*rng.uniform(-size, size, 2), 0.0])
        bodies.append(Body(kind, triangles, closed, permittivity=float(rng.choice([0.0, 6.0]))))
    if rng.random() < 0.6:
        side = 3.5 * size
        ground = turned(terrain(rng, side, side, 1e-9), rng, upright=True) - [
            0.0,
            0.0,
            0.05 * radar.wavelength,
        ]
        law = str(rng.choice(["none", "lambert"]))
        bodies.append(Body("ground", ground, False, law, float(rng.uniform(-20.0, -5.0)), permittivity=6.0))
    reach = max(float(np.abs(b.triangles).max()) for b in bodies)
    return Draw(
        seed,
        "fine",
        tuple(bodies),
        radar,
        4.0 * reach + 40.0 * max(radar.range_cell, radar.azimuth_resolution),
    )


def draw_boxes(seed: int) -> Draw:
    """Boxes on rough ground, which hide parts of it and of each other: rough or of metal, with dihedrals and glints."""
    rng = np.random.default_rng([seed, 9])
    radar = draw_radar(rng)
    cell = max(radar.range_cell, radar.azimuth_resolution)
    extent = float(rng.uniform(25.0, 60.0)) * cell
    laws = ("lambert", "constant", "constant_gamma")
    rough = rng.random() < 0.7
    bodies = []
    for _ in range(int(rng.integers(1, 5))):
        size = float(np.exp(rng.uniform(np.log(3.0 * cell), np.log(0.4 * extent))))
        triangles = turned(box(size * rng.uniform(0.3, 1.0, 3)), rng, upright=True)
        triangles = triangles - [0.0, 0.0, triangles[:, :, 2].min()]
        place = np.array([*rng.uniform(-0.3 * extent, 0.3 * extent, 2), 0.0])
        triangles = triangles + place
        law = str(rng.choice(laws)) if rough else "none"
        bodies.append(Body("box", triangles, True, law, float(rng.uniform(-15.0, 0.0))))
    side = 1.6 * extent
    ground = terrain(rng, side, side / 4, 1e-9) - [0.0, 0.0, 0.013]
    bodies.append(Body("ground", ground, False, str(rng.choice(laws)), float(rng.uniform(-15.0, 0.0))))
    return Draw(seed, "boxes", tuple(bodies), radar, extent)


DRAWS: dict[str, Callable[[int], Draw]] = {
    "diffuse": draw_diffuse,
    "metal": draw_metal,
    "fine": draw_fine,
    "metal_coarse": draw_metal_coarse,
    "fine_coarse": draw_fine_coarse,
}
# topics whose distance between rays is forced: how the program fares, and warns, where a user asks for too few
STRESS = ("metal_coarse", "fine_coarse")
