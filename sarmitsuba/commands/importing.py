"""Convert city data into a scene: GeoJSON or OpenStreetMap footprints, CityGML, meshes, elevation rasters.

See docs/scenes.md.
"""

import argparse
from pathlib import Path

from sarmitsuba.commands.console import Console
from sarmitsuba.commands.scene_arguments import definition

NAME = "import"
HELP = "convert footprints, CityGML, meshes or an elevation raster into a scene"


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add this command's arguments."""
    parser.add_argument(
        "source",
        metavar="SOURCE",
        help="geojson, osm, gml, glb, gltf, obj, ply, stl, off, tif; or a folder of meshes",
    )
    parser.add_argument("-o", "--output", required=True, metavar="SCENE", help="scene file to write, .xml")
    parser.add_argument("--force", action="store_true", help="replace a scene of that name")
    parser.add_argument(
        "--material",
        action="append",
        default=[],
        type=definition,
        metavar="NAME=MATERIAL",
        help="material of walls, roofs, ground, windows, balconies, pavement, or of a mesh file's own name; may be "
        "repeated",
    )
    parser.add_argument(
        "--up", default="auto", choices=("auto", "y", "z"), help="axis of a mesh that points up"
    )
    parser.add_argument(
        "--unit",
        "--units",
        default="auto",
        metavar="UNIT",
        help="unit of meshes and of --crs local: m, cm, mm, km, ft, in",
    )
    place = parser.add_argument_group("place")
    place.add_argument(
        "--crs",
        default="",
        metavar="EPSG:N",
        help="coordinate system of the input; local = metres east, north",
    )
    place.add_argument(
        "--anchor",
        type=_anchor,
        metavar="LAT,LON[,H]",
        help="scene origin: latitude and longitude in degrees, height in m over the ellipsoid (default: middle of "
        "the buildings)",
    )
    place.add_argument(
        "--radius",
        type=float,
        default=0.0,
        metavar="M",
        help="only buildings within this distance of the origin",
    )
    ground = parser.add_argument_group("ground and heights")
    ground.add_argument("--dem", type=Path, metavar="TIF", help="elevation raster that becomes the terrain")
    ground.add_argument(
        "--tolerance",
        type=float,
        default=0.5,
        metavar="M",
        help="largest height error of its triangles (default: 0.5 m)",
    )
    ground.add_argument(
        "--geoid",
        type=float,
        default=0.0,
        metavar="M",
        help="height of sea level over the ellipsoid at the origin (default: 0)",
    )
    ground.add_argument(
        "--ground",
        action=argparse.BooleanOptionalAction,
        help="add a ground plane below everything (default: below buildings without a terrain)",
    )
    ground.add_argument(
        "--height",
        type=float,
        default=8.0,
        metavar="M",
        help="height of buildings without one (default: 8 m)",
    )
    ground.add_argument(
        "--storey", type=float, default=3.0, metavar="M", help="height of a storey (default: 3 m)"
    )
    relief = parser.add_argument_group("relief of facades")
    relief.add_argument(
        "--facades",
        default="",
        metavar="KINDS",
        help="some of windows,balconies,kerb, or none for plain walls (default: all of them on footprints)",
    )
    relief.add_argument("--seed", type=int, default=1, help="random seed of the relief (default: 1)")
    relief.add_argument(
        "--facade",
        action="append",
        default=[],
        type=definition,
        metavar="NAME=VALUE",
        help="statistics: bay, window_width, window_height, recess, spread, share, balcony_share, balcony_depth, "
        "parapet, kerb and pavement (its height and width), and limit (triangles); may be repeated",
    )


def run(args: argparse.Namespace, console: Console) -> int:
    """Import."""
    from sarmitsuba.core.errors import SceneError
    from sarmitsuba.loading.importing.convert import import_scene
    from sarmitsuba.loading.importing.facades import FacadeOptions
    from sarmitsuba.loading.importing.import_options import ImportOptions
    from sarmitsuba.radar.geodesy import Anchor

    if args.seed < 0:
        raise SceneError(f"import: --seed = {args.seed} must be 0 or more")
    options = ImportOptions(
        materials=dict(args.material),
        unit=args.unit,
        up=args.up,
        crs=args.crs,
        anchor=None if args.anchor is None else Anchor.of_degrees(*args.anchor),
        radius=args.radius,
        height=args.height,
        storey=args.storey,
        ground=args.ground,
        dem=args.dem,
        tolerance=args.tolerance,
        geoid=args.geoid,
        facades=FacadeOptions.read(args.facades, args.seed, dict(args.facade)),
    )
    model = import_scene(args.source, args.output, options, force=args.force)
    for note in model.notes:
        console.say(note)
    if model.anchor is not None:
        console.say(f"origin: {model.anchor}")
    console.say(
        f"{args.output}: render it with: python -m sarmitsuba render {args.output} -o out [--radar NAME]"
    )
    return 0


def _anchor(text: str) -> tuple[float, float, float]:
    try:
        latitude, longitude, *height = (float(word) for word in text.split(","))
        above = height[0] if height else float("nan")
        if not (
            len(height) <= 1 and abs(latitude) <= 90.0 and abs(longitude) <= 360.0 and not abs(above) > 9e3
        ):
            raise ValueError
    except ValueError:
        raise argparse.ArgumentTypeError(
            f"{text!r} is not LAT,LON or LAT,LON,H in degrees and metres, such as 48.137,11.575"
        ) from None
    return latitude, longitude, above
