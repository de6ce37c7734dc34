"""Labels of pixels from the paths whose echoes make them: mechanism, shape and material, level without speckle.

Boxes of shapes have the share of the shape that the antenna sees, and the pixels in its shadow.
"""

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
import scipy
from numpy.typing import NDArray

from sarmitsuba.analysis.geometric_labels import SurfacePoints, surface_points
from sarmitsuba.analysis.label_classes import match_shapes
from sarmitsuba.analysis.label_owners import SceneOwners, SceneShapes
from sarmitsuba.analysis.label_sight import SightLines, surface_samples
from sarmitsuba.core.arrays import F32, F64, I64, unit_rows
from sarmitsuba.core.constants import DEFAULT_WINDOW
from sarmitsuba.core.errors import DataError, RadarError, SceneError
from sarmitsuba.core.parameters import one_line
from sarmitsuba.machine.exclusive import exclusive
from sarmitsuba.scene.geometry import Geometry
from sarmitsuba.scene.scene import Scene
from sarmitsuba.signal.focusing.grid import default_grid
from sarmitsuba.signal.focusing.placement import ImagePlacement
from sarmitsuba.signal.image import ImageGrid
from sarmitsuba.signal.pixel_labels import LabelLayer, LabelledInstance
from sarmitsuba.simulation.execution.grouped_look import GroupedLook, drawn_sources
from sarmitsuba.simulation.execution.image import Imager
from sarmitsuba.simulation.execution.run import Run
from sarmitsuba.tracing.kernel.path_groups import MECHANISMS

# places on a shape whose sight decides its visible share
PLACES = 1024
# facets on a line of sight, at most, that are looked at for a second shape
_PASSED = 32


def boxes(where: NDArray[np.bool_]) -> tuple[tuple[int, int, int, int], F64, int]:
    """Box of pixels (n_azimuth, n_range), corners (4, 2) of the smallest rectangle about them, and their number.

    The box is the first and last row and column, -1 without pixels; the rectangle encloses the pixels' areas.
    """
    row, column = np.nonzero(where)
    if not row.size:
        return (-1, -1, -1, -1), np.full((4, 2), np.nan), 0
    box = (int(row.min()), int(column.min()), int(row.max()), int(column.max()))
    # ends of the rows of pixels are enough
    lines, first = np.unique(row, return_index=True)
    last = np.append(first[1:], row.size) - 1
    ends = [
        (line + a, column[end] + b)
        for a in (-0.5, 0.5)
        for end, b in ((first, -0.5), (last, 0.5))
        for line in (lines,)
    ]
    points = np.concatenate([np.stack(pair, axis=1) for pair in ends])
    return box, _smallest_rectangle(points), int(row.size)


def _smallest_rectangle(points: F64) -> F64:
    """Corners (4, 2) in turn of the rectangle of least area about points (n, 2), which lie not all on one line.

    One of its sides lies on a side of the convex hull (Freeman and Shapira, 1975).
    """
    hull = points[scipy.spatial.ConvexHull(points).vertices]
    side = np.roll(hull, -1, axis=0) - hull
    along = unit_rows(side)
    across = np.stack([-along[:, 1], along[:, 0]], axis=1)
    u, v = hull @ along.T, hull @ across.T
    best = int(np.argmin(np.ptp(u, axis=0) * np.ptp(v, axis=0)))
    a, b = u[:, best], v[:, best]
    corners = np.array([[a.min(), b.min()], [a.max(), b.min()], [a.max(), b.max()], [a.min(), b.max()]])
    return np.asarray(corners @ np.stack([along[best], across[best]]))


def _solid(scene: Scene) -> I64:
    """Faces that waves meet."""
    invisible = np.array([m.invisible for m in scene.materials], dtype=bool)
    if not scene.geometry.n_faces:
        return np.zeros(0, dtype=np.int64)
    return np.flatnonzero(~invisible[scene.geometry.face_material])


def visible_shares(scene: Scene, grid: ImageGrid, shapes: SceneShapes) -> F64:
    """Share of the area of each object that the antenna sees from the middle of its aperture, (n_shapes,) 0 ... 1.

    Of ``PLACES`` places on each, evenly spread. NaN for other shapes, which have no surface.
    """
    geometry, solid = scene.geometry, _solid(scene)
    out = np.full(shapes.n, np.nan)
    placement = ImagePlacement(grid, scene.radar)
    row_of = np.full(max(1, geometry.n_faces), -1, dtype=np.int64)
    row_of[solid] = np.arange(solid.size)
    places, rows, of = [np.zeros((0, 3))], [np.zeros(0, np.int64)], [np.zeros(0, np.int64)]
    for number in range(len(geometry.object_names)):
        place, face = surface_samples(geometry, number, PLACES)
        kept = row_of[face] >= 0
        places.append(place[kept])
        rows.append(row_of[face[kept]])
        of.append(np.full(int(kept.sum()), number))
    place, row, object_of = np.concatenate(places), np.concatenate(rows), np.concatenate(of)
    if not solid.size:
        seen = np.zeros(0, dtype=bool)
    else:
        sight = SightLines(geometry.vertices[geometry.faces[solid]])
        seen = sight.hidden_by(place, row, placement.antenna(place)) < 0
    count = np.bincount(object_of, minlength=shapes.n)
    total = np.bincount(object_of, seen, shapes.n)
    out[count > 0] = total[count > 0] / count[count > 0]
    return out


def shadows(scene: Scene, grid: ImageGrid, shapes: SceneShapes, points: Callable[[], SurfacePoints]) -> I64:
    """Number of pixels whose ground each shape alone hides from the antenna, (n_shapes,)."""
    out = np.zeros(shapes.n, dtype=np.int64)
    geometry, solid = scene.geometry, _solid(scene)
    if scene.radar.all_round or not solid.size or not shapes.ground.any():
        return out
    found, of_face = points(), geometry.face_object
    hidden = np.flatnonzero(~found.seen & shapes.ground[of_face[found.found.face]])
    if not hidden.size:
        return out
    row_of = np.full(geometry.n_faces, -1, dtype=np.int64)
    row_of[solid] = np.arange(solid.size)
    place, face = found.found.point[hidden].copy(), row_of[found.found.face[hidden]]
    antenna = ImagePlacement(grid, scene.radar).antenna(place)
    by = _hidden_by_one(geometry, solid, place, face, antenna)
    pixel, alone = found.found.pixel[hidden][by >= 0], by[by >= 0]
    pairs = np.unique(np.stack([pixel, alone], axis=1), axis=0)
    np.add.at(out, pairs[:, 1], 1)
    out[shapes.ground] = 0
    return out


def _hidden_by_one(geometry: Geometry, solid: I64, place: F64, face: I64, antenna: F64) -> I64:
    """Object (n,) that alone hides places (n, 3), m, on faces (n,) of ``solid`` from antennas (n, 3); -1: several."""
    corners = geometry.vertices[geometry.faces[solid]]
    sight, of_face = SightLines(corners), geometry.face_object[solid]
    out = np.full(len(place), -2, dtype=np.int64)
    going = np.arange(len(place))
    for _ in range(_PASSED):
        met = sight.hidden_by(place[going], face[going], antenna[going])
        going, met = going[met >= 0], met[met >= 0]
        if not going.size:
            break
        new = of_face[met]
        out[going] = np.where((out[going] == -2) | (out[going] == new), new, -1)
        line = antenna[going] - place[going]
        normal = sight.normal[met]
        along = np.einsum("ni,ni->n", line, normal)
        share = np.einsum("ni,ni->n", corners[met, 0] - place[going], normal)
        share = share / np.where(along == 0.0, 1e-300, along)
        place[going] += np.clip(share, 0.0, 1.0)[:, None] * line
        face[going] = met
        going = going[out[going] >= 0]
    return np.maximum(out, -1)


# power of a shape's sums of echoes, over the strongest, down to which they count as its place in the image
OWN_PLACE = 1e-6
# last name in the layer of classes: that of shapes without a class
NO_CLASS = "no class"
ECHO_LAYERS = (
    "mechanism",
    "mechanism_share",
    "mechanism_energy",
    "instance",
    "instance_share",
    "second_instance",
    "second_instance_share",
    "instance_here",
    "material",
    "material_share",
    "class",
    "class_share",
    "expected_sigma0",
    "expected_mechanism_share",
)


class EchoShares:
    """Powers of parts of an image, compared pixel by pixel.

    Parameters
    ----------
    shape : rows and columns of the image

    Attributes
    ----------
    total : (n_azimuth, n_range) float32, m^2, sum of the powers of all parts
    first, second : (n_azimuth, n_range) number of the strongest and of the second strongest part, from 1; 0: none
    first_power, second_power : (n_azimuth, n_range) float32, m^2
    """

    def __init__(self, shape: tuple[int, int]) -> None:
        self.total, self.first_power, self.second_power = (np.zeros(shape, np.float32) for _ in range(3))
        self.first, self.second = (np.zeros(shape, np.int32) for _ in range(2))

    def add(self, number: int, where: tuple[slice, slice], power: F32) -> NDArray[np.bool_]:
        """Add a part of a number above 0 that has powers in some rows and columns; returns where it leads there."""
        first, second = self.first[where], self.second[where]
        best, next_best = self.first_power[where], self.second_power[where]
        leads, follows = power > best, (power > next_best) & (power <= best)
        second[leads], next_best[leads] = first[leads], best[leads]
        first[leads], best[leads] = number, power[leads]
        second[follows], next_best[follows] = number, power[follows]
        self.total[where] += power
        return np.asarray(leads)

    @property
    def first_share(self) -> F32:
        """Share of the strongest part, 0 ... 1."""
        return np.asarray(self.first_power / np.maximum(self.total, np.float32(1e-37)), dtype=np.float32)

    @property
    def second_share(self) -> F32:
        """Share of the second strongest part, 0 ... 1."""
        return np.asarray(self.second_power / np.maximum(self.total, np.float32(1e-37)), dtype=np.float32)


class EchoLabels:
    """Traced echoes of a scene in an image, by their origin.

    Parameters
    ----------
    scene : as loaded
    grid : of the image
    classes : semantic classes of shapes, by name
    seed : of the scene's random numbers; None: the scene's
    windows : of range and azimuth

    Attributes
    ----------
    shapes, owners, groups : of the echoes
    owner, mechanism : (n_groups,) of every group of echoes
    shape : (n_groups,) shape of every group; their number for echoes of none
    """

    def __init__(
        self,
        scene: Scene,
        grid: ImageGrid,
        classes: Mapping[str, str],
        *,
        seed: int | None = None,
        windows: tuple[str, str] = (DEFAULT_WINDOW, DEFAULT_WINDOW),
    ) -> None:
        settings = replace(scene.settings, method="image", keep_subsets=False, keep_orders=False)
        if seed is not None:
            settings = replace(settings, seed=seed)
        # labels are of echoes before they are received
        run = Run(replace(scene, settings=settings, radar=replace(scene.radar, chain=None, emitters=None)))
        self.imager = Imager(run, grid, range_window=windows[0], azimuth_window=windows[1])
        run.admit(grid)
        self.scene, self.grid, self.classes = scene, grid, classes
        self.shapes = SceneShapes.of(scene, classes)
        self.owners = SceneOwners(scene, run, self.shapes)
        self.groups = GroupedLook(self.imager, self.owners.paths, self.owners.point)
        number = np.arange(self.owners.paths.n_groups)
        self.owner, self.mechanism = number // len(MECHANISMS), number % len(MECHANISMS)
        self.shape = self.owners.shape[self.owner]
        present = np.zeros(number.size, dtype=bool)
        present[self.groups.present] = True
        self._present = present

    def parts(self, of_group: I64) -> Iterator[tuple[int, NDArray[np.bool_]]]:
        """Number and groups (n_groups,) of every part of the echoes.

        Parameters
        ----------
        of_group : (n_groups,) part of each group; -1 for none
        """
        for part in np.unique(of_group[self._present]).tolist():
            if part >= 0:
                yield part, self._present & (of_group == part)

    def shares(self, of_group: I64) -> EchoShares:
        """Comparison of the parts; parameters as for :meth:`parts`."""
        out = EchoShares(self.grid.shape)
        for number, wanted in self.parts(of_group):
            where, power, _ = self.groups.powers_of(wanted, OWN_PLACE)
            out.add(number + 1, where, power)
        return out

    @property
    def image(self) -> NDArray[np.complex64]:
        """Image (n_channels, n_azimuth, n_range) of all groups."""
        return self.groups.image(self.groups.cells(self._present))


@dataclass(frozen=True)
class MechanismEcho:
    """Backscatter of an object by one mechanism.

    Parameters
    ----------
    mechanism : name
    bounces : number of reflections, as text; empty where the mechanism has none
    rcs : m^2
    """

    mechanism: str
    bounces: str
    rcs: float


_BOUNCES = {
    "single bounce": "1",
    "diffuse": "1",
    "wall and ground": "2",
    "double bounce": "2",
    "triple bounce": "3",
    "multiple bounces": "> 3",
    "diffuse after mirror": "> 1",
    "diffuse pair": "2",
}


@exclusive
def object_echoes(scene: Scene, name: str, channel: str | None = None) -> tuple[MechanismEcho, ...]:
    r"""Radar cross section of one object in its image by mechanism, in the order of bounces.

    .. math:: \sigma = \sum_p |s_p|^2 \, A_\mathrm{pixel} / A_\mathrm{cell}

    over the pixels, which is sigma0 integrated over area: the RCS of a lone point, and the mean one of clutter.

    Parameters
    ----------
    scene : as loaded
    name : of an object, or a pattern of names such as ``"house*"``, whose echoes are taken together
    channel : polarisation; None: the first

    Raises
    ------
    SceneError : no object has this name
    DataError, RadarError : method ``image``, which makes the look, refuses the scene

    Notes
    -----
    Paths over two objects count in halves, see docs/labels.md. Mechanisms interfere: their sum is not the RCS of all.
    """
    fitting = set(match_shapes(scene, name))
    if channel is not None and channel not in scene.radar.channels:
        raise SceneError(
            f"{scene.name}: no channel {one_line(channel)!r}; the radar has {', '.join(scene.radar.channels)}"
        )
    echoes = EchoLabels(scene, default_grid(scene.radar, scene.image), {})
    layer = 0 if channel is None else echoes.groups.channels.index(channel)
    wanted = np.array([*(one in fitting for one in echoes.shapes.names), False])
    out = {}
    for mechanism, groups in echoes.parts(np.where(wanted[echoes.shape], echoes.mechanism, -1)):
        image = echoes.imager.pack(echoes.groups.image(echoes.groups.cells(groups)))
        cell = image.cell_area * (np.sin(image.incidence_angle) if image.grid.kind == "slant" else 1.0)
        pixel = image.grid.azimuth_spacing * image.grid.range_spacing
        power = np.square(np.abs(image.data[layer]), dtype=np.float64)
        out[MECHANISMS[mechanism]] = float((power * pixel / cell).sum())
    order = sorted(out, key=lambda one: (_BOUNCES.get(one, "~"), MECHANISMS.index(one)))
    return tuple(MechanismEcho(one, _BOUNCES.get(one, ""), out[one]) for one in order if out[one] > 0.0)


@exclusive
def echo_labels(
    scene: Scene,
    grid: ImageGrid,
    classes: Mapping[str, str] | None,
    *,
    windows: tuple[str, str] = (DEFAULT_WINDOW, DEFAULT_WINDOW),
    points: Callable[[], SurfacePoints] | None = None,
    mechanisms: Sequence[str] | None = None,
) -> tuple[dict[str, LabelLayer], tuple[LabelledInstance, ...], tuple[str, ...]]:
    """Labels of pixels from the echoes of one look, as method ``image`` makes them.

    Parameters
    ----------
    scene : as loaded
    grid : of the image
    classes : semantic class of shapes, by name; None: without layers of classes
    windows : of range and azimuth
    points : gives the scene's surfaces in the image where they are already known, for shadows of instances
    mechanisms : of the echoes that layers and boxes of instances are made of; None: all

    Returns
    -------
    layers : by name, see docs/labels.md
    instances : every shape of the scene
    notes : parts that they leave out; where method ``image`` cannot show the scene, that alone

    Notes
    -----
    Shares are those of the powers of complex sums: of a part's echoes as they interfere. The parts of a pixel interfere
    with each other, so that their powers do not add up to the pixel's.
    """
    try:
        echoes = EchoLabels(scene, grid, classes or {}, windows=windows)
        look = echoes.imager.look
    except (RadarError, DataError) as error:
        return {}, (), (f"echoes are left out: {error}",)
    del look
    layers: dict[str, LabelLayer] = {}
    shape = grid.shape
    by_mechanism = EchoShares(shape)
    energy = np.zeros((*shape, len(MECHANISMS)), dtype=np.float32)
    for mechanism, wanted in echoes.parts(echoes.mechanism):
        where, power, _ = echoes.groups.powers_of(wanted, OWN_PLACE)
        energy[(*where, mechanism)] = power
        by_mechanism.add(mechanism + 1, where, power)
    layers |= _make_part_layers("mechanism", "mechanism of most of the power", by_mechanism, MECHANISMS)
    layers["mechanism_energy"] = LabelLayer(
        energy, "m^2", "power of the echoes of each mechanism, as RCS, summed over channels", parts=MECHANISMS
    )
    instances, by_shape, own = _instances(echoes, points or (lambda: surface_points(scene, grid)), mechanisms)
    numbered = {i + 1: name for i, name in enumerate(echoes.shapes.names)}
    layers |= _make_part_layers("instance", "shape of most of the power", by_shape, echoes.shapes.names)
    layers["second_instance"] = LabelLayer(
        by_shape.second, "", "shape of the second most power; 0: none", {0: "none", **numbered}
    )
    layers["second_instance_share"] = LabelLayer(
        by_shape.second_share, "", "its share of the sum of the powers of all shapes"
    )
    layers["instance_here"] = LabelLayer(
        own.astype(np.uint8),
        "",
        "1 where echoes of the shape of most of the power lie within a resolution cell, 0 in side lobes",
        {0: "no", 1: "yes"},
    )
    layers |= _material_and_class(echoes, with_classes=classes is not None)
    layers |= _make_expected_layers(echoes, energy)
    return layers, instances, _notes(echoes)


def _make_part_layers(
    name: str, text: str, shares: EchoShares, names: Sequence[str]
) -> dict[str, LabelLayer]:
    """Layers of the strongest part and of its share."""
    codes = {0: "none", **{i + 1: part for i, part in enumerate(names)}}
    kind = np.uint8 if len(names) < 255 else np.int32
    return {
        name: LabelLayer(shares.first.astype(kind), "", f"{text}; 0: no echo", codes),
        f"{name}_share": LabelLayer(
            shares.first_share, "", "its share of the sum of the powers of all, 0 ... 1"
        ),
    }


def _instances(
    echoes: EchoLabels, points: Callable[[], SurfacePoints], mechanisms: Sequence[str] | None
) -> tuple[tuple[LabelledInstance, ...], EchoShares, NDArray[np.bool_]]:
    """Instances, the comparison of their powers, and where the strongest one has echoes."""
    shapes, scene = echoes.shapes, echoes.scene
    shares, own = EchoShares(echoes.grid.shape), np.zeros(echoes.grid.shape, dtype=bool)
    counted = echoes.shape < shapes.n
    if mechanisms is not None:
        counted &= np.isin(echoes.mechanism, [MECHANISMS.index(name) for name in mechanisms])
    for number, wanted in echoes.parts(np.where(counted, echoes.shape, -1)):
        where, power, near = echoes.groups.powers_of(wanted, OWN_PLACE)
        leads = shares.add(number + 1, where, power)
        own[where] = np.where(leads, near, own[where])
    image = echoes.image
    total = float(np.square(np.abs(image), dtype=np.float64).sum())
    energy = np.bincount(echoes.shape, echoes.groups.energies(image), shapes.n + 1)
    seen = visible_shares(scene, echoes.grid, shapes)
    shadow = shadows(scene, echoes.grid, shapes, points)
    materials = _materials_of(echoes)
    out = []
    for i, name in enumerate(shapes.names):
        box, oriented, pixels = boxes(own & (shares.first == i + 1))
        out.append(
            LabelledInstance(
                number=i + 1,
                name=name,
                material=materials[i],
                semantic_class=echoes.classes.get(name, ""),
                box=box,
                oriented_box=oriented,
                pixels=pixels,
                shadow_pixels=int(shadow[i]),
                visible_share=float(seen[i]),
                energy_share=float(energy[i] / total) if total > 0.0 else 0.0,
            )
        )
    return tuple(out), shares, own


def _materials_of(echoes: EchoLabels) -> list[str]:
    """Material of the most area of each object; the kind of other shapes."""
    geometry, scene = echoes.scene.geometry, echoes.scene
    out = [""] * echoes.shapes.n
    for shape, material in zip(echoes.owners.shape, echoes.owners.material, strict=True):
        if shape < len(out):
            out[shape] = echoes.owners.materials[material]
    corners = geometry.vertices[geometry.faces]
    area = np.linalg.norm(np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]), axis=1)
    for i in range(len(geometry.object_names)):
        rows = geometry.faces_of_object(i)
        if rows.size:
            sums = np.bincount(geometry.face_material[rows], area[rows])
            out[i] = scene.materials[int(np.argmax(sums))].name
    return out


def _material_and_class(echoes: EchoLabels, *, with_classes: bool) -> dict[str, LabelLayer]:
    """Layers of the dominating material, and of the dominating class where there is a table of classes."""
    materials = echoes.owners.materials
    found = echoes.shares(echoes.owners.material[echoes.owner])
    layers = _make_part_layers("material", "material of most of the power", found, materials)
    if with_classes:
        names = tuple(dict.fromkeys(echoes.classes.values()))
        of_shape = [
            names.index(echoes.classes[name]) if name in echoes.classes else -1
            for name in echoes.shapes.names
        ]
        of_group = np.array([*of_shape, -1])[echoes.shape]
        # shapes without a class take part in the sum of powers
        found = echoes.shares(np.where(of_group < 0, len(names), of_group))
        layers |= _make_part_layers("class", "semantic class of most of the power", found, (*names, NO_CLASS))
    return layers


def _make_expected_layers(echoes: EchoLabels, energy: F32) -> dict[str, LabelLayer]:
    """Layers of the mean level over realisations, and of the shares of mechanisms in it."""
    groups = echoes.groups
    steady = ~np.isin(echoes.mechanism, list(groups.powers))
    coherent = groups.image(groups.cells(steady))
    mean: F64 = np.square(np.abs(coherent), dtype=np.float64)
    parts = energy.copy()
    for mechanism, power in groups.powers.items():
        mean += power
        parts[..., mechanism] = power.sum(axis=0)
    area = echoes.imager.pack(coherent).cell_area
    shares = parts / np.maximum(parts.sum(axis=-1, keepdims=True), np.float32(1e-37))
    return {
        "expected_sigma0": LabelLayer(
            np.moveaxis(mean / area, 0, -1).astype(np.float32),
            "1",
            "mean of sigma0 over realisations of the speckle, without noise",
            parts=groups.channels,
        ),
        "expected_mechanism_share": LabelLayer(
            shares,
            "",
            "share of each mechanism in the sum of the mean powers of all, 0 ... 1",
            parts=MECHANISMS,
        ),
    }


def _notes(echoes: EchoLabels) -> tuple[str, ...]:
    """Notes on parts that the labels of echoes leave out."""
    out = []
    if echoes.scene.settings.method != "image":
        out.append(
            "echoes are those of one look (method image): raw and hybrid images also change over the aperture"
        )
    if echoes.imager.run.plan.on("noise"):
        out.append("echoes are without receiver noise")
    drawn = [source.drawn for source in drawn_sources(echoes.imager)]
    return (*out, *(f"the expected level of {name} is that of those that were drawn" for name in drawn))
