"""Arguments that name a scene, the same for every command that takes one."""

import argparse
from pathlib import Path
from typing import TYPE_CHECKING, Literal, TypedDict

from sarmitsuba.core.errors import DataError

if TYPE_CHECKING:
    from sarmitsuba.radar.radar import Radar
    from sarmitsuba.scene.scene import Scene

# largest distance of the tracks of raw data and of their scene, m
_SAME_TRACK = 1e-3


def add_scene_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the scene itself, another radar, and values for its parameters."""
    parser.add_argument(
        "scene",
        metavar="SCENE",
        help="scene file (XML), the name of a shipped scene, or a mesh (glb, gltf, obj, ply, stl, off) with --radar",
    )
    parser.add_argument(
        "--radar",
        metavar="RADAR",
        help="radar to use in place of the scene's own: an XML file or a shipped radar's name",
    )
    parser.add_argument(
        "-D",
        "--define",
        action="append",
        default=[],
        type=definition,
        metavar="NAME=VALUE",
        help="set a $NAME of the scene file, or a parameter such as sar_path.max_depth; may be repeated",
    )
    parser.add_argument(
        "--ground",
        metavar="MATERIAL",
        help="add level ground of this material, such as soil or asphalt, at the scene's lowest level",
    )
    parser.add_argument(
        "--allow-outside",
        action="store_true",
        help="let the scene include files, and name meshes, from outside its own folder",
    )
    mesh = parser.add_argument_group(
        "mesh", "properties that a mesh file, or a scene made for light, does not contain"
    )
    mesh.add_argument(
        "--up",
        choices=("auto", "y", "z"),
        help="axis that points up (default: y in glTF, else by the shapes; z in a scene with a radar)",
    )
    mesh.add_argument(
        "--unit",
        choices=("auto", "m", "cm", "mm", "km", "ft", "in"),
        help="unit of its coordinates (default: m)",
    )
    mesh.add_argument(
        "--material",
        action="append",
        default=[],
        type=material_choice,
        metavar="[NAME=]MATERIAL",
        help="radar material of a mesh file's material NAME, or of all that are not named so: concrete, brick, glass, "
        "metal, pec, ... (default: by its name)",
    )
    mesh.add_argument(
        "--smooth",
        action="store_true",
        help="take meshes for the smooth surface through their corners, and fit finer facets to it; edges that bend by "
        "more than 40 deg stay sharp",
    )


def pixels(text: str) -> tuple[int, int]:
    """Numbers of pixels in azimuth and range of an argument ``128x96``, or ``128`` for both."""
    words = text.lower().split("x")
    if len(words) > 2 or not all(word.isdecimal() and int(word) > 0 for word in words):
        raise argparse.ArgumentTypeError(f"{text!r} is not of the form AZIMUTHxRANGE, such as 128x128")
    return int(words[0]), int(words[-1])


def scene_of(args: argparse.Namespace) -> "Scene":
    """Load the scene that the arguments name."""
    from sarmitsuba.loading.library import resolve_radar
    from sarmitsuba.loading.load import load_scene

    radar = resolve_radar(args.radar) if args.radar else None
    if args.smooth:
        args.define = [*args.define, ("sar_path.smooth", "true")]
    mesh, told = None, mesh_record(args)
    if told is not None:
        from sarmitsuba.loading.from_mesh import MeshOptions

        mesh = MeshOptions(**told)
    return load_scene(
        args.scene,
        radar=radar,
        parameters=dict(args.define),
        mesh=mesh,
        ground=args.ground,
        allow_outside=args.allow_outside,
    )


def scene_record(args: argparse.Namespace, scene: "Scene", folder: Path) -> dict[str, object]:
    """Where the scene of a run came from, for its record in ``folder``: files as seen from there, and a hash."""
    from sarmitsuba.loading.kept_paths import kept_path
    from sarmitsuba.loading.library import resolve_radar
    from sarmitsuba.simulation.execution.fingerprint import shapes_hash

    return {
        "scene": kept_path(scene.path, folder) if scene.path else scene.name,
        "scene_hash": shapes_hash(scene),
        "radar_file": kept_path(resolve_radar(args.radar), folder) if args.radar else None,
        "definitions": dict(args.define),
        "mesh": mesh_record(args),
        "ground": args.ground,
        "allow_outside": args.allow_outside,
    }


class MeshRecord(TypedDict):
    """Options of a mesh file, as recorded in parameters.json."""

    up: Literal["auto", "y", "z"]
    unit: str
    materials: dict[str, str]


def mesh_record(args: argparse.Namespace) -> MeshRecord | None:
    """Mesh options given to :func:`scene_of`, for the record of the run; None where there are none."""
    if not (args.up or args.unit or args.material):
        return None
    return {"up": args.up or "auto", "unit": args.unit or "auto", "materials": dict(args.material)}


def definition(text: str) -> tuple[str, str]:
    """Name and value of an argument ``NAME=VALUE``."""
    name, equals, value = text.partition("=")
    if not equals or not name:
        raise argparse.ArgumentTypeError(f"{text!r} is not of the form NAME=VALUE")
    if not value.strip():
        raise argparse.ArgumentTypeError(f"{text!r} has no value after the equals sign")
    return name, value


def material_choice(text: str) -> tuple[str, str]:
    """Name and material of an argument ``NAME=MATERIAL``; a material alone is that of all names."""
    from sarmitsuba.loading.names_of_materials import EVERY

    return definition(text if "=" in text else f"{EVERY}={text}")


def scene_of_data(args: argparse.Namespace, radar: "Radar") -> "Scene":
    """Scene of raw data: the one that ``--scene`` names, else that of the run in the folder of the raw data.

    Raises
    ------
    DataError
        The radar of the named scene flies elsewhere than that of the raw data.
    """
    import numpy as np

    from sarmitsuba.commands.picture import scene_of
    from sarmitsuba.loading.load import load_scene
    from sarmitsuba.machine.backend import ensure_backend

    if not args.scene:
        return scene_of(Path(args.raw).parent, allow_outside=args.allow_outside)
    ensure_backend()
    scene = load_scene(args.scene, allow_outside=args.allow_outside)
    own, told = (one.in_file_frame().track for one in (scene.radar.as_recorded(), radar))
    if own.n_pulses != told.n_pulses or np.abs(own.position - told.position).max() > _SAME_TRACK:
        raise DataError(
            f"--scene {args.scene}: its radar has another track than {args.raw}; give the scene that the data were "
            "made from, with its radar"
        )
    return scene
