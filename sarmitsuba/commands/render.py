"""Simulate a scene and focus it. Writes raw data, a calibrated complex image, pictures and the parameters."""

import argparse
import dataclasses
from pathlib import Path
from typing import TYPE_CHECKING

from sarmitsuba.commands.console import Console
from sarmitsuba.commands.focus import add_focus_arguments, check_focus_arguments, focus_into
from sarmitsuba.commands.scene_arguments import add_scene_arguments, scene_of
from sarmitsuba.errors import DataError
from sarmitsuba.timing import StageTimer

if TYPE_CHECKING:
    from sarmitsuba.echo.raw import RawData
    from sarmitsuba.scene.scene import Scene
    from sarmitsuba.simulation.run import Ready, Run

NAME = "render"
HELP = "simulate a scene and focus it"

_METHODS = ("raw", "hybrid", "image", "raster")
_WITHOUT_RAW = ("image", "raster")


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add this command's arguments."""
    add_scene_arguments(parser)
    parser.add_argument("-o", "--output", required=True, metavar="OUT", help="folder for the results")
    parser.add_argument(
        "--method",
        choices=_METHODS,
        help="how to simulate (default: the scene's); raw and hybrid make raw data, image and raster only an image",
    )
    parser.add_argument(
        "--seed", type=int, help="random seed (default: the scene's); the same seed gives the same result"
    )
    parser.add_argument(
        "--raw",
        choices=("compressed", "chirped"),
        default="compressed",
        help="what raw.h5 holds: range-compressed profiles (default), or chirped echoes as a receiver records them",
    )
    parser.add_argument(
        "--target-error",
        type=float,
        metavar="DB",
        help="add passes of rays until the image's sampling error is below this, e.g. -30 (default: the scene's)",
    )
    parser.add_argument(
        "--time-limit",
        type=float,
        metavar="S",
        help="keep adding passes of rays for this many seconds (default: the scene's); an interrupted run resumes when "
        "started again",
    )
    parser.add_argument(
        "--no-error-bars",
        action="store_true",
        help="keep one set of rays instead of two: half the data and half the focusing, but no error estimate",
    )
    parser.add_argument("--no-focus", action="store_true", help="write the raw data and stop")
    parser.add_argument("--force", action="store_true", help="overwrite the results in OUT")
    add_focus_arguments(parser)


def run(args: argparse.Namespace, console: Console) -> int:
    """Render."""
    from sarmitsuba.commands import results

    check_focus_arguments(args)
    watch = StageTimer()
    with results.output_folder(args.output, force=args.force) as folder:
        from sarmitsuba.backend import ensure_backend

        with watch.stage("start"):
            backend = ensure_backend()
        with watch.stage("load"):
            scene = scene_of(args)
        changes = {
            "method": args.method,
            "seed": args.seed,
            "target_error_db": args.target_error,
            "time_limit": args.time_limit,
            "keep_subsets": None if args.no_error_bars else True,
        }
        settings = dataclasses.replace(
            scene.settings, **{key: value for key, value in changes.items() if value is not None}
        )
        scene = dataclasses.replace(scene, settings=settings)
        for note in scene.notes:
            console.warn(note)
        record: dict[str, object] = {
            "command": "render",
            "scene": str(scene.path or scene.name),
            "radar_file": args.radar,
            "definitions": dict(args.define),
            "seed": settings.seed,
            "versions": results.versions(),
            "backend": backend,
            "settings": settings,
            "image_request": scene.image,
            "radar": results.radar_record(scene.radar),
        }
        if settings.method in _WITHOUT_RAW:
            done = _image_only(folder, scene, args, console, watch, record)
        else:
            done = _raw_and_image(folder, scene, args, console, watch, record)
        record["warnings"] = console.warnings
        record["seconds"] = {**watch.seconds, "total": watch.total}
        results.save_record(folder, record)
        console.say(f"{done} ({watch.total:.1f} s)")
    return 0


def _raw_and_image(
    folder: Path,
    scene: "Scene",
    args: argparse.Namespace,
    console: Console,
    watch: StageTimer,
    record: dict[str, object],
) -> Path:
    """Simulate raw data, write and focus them. Return the file to look at."""
    from sarmitsuba.commands import results

    raw = _simulate(folder, scene, args, console, watch)
    known = {
        "scene": scene.name,
        "look_side": raw.radar.look_side,
    }
    raw = dataclasses.replace(raw, metadata={**known, **raw.metadata})
    for note in raw.metadata.get("notes", ()):
        console.warn(str(note))
    if args.raw == "chirped":
        from sarmitsuba.echo.chirp import to_chirped

        with watch.stage("chirp"):
            raw = to_chirped(raw)
    results.clear_results(folder)
    with watch.stage("write raw"):
        results.save_raw(folder, raw)
    record |= {"raw_domain": raw.domain, "simulation": raw.metadata, "plan": raw.metadata.get("plan")}
    if args.no_focus:
        return folder / results.RAW
    return focus_into(folder, raw, args, console, watch, record)


def _announcing(console: Console, limit: float | None = None) -> "Ready":
    """Say what a run will take and with which effects, before it is traced; ``limit`` (s) of several passes."""

    def ready(run: "Run") -> None:
        needs = run.needs()
        console.say(str(needs))
        console.say(f"plan: {run.settled_plan.summary()}")
        stages = needs.by_progress
        if limit is not None:  # passes report as one stage
            stages = {"refine": max(limit, stages.pop("trace", 0.0)), **stages}
        console.expect(stages)

    return ready


def _simulate(
    folder: Path, scene: "Scene", args: argparse.Namespace, console: Console, watch: StageTimer
) -> "RawData":
    """Return the raw data of one pass, or of as many passes as the target error or the time limit asks for."""
    from sarmitsuba.commands import results
    from sarmitsuba.simulation.raw import simulate

    settings = scene.settings
    if settings.target_error_db >= 0.0 and settings.time_limit <= 0.0:
        with watch.stage("simulate"):
            return simulate(scene, progress=console.progress, ready=_announcing(console))
    from sarmitsuba.simulation.refinement.passes import refine

    with watch.stage("simulate"):
        refined = refine(
            scene,
            state=folder / results.PASSES,
            range_window=args.window,
            azimuth_window=args.window,
            progress=console.progress,
            ready=_announcing(console, settings.time_limit),
        )
    if settings.target_error_db < 0.0 and not refined.met:
        console.warn(
            f"{scene.name}: the sampling error is {refined.error_db:.1f} dB after {refined.passes} passes. The time "
            f"limit of {settings.time_limit:g} s ended before {settings.target_error_db:g} dB was reached; run the "
            "command again to add passes"
        )
    return refined.raw


def _image_only(
    folder: Path,
    scene: "Scene",
    args: argparse.Namespace,
    console: Console,
    watch: StageTimer,
    record: dict[str, object],
) -> Path:
    """Simulate the image without raw data and write it. Return the picture's path."""
    from sarmitsuba.commands import results
    from sarmitsuba.simulation.render import render

    method = scene.settings.method
    if args.no_focus or args.raw != "compressed":
        raise DataError(
            f"method {method} makes an image without raw data; leave out --no-focus and --raw, "
            "or use --method hybrid"
        )
    if scene.settings.target_error_db < 0.0 or scene.settings.time_limit > 0.0:
        raise DataError(
            f"method {method} makes one pass only; leave out target_error_db and time_limit (--target-error, "
            "--time-limit), or use --method hybrid"
        )
    with watch.stage("simulate"):
        image = render(
            scene,
            range_window=args.window,
            azimuth_window=args.window,
            progress=console.progress,
            ready=_announcing(console),
        )
    known = {"scene": scene.name, "look_side": scene.radar.look_side}
    image = dataclasses.replace(image, metadata={**known, **image.metadata})
    for note in image.metadata.get("notes", ()):
        console.warn(str(note))
    results.clear_results(folder)
    record |= {"simulation": image.metadata, "plan": image.metadata.get("plan"), "window": args.window}
    return results.store_image(folder, image, watch, record, console)


__all__ = ["HELP", "NAME", "add_arguments", "run"]
