"""Model of a city in the scene's frame: position, ground, buildings, meshes.

Attributes of buildings come from OpenStreetMap tags and equivalent properties of other maps.
"""

import re
from collections.abc import Callable, Mapping
from contextlib import nullcontext
from dataclasses import dataclass, replace
from itertools import groupby
from typing import TYPE_CHECKING

import numpy as np

from sarmitsuba.core.arrays import F64
from sarmitsuba.core.errors import SceneError
from sarmitsuba.loading.importing.buildings import (
    FOOT,
    GABLED,
    PYRAMIDS,
    Building,
    add_building,
    add_pavement,
    rise,
    wall_segments,
)
from sarmitsuba.loading.importing.facades import FacadeBuilder
from sarmitsuba.loading.importing.import_options import ImportOptions
from sarmitsuba.loading.importing.parts import Parts
from sarmitsuba.loading.importing.places import (
    LOCAL,
    WIDEST,
    Places,
    check_width,
    local_of_geodetic,
    middle,
    project_onto_plane,
    try_conversion,
    unwrap_longitude,
)
from sarmitsuba.loading.importing.polygons import triangulate_in_space, why_unusable
from sarmitsuba.loading.importing.source_format import BuildingFootprint, CitySource, Solid
from sarmitsuba.loading.importing.terrain import HeightRaster, read_raster, terrain_mesh
from sarmitsuba.loading.names_of_materials import DEFAULT, check_chosen, is_doubtful, kind_of
from sarmitsuba.radar.geodesy import Anchor
from sarmitsuba.scene.mesh.model_units import UNITS

if TYPE_CHECKING:
    import shapely


MATERIALS = {
    "walls": "concrete",
    "roofs": "concrete",
    "ground": "medium_dry_ground",
    "windows": "glass",
    "balconies": "concrete",
    "pavement": "concrete",
}
# margin of ground around the buildings, for layover, shadow and speckle: m, and in building heights
_MARGIN, _MARGIN_HEIGHTS = 20.0, 1.5
# share of an outline covered by building parts from which the outline is omitted
_COVERED = 0.9
# deg from a heading within which walls return a line at their feet, and share of the walls from which it is told
_WITHIN_DEG, _ALONG = 3.0, 0.3


@dataclass(frozen=True, eq=False)
class Model:
    """Model of a city in the scene's frame.

    Parameters
    ----------
    name : of the source
    parts : triangles by part and material
    anchor : geodetic position of the origin; None if unknown
    buildings : from footprints, in order
    n_buildings : from footprints and solids
    notes : lines on objects found and omitted, and on assumptions
    """

    name: str
    parts: Parts
    anchor: Anchor | None
    buildings: tuple[Building, ...]
    n_buildings: int
    notes: tuple[str, ...]


def make_model(source: CitySource, options: ImportOptions) -> Model:
    """Model of a source: geometry in the scene's frame, placed on the ground.

    Raises
    ------
    SceneError : nothing is left, the city is too wide, its position is needed and unknown, or an option does not fit
    """
    parts = Parts()
    materials = _materials(source, options)
    crs = options.crs or source.crs or LOCAL
    if crs == LOCAL:
        _localise(source, options)
    elif source.crs and options.unit not in ("auto", "m"):
        raise SceneError(
            f"{source.name}: --unit holds for meshes and --crs local, not for {crs}; leave it out"
        )
    if options.facades.demanded and not source.footprints:
        raise SceneError(
            f"{source.name}: facades need building footprints; the file has none; leave --facades out"
        )
    _drop_unusable(source)
    _drop_outlines_of_parts(source)
    dem = source.dem or options.dem
    place = _Place.of(source, crs, options)
    raster = None
    if dem is not None:
        raster = read_raster(dem, options.geoid, place.around(options))
        place = place.on(raster, source)
    elif not place.points.size and not source.meshes:
        raise SceneError(f"{source.name}: holds no building or surface{_why(source)}; check the export")
    facades = FacadeBuilder(options.facades, materials["windows"], materials["balconies"])
    buildings = _add_footprints(parts, source, place, raster, options, facades, materials)
    n_solids = _add_solids(parts, source, place, raster, options, materials)
    for whole, meshes in groupby(sorted(source.meshes, key=lambda m: m.whole), key=lambda m: m.whole):
        with parts.of_building(whole) if whole else nullcontext():
            for mesh in meshes:
                parts.add(mesh.material, materials[mesh.material], mesh.vertices, mesh.faces)
    if raster is None and not parts.n_triangles:
        raise SceneError(
            f"{source.name}: no building is left{_why(source)}; see --radius, --crs and the file"
        )
    _add_ground(parts, source, place, raster, options, materials["ground"])
    check_width(parts.bounds(), source.name)
    notes = [*source.said(), *_counts(source.name, buildings, n_solids, facades, parts)]
    return Model(source.name, parts, place.known, tuple(buildings), len(buildings) + n_solids, tuple(notes))


def _why(source: CitySource) -> str:
    reasons = "; ".join(f"{n} {reason}" for reason, n in source.skipped.items())
    return f" (left out: {reasons})" if reasons else ""


def _materials(source: CitySource, options: ImportOptions) -> dict[str, str]:
    """Name of the material of every part."""
    names = {part.material for part in source.meshes}
    check_chosen(options.materials, names | set(MATERIALS), source.name)
    kinds = {name: kind_of(name, options.materials) for name in sorted(names)}
    for name, kind in kinds.items():
        if not kind:
            source.assume(
                f'materials with unknown names, {DEFAULT} taken (--material "{name}=..." changes it)',
                name,
            )
        elif is_doubtful(name, options.materials):
            source.assume(
                f'materials, {kind} by a word in the name (--material "{name}=..." changes it)', name
            )
    return {**MATERIALS, **{n: k or DEFAULT for n, k in kinds.items()}, **options.materials}


def _localise(source: CitySource, options: ImportOptions) -> None:
    """Convert plain coordinates to metres (heights already are), and shift map coordinates to the origin."""
    import shapely

    unit = UNITS.get(options.unit, 1.0)
    points = unit * _corners(source)
    finite = points[np.isfinite(points).all(axis=1)]
    shift = np.zeros(2)
    if len(finite) and options.anchor is None and np.abs(finite).max() > WIDEST:
        shift = np.round(0.5 * (finite.min(axis=0) + finite.max(axis=0)))
        source.notes.append(
            f"{source.name}: the origin is moved to {shift[0]:.10g} m, {shift[1]:.10g} m of the file"
        )
    if unit == 1.0 and not shift.any():
        return
    outlines = [shapely.transform(f.polygon, lambda xy: unit * xy - shift) for f in source.footprints]
    source.footprints[:] = [replace(f, polygon=p) for f, p in zip(source.footprints, outlines, strict=True)]
    scale, move = np.array([unit, unit, 1.0]), np.append(shift, 0.0)
    source.solids[:] = [
        Solid(
            s.name, tuple((part, tuple(scale * ring - move for ring in rings)) for part, rings in s.polygons)
        )
        for s in source.solids
    ]


def _drop_unusable(source: CitySource) -> None:
    kept = []
    for one in source.footprints:
        reason = why_unusable(one.polygon)
        if reason:
            source.skip(reason, one.name)
        else:
            kept.append(one)
    source.footprints[:] = kept


def _drop_outlines_of_parts(source: CitySource) -> None:
    """Remove building outlines that are also described by their parts."""
    import shapely

    parts = [f.polygon for f in source.footprints if f.is_part]
    outlines = [f for f in source.footprints if not f.is_part]
    if not parts:
        return
    tree = shapely.STRtree([part.representative_point() for part in parts])
    for one in outlines:
        inside = tree.query(one.polygon, predicate="contains")
        if sum(parts[i].area for i in inside) > _COVERED * one.polygon.area:
            source.skip("outlines of buildings that their parts describe", one.name)
            source.footprints.remove(one)


@dataclass(frozen=True, eq=False)
class _Place:
    """Position of the source on the Earth.

    Parameters
    ----------
    crs, places : coordinate system, and its conversion
    points : (n, 2) coordinates of all buildings in the file; metres if the crs is local
    anchor : geodetic position of the origin of the scene's frame
    known : the anchor if the source or the user states it
    level : whether the height of the anchor is given; else it is that of the ground
    """

    crs: str
    places: Places
    points: F64
    anchor: Anchor
    known: Anchor | None
    level: bool

    @staticmethod
    def of(source: CitySource, crs: str, options: ImportOptions) -> "_Place":
        places = Places(crs, source.name)
        points = _corners(source)
        given = options.anchor
        level = given is not None and bool(np.isfinite(given.height))
        anchor = given if given is None or level else replace(given, height=0.0)
        if crs == LOCAL or not points.size:
            if options.radius and points.size:
                _drop_far(source, lambda point: point, options.radius)
                points = _corners(source)
            return _Place(crs, places, points, anchor or Anchor(), anchor, level)
        try_conversion(points, crs, source.name)
        geodetic = places.geodetic(points)
        anchor = anchor or middle(geodetic)
        origin = anchor
        if options.radius:
            if given is None:
                check_width(local_of_geodetic(anchor, geodetic, 0.0), source.name)
            _drop_far(
                source,
                lambda point: local_of_geodetic(origin, places.geodetic(point), origin.height),
                options.radius,
            )
            points = _corners(source)
        check_width(local_of_geodetic(anchor, places.geodetic(points), anchor.height), source.name)
        return _Place(crs, places, points, anchor, anchor, level)

    def around(self, options: ImportOptions) -> F64 | None:
        """Bounds of continuous longitude and of latitude of the required terrain, (2, 2); None: the whole raster."""
        if self.points.size and self.known is not None:
            points = self.geodetic(self.points)
            margin = _MARGIN
        elif options.radius and self.known is not None:
            points, margin = np.degrees([[self.known.longitude, self.known.latitude]]), options.radius
        else:
            return None
        points[:, 0] = unwrap_longitude(points[:, 0], points[0, 0])
        step = np.degrees(margin / 6.37e6) / np.array(
            [max(np.cos(np.radians(points[:, 1]).max()), 0.01), 1.0]
        )
        return np.stack([points.min(axis=0) - step, points.max(axis=0) + step])

    def on(self, raster: HeightRaster, source: CitySource) -> "_Place":
        """Position with the anchor on the ground."""
        if self.crs == LOCAL and self.points.size and self.known is None:
            raise SceneError(
                f"{source.name}: --crs local has no position on the raster {raster.name}; give --anchor LAT,LON"
            )
        if source.meshes and self.known is None:
            raise SceneError(
                f"{source.name}: a mesh has no position on the raster {raster.name}; give --anchor LAT,LON"
            )
        anchor = self.known
        if anchor is None:
            n_rows, n_columns = raster.heights.shape
            corners = np.array([[0, 0], [n_rows - 1, n_columns - 1]])
            anchor = middle(raster.places(corners[:, 0], corners[:, 1]))
        if not self.level:
            here = raster.at(np.degrees([[anchor.longitude, anchor.latitude]]))[0]
            anchor = replace(
                anchor, height=round(float(here if np.isfinite(here) else np.nanmedian(raster.heights)), 3)
            )
        return replace(self, anchor=anchor, known=anchor)

    def geodetic(self, points: F64) -> F64:
        """Longitude and latitude of points of the file, (n, 2), deg."""
        if self.crs != LOCAL:
            return self.places.geodetic(points)
        flat = np.column_stack([points, np.zeros(len(points))])
        return np.degrees(self.anchor.to_geodetic(flat)[:, 1::-1])

    def ground(self, points: F64, raster: HeightRaster | None) -> F64:
        """Points of the file on the plane z = 0 or on the terrain, (n, 3), m; nan where the terrain has no height."""
        if raster is not None:
            geodetic = self.geodetic(points)
            return local_of_geodetic(self.anchor, geodetic, raster.at(geodetic))
        flat = points if self.crs == LOCAL else project_onto_plane(self.anchor, self.places.geodetic(points))
        return np.column_stack([flat, np.zeros(len(flat))])


def _corners(source: CitySource) -> F64:
    """Coordinates of all buildings in the file, (n, 2)."""
    import shapely

    outlines = shapely.get_coordinates([f.polygon for f in source.footprints])
    solids = [ring[:, :2] for s in source.solids for _, rings in s.polygons for ring in rings]
    return np.concatenate([outlines, *solids]) if solids else outlines


def _drop_far(source: CitySource, place: Callable[[F64], F64], radius: float) -> None:
    """Remove buildings whose centre, placed in the scene, lies beyond the radius."""
    reason = f"buildings beyond the radius of {radius:g} m"

    def far(point: F64) -> bool:
        return not float(np.linalg.norm(place(point))) <= radius

    for one in [f for f in source.footprints if far(np.array(f.polygon.centroid.coords))]:
        source.footprints.remove(one)
        source.skip(reason, one.name)
    for solid in [s for s in source.solids if far(np.mean([r[0][:1, :2] for _, r in s.polygons], axis=0))]:
        source.solids.remove(solid)
        source.skip(reason, solid.name)


def _add_footprints(
    parts: Parts,
    source: CitySource,
    place: _Place,
    raster: HeightRaster | None,
    options: ImportOptions,
    facades: FacadeBuilder,
    materials: dict[str, str],
) -> list[Building]:
    """Extrude every footprint from its ground."""
    import shapely

    buildings, names = [], []
    for one in source.footprints:
        corners = place.ground(shapely.get_coordinates(one.polygon), raster)
        if not np.isfinite(corners).all():
            source.skip("buildings where the terrain has no height", one.name)
            continue
        polygon = shapely.set_coordinates(shapely.force_2d(one.polygon), corners[:, :2])
        if why_unusable(polygon):
            source.skip(why_unusable(polygon), one.name)
            continue
        tags = {"walls": one.wall_material, "roofs": one.roof_material}
        own = {
            part: _choose_by_tag(source, part, tag, options, materials[part]) for part, tag in tags.items()
        }
        buildings.append(_building(one, polygon, corners[:, 2], options, own, raster is not None))
        names.append(one.name)
    away = [float(np.hypot(*b.polygon.centroid.coords[0])) for b in buildings]
    # the nearest to the origin, about which the image lies, have their relief first
    nearest = np.argsort(away, kind="stable")
    with_relief = []
    for number in nearest:
        building = buildings[number]
        with parts.of_building(names[number]):
            roof = add_building(parts, building, int(number), facades)
        if roof.is_flat and building.roof_shape not in ("", "flat"):
            source.assume("roofs of unsupported shapes, flat ones taken", names[number])
        if not facades.full:
            with_relief.append(building)
    if facades.full:
        radius = away[nearest[len(with_relief)]]
        source.notes.append(
            f"facades: {facades.n_plain} of {len(buildings)} buildings, those from {radius:.3g} m of the origin on, "
            f"have plain walls: limit = {facades.options.limit} triangles; --facade limit=N raises it"
        )
    if facades.options.pavements and with_relief and raster is None:
        facades.n_triangles += add_pavement(parts, with_relief, facades.options, materials["pavement"])
    elif facades.options.pavements and with_relief:
        source.notes.append("facades: no pavement on a terrain; its kerbs would not follow the slope")
    return buildings


def _choose_by_tag(source: CitySource, part: str, tag: str, options: ImportOptions, default: str) -> str:
    """Material of a building's walls or roofs: as chosen, else by its tag; guesses and unknown tags are counted."""
    if part in options.materials or not tag:
        return default
    kind = kind_of(tag, {})
    if not kind:
        source.assume(f"materials of {part} with unknown names, {default} taken", tag)
    elif is_doubtful(tag, {}):
        source.assume(f"materials of {part}, {kind} by a word in the name", tag)
    return kind or default


def _building(
    one: BuildingFootprint,
    polygon: "shapely.Polygon",
    ground: F64,
    options: ImportOptions,
    materials: dict[str, str],
    sloped: bool,
) -> Building:
    low = float(ground.min())  # OpenStreetMap measures heights from the lowest ground
    pitched = one.roof_shape in (*GABLED, *PYRAMIDS)
    height = one.height - one.above
    roof = min(one.roof if one.roof > 0.0 else rise(polygon, height), height) if pitched else 0.0
    top = one.height + (roof if one.lacks_roof else 0.0)
    sunk = FOOT + (options.tolerance if sloped else 0.0)
    return Building(
        polygon,
        foot=low + one.above if one.above else low - sunk,
        ground=low + one.above,
        eaves=low + top - roof,
        ridge=low + top,
        roof_shape=one.roof_shape,
        across=one.across,
        wall=materials["walls"],
        roof=materials["roofs"],
        storey=one.storey,
    )


def _add_solids(
    parts: Parts,
    source: CitySource,
    place: _Place,
    raster: HeightRaster | None,
    options: ImportOptions,
    materials: dict[str, str],
) -> int:
    """Add buildings given by polygons; without a terrain each is placed on the plane z = 0."""
    made = 0
    for solid in source.solids:
        rings = [ring for _, own in solid.polygons for ring in own]
        points = np.concatenate(rings)
        if place.crs == LOCAL:
            moved = points.copy()
        else:
            height = points[:, 2] + options.geoid
            moved = local_of_geodetic(place.anchor, place.places.geodetic(points[:, :2]), height)
        if raster is None:
            moved[:, 2] -= moved[:, 2].min()
        split = iter(np.split(moved, np.cumsum([len(ring) for ring in rings])[:-1]))
        with parts.of_building(solid.name):
            for part, own in solid.polygons:
                mesh = triangulate_in_space([next(split) for _ in own])
                if mesh is None:
                    source.skip("polygons that intersect themselves or have no area", solid.name)
                else:
                    parts.add(part, materials[part], *mesh)
        made += 1
    if made and raster is None:
        source.notes.append(
            f"{source.name}: every building is placed on the plane z = 0; --dem gives terrain"
        )
    return made


def _add_ground(
    parts: Parts,
    source: CitySource,
    place: _Place,
    raster: HeightRaster | None,
    options: ImportOptions,
    material: str,
) -> None:
    """Add the terrain, or a plane below the buildings."""
    if raster is not None:
        vertices, faces, net = terrain_mesh(raster, place.anchor, options.tolerance)
        parts.add("ground", material, vertices, faces)
        holes = int(np.isnan(raster.heights).sum())
        source.notes.append(
            f"{raster.name}: terrain of {raster.heights.size} samples in {len(faces)} triangles, error at most "
            f"{net.deviation:.2g} m (--tolerance); heights over the ellipsoid, geoid {options.geoid:g} m (--geoid)"
            + (f"; {holes} samples have no height and are holes" if holes else "")
        )
        return
    if options.ground is False or (options.ground is None and source.meshes):
        return
    (x0, y0, low), (x1, y1, high) = parts.bounds()
    z = low if source.meshes else 0.0
    margin = _MARGIN + _MARGIN_HEIGHTS * (high - z)
    corners = [[x0 - margin, y0 - margin, z], [x1 + margin, y0 - margin, z]]
    corners += [[x1 + margin, y1 + margin, z], [x0 - margin, y1 + margin, z]]
    parts.add("ground", material, corners, [[0, 1, 2], [0, 2, 3]])
    reach = float(np.abs(corners).max())
    drop = reach**2 / (2 * 6.371e6)
    source.notes.append(
        f"{source.name}: the ground is the plane z = {z:.4g} m; the Earth's surface lies {drop:.2g} m below it "
        f"at {reach:.4g} m from the origin"
    )


def main_heading(walls: F64) -> tuple[float, float]:
    """Heading of most walls, modulo 90 deg, 0 to 89, clockwise from y; and the share of their length within 3 deg.

    Parameters
    ----------
    walls : (n, 2, 2) float64, m, start and end in plan
    """
    step = walls[:, 1] - walls[:, 0]
    length = np.hypot(step[:, 0], step[:, 1])
    heading = np.degrees(np.arctan2(step[:, 0], step[:, 1])) % 90.0
    away = np.abs((heading[:, None] - np.arange(90.0) + 45.0) % 90.0 - 45.0)
    along = length @ (away <= _WITHIN_DEG)
    near = length @ np.maximum(_WITHIN_DEG - away, 0.0)
    best = int(np.argmax(near))
    return float(best), float(along[best] / max(length.sum(), 1e-300))


def _counts(
    name: str, buildings: list[Building], n_solids: int, facades: FacadeBuilder, parts: Parts
) -> list[str]:
    lines = []
    if buildings:
        high = [b.ridge - b.ground for b in buildings]
        area = sum(b.polygon.area for b in buildings)
        lines.append(
            f"{name}: {len(buildings)} buildings on {area:.6g} m^2, {min(high):.3g} m to {max(high):.3g} m high"
        )
        heading, share = main_heading(np.concatenate([wall_segments(b.polygon) for b in buildings]))
        if share >= _ALONG:
            lines.append(
                f"{name}: {100.0 * share:.0f} % of the walls run along or across heading {heading:.0f} deg; -D "
                f"heading_deg={heading:.0f} shows lines at their feet where the ground is smooth (--material "
                "ground=asphalt)"
            )
    if n_solids:
        lines.append(f"{name}: {n_solids} buildings of polygons")
    o = facades.options
    if o.relief and buildings:
        paved = any(part == "pavement" for part, *_ in parts)
        kerb = f", pavement {o.pavement:g} m wide with a kerb of {o.kerb:g} m" if paved else ""
        lines.append(
            f"facades: {facades.n_windows} windows and {facades.n_balconies} balconies, seed {o.seed}{kerb}; relief of "
            f"{facades.n_triangles} triangles (limit {o.limit} on walls)"
            + ("" if o.demanded else "; assumed, --facades none leaves walls plain")
        )
    return [*lines, f"{name}: {parts.n_triangles} triangles in all"]


Tags = Mapping[str, object]

_NUMBER = re.compile(r"\s*([-+]?\d+(?:[.,]\d+)?)\s*(m|ft|'|)\s*", re.IGNORECASE)
_FOOT = 0.3048
# the tallest building has 828 m and 163 storeys
_TALLEST, _MOST_LEVELS = 1200.0, 300.0
_HEIGHTS = ("height", "building:height", "HEIGHT", "Height", "measuredHeight", "building_height")
_LEVELS = ("building:levels", "levels", "num_floors", "storeys")


def is_building(tags: Tags) -> bool:
    """Whether the tags are those of a building, or of a part of a building, above the ground."""
    kind = str(tags.get("building") or tags.get("building:part") or "no")
    return kind != "no" and tags.get("location") != "underground"


def metres(value: object) -> float:
    """Length in metres from ``12``, ``12 m``, ``12,5`` or ``40'``; nan if malformed."""
    if isinstance(value, bool):
        return np.nan
    if isinstance(value, int | float):
        return float(value) if abs(value) < 1e6 else np.nan
    found = _NUMBER.fullmatch(str(value)[:40])
    if not found:
        return np.nan
    return float(found[1].replace(",", ".")) * (_FOOT if found[2].lower() in ("ft", "'") else 1.0)


def footprint(
    source: CitySource, name: str, polygon: "shapely.Polygon", tags: Tags, options: ImportOptions
) -> BuildingFootprint | None:
    """Footprint of a building with the attributes in its tags; None, counted as skipped, if its heights contradict.

    A ``height`` extends from the ground to the top of the roof; ``building:levels`` exclude those of the roof.
    """
    storey = options.storey
    levels = _positive(source, name, tags, _LEVELS, _MOST_LEVELS, "storeys")
    roof = _positive(source, name, tags, ("roof:height",), _TALLEST, "roof heights")
    roof_levels = metres(tags.get("roof:levels"))
    if np.isnan(roof) and roof_levels > 0.0:
        roof = roof_levels * storey
    height = _positive(source, name, tags, _HEIGHTS, _TALLEST, "heights")
    lacks_roof = np.isnan(height) and levels > 0.0 and not roof > 0.0
    if np.isnan(height) and levels > 0.0:
        height = levels * storey + (roof if roof > 0.0 else 0.0)
    elif np.isnan(height):
        height = options.height
        source.assume(f"buildings without a height, {height:g} m taken", name)
    elif levels > 0.0:
        storey = float(np.clip(height / levels, 2.0, 6.0))
    above = metres(tags.get("min_height", tags.get("building:min_height")))
    if np.isnan(above):
        above = metres(tags.get("building:min_level")) * storey
    above = 0.0 if np.isnan(above) else above
    if not 0.0 <= above < height:
        source.skip("buildings whose min_height is not below their height", name)
        return None
    return BuildingFootprint(
        name,
        polygon,
        height,
        above,
        roof=roof,
        lacks_roof=bool(lacks_roof),
        roof_shape=str(tags.get("roof:shape", "")),
        across=tags.get("roof:orientation") == "across",
        storey=storey,
        wall_material=str(tags.get("building:material", tags.get("building:facade:material", ""))),
        roof_material=str(tags.get("roof:material", "")),
        is_part="building:part" in tags,
    )


def _positive(
    source: CitySource, name: str, tags: Tags, keys: tuple[str, ...], most: float, what: str
) -> float:
    """Value of the first tag present; nan if none is, or (counted) if it is no number above 0."""
    value = next((tags[key] for key in keys if tags.get(key) not in (None, "")), None)
    if value is None:
        return np.nan
    number = metres(value)
    if not 0.0 < number <= most:
        if number != 0.0:
            source.assume(f"{what} that are no number from 0 to {most:g}, ignored", name)
        return np.nan
    return number
