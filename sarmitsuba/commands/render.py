"""Simulate a scene and focus it. Writes raw data, a calibrated complex image, pictures and the parameters."""

import argparse
import dataclasses
import time
from pathlib import Path
from typing import TYPE_CHECKING

from sarmitsuba.commands.cluster_arguments import add_cluster_argument, check_cluster_argument, open_workers
from sarmitsuba.commands.console import Console
from sarmitsuba.commands.focus import add_focus_arguments, check_focus_arguments, check_focusing, focus_into
from sarmitsuba.commands.image_arguments import PictureStyle, add_scene_picture_arguments, class_argument
from sarmitsuba.commands.scene_arguments import add_scene_arguments, pixels, scene_of, scene_record
from sarmitsuba.commands.view import PAGE, view_folder
from sarmitsuba.core.errors import DataError, RadarError
from sarmitsuba.core.timing import StageTimer

if TYPE_CHECKING:
    from sarmitsuba.apps.cluster import DaskWorkers
    from sarmitsuba.machine.output import OutputFolder
    from sarmitsuba.scene.scene import Scene
    from sarmitsuba.signal.raw_data import RawData
    from sarmitsuba.simulation.execution.run import Ready, Run

NAME = "render"
HELP = "simulate a scene and focus it"

_METHODS = ("raw", "hybrid", "image", "raster")


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
        "--pixels",
        type=pixels,
        metavar="AZIMUTHxRANGE",
        help="size of the image in pixels, such as 128x128, about its centre; extents of the scene do not count",
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
        help="add passes of rays for this many seconds of tracing and error estimation (default: the scene's); "
        "loading, planning, the final image and files take extra time; an interrupted run resumes when started "
        "again",
    )
    parser.add_argument(
        "--no-error-bars",
        action="store_true",
        help="keep one set of rays instead of two: half the data and half the focusing, but no error estimate",
    )
    parser.add_argument("--no-focus", action="store_true", help="write the raw data and stop")
    add_cluster_argument(parser)
    parser.add_argument(
        "--page",
        action="store_true",
        help="also write the web page of `view`: the run in 3-D",
    )
    parser.add_argument(
        "--force",
        action="store_true",
        help="simulate again and replace the results in OUT, also those of another scene; other files stay",
    )
    add_focus_arguments(parser)
    add_scene_picture_arguments(parser, loads=False)


def run(args: argparse.Namespace, console: Console) -> int:
    """Render."""
    from sarmitsuba.commands import results
    from sarmitsuba.machine.output import output_folder

    check_focus_arguments(args)
    _check_settings(args)
    check_cluster_argument(args)
    watch = StageTimer()
    with output_folder(args.output) as folder:
        from sarmitsuba.machine.backend import ensure_backend

        with watch.stage("start"):
            backend = ensure_backend()
        console.busy("loading the scene")
        with watch.stage("load"):
            scene = _scene_with_settings(args)
        run_hash = _check_everything(folder, scene, args)
        for note in scene.notes:
            console.note(note)
        settings = scene.settings
        record: dict[str, object] = {
            "command": "render",
            **scene_record(args, scene, folder.path),
            "seed": settings.seed,
            "versions": results.versions(),
            "backend": backend,
            "settings": settings,
            "image_request": scene.image.as_dict(),
            "radar": results.radar_record(scene.radar),
        }
        with open_workers(args, console, settings) as workers:
            if workers is not None:
                record["cluster"] = workers.name
            if settings.one_look or _several_bursts(scene):
                done = _image_only(folder, scene, args, console, watch, record, run_hash)
            else:
                done = _raw_and_image(folder, scene, args, console, watch, record, run_hash, workers)
        record["warnings"], record["notes"] = console.warnings, console.notes
        record["seconds"] = {**watch.seconds, "total": watch.total}
        results.save_record(folder, record)
        if args.page:
            done = view_folder(folder, console, allow_outside=args.allow_outside)
        console.say(f"{done} ({watch.total:.1f} s)")
    return 0


def _check_settings(args: argparse.Namespace) -> None:
    """Raise a SceneError for an option outside the bounds that the parameter of the same meaning has in a scene."""
    from sarmitsuba.loading.tables import INTEGRATOR

    for option, value in (
        ("seed", args.seed),
        ("target_error_db", args.target_error),
        ("time_limit", args.time_limit),
    ):
        name = option.removesuffix("_db").replace("_", "-")
        INTEGRATOR[option].check_option(f"--{name}", value, "render")


def _scene_with_settings(args: argparse.Namespace) -> "Scene":
    """The scene with the settings of the command line."""
    from sarmitsuba.simulation.planning.prediction.speed import glance

    glance()  # as early as possible, for the prediction
    if args.pixels:
        names = ("range_film.pixels_azimuth", "range_film.pixels_range")
        args.define += [(name, str(count)) for name, count in zip(names, args.pixels, strict=True)]
    scene = scene_of(args)
    changes = {
        "method": args.method,
        "seed": args.seed,
        "target_error_db": args.target_error,
        "time_limit": args.time_limit,
        "keep_subsets": False if args.no_error_bars else None,
    }
    settings = dataclasses.replace(
        scene.settings, **{key: value for key, value in changes.items() if value is not None}
    )
    return dataclasses.replace(scene, settings=settings)


def _check_everything(folder: "OutputFolder", scene: "Scene", args: argparse.Namespace) -> str:
    """Raise a SarmitsubaError for whatever would stop the run after its simulation. Return its run hash."""
    from sarmitsuba.commands import results
    from sarmitsuba.simulation.execution.fingerprint import fingerprint

    settings = scene.settings
    settings.check(scene.name, raw=args.no_focus or args.raw != "compressed")
    bursts = _several_bursts(scene)
    with_raw = not settings.one_look and not bursts
    if bursts and (args.no_focus or args.raw != "compressed" or args.focuser == "all" or args.cluster):
        raise DataError(
            f"{scene.name}: --no-focus, --raw, --focuser all and --cluster are of the raw data of one burst, and "
            f"bursts {bursts[0]} to {bursts[-1]} light the image; choose one, such as -D sar_antenna.burst={bursts[0]}"
        )
    if args.page and args.no_focus:
        raise DataError("--page shows the image, and --no-focus makes none; leave one of them out")
    if args.no_focus and (args.axes or args.outlines or args.with_view or args.labels or args.classes):
        raise DataError(
            "--axes, --outlines, --with-view, --labels and --classes are of the image, and --no-focus makes none; "
            "leave them out"
        )
    if not args.no_focus:
        check_focusing(scene.radar, scene.image, args)
        class_argument(args, scene)
    formats = results.Formats.parse(args.format)
    run_hash = fingerprint(scene, getattr(args, "extension", ()))
    if scene.settings.adds_passes:  # several passes are not replaced by one without --force
        run_hash += " passes"
    names = results.expected_names(
        formats,
        scene.radar.channels,
        raw=with_raw,
        image=not args.no_focus,
        orders=settings.keep_orders,
        chart=not (args.no_focus or args.no_chart),
        labels=args.labels,
    )
    if args.page:
        names += (PAGE,)
    if with_raw and scene.settings.adds_passes:
        names += (results.PASSES,)
    folder.check(run_hash, names, force=args.force)
    folder.check_space(
        results.least_bytes(
            scene, formats, raw=with_raw, image=not args.no_focus, chirped=args.raw == "chirped"
        )
    )
    return run_hash


def _several_bursts(scene: "Scene") -> tuple[int, ...]:
    """Numbers of the bursts that light the image where they are not the one of the scene's radar."""
    from sarmitsuba.radar.bursts import bursts_in_sight

    return bursts_in_sight(scene.description, scene.radar, scene.image)


def _raw_and_image(
    folder: "OutputFolder",
    scene: "Scene",
    args: argparse.Namespace,
    console: Console,
    watch: StageTimer,
    record: dict[str, object],
    run_hash: str,
    workers: "DaskWorkers | None",
) -> Path:
    """Make the raw data or reuse saved ones, write and focus them. Return the path of the picture or the raw data."""
    from sarmitsuba.commands import results
    from sarmitsuba.machine.journal import remove_journal
    from sarmitsuba.signal.chirp import to_chirped

    formats = results.Formats.parse(args.format)
    found = None
    compression = "flat" if scene.radar.chain is None else scene.radar.chain.pulse_filter
    if args.raw == "chirped" and compression != "flat":
        raise DataError(
            f"{scene.name}: --raw chirped: a {compression} filter cannot be undone; leave "
            "it out, or take pulse_filter = flat"
        )
    if not (args.force or scene.settings.adds_passes):
        with watch.stage("read raw"):
            found = results.saved_raw(folder, formats, run_hash, console)
    if found is not None and found[1].domain in ("compressed", args.raw):
        path, raw = found
        console.say(f"{path}: raw data of this scene and these settings, used again; --force simulates again")
        console.say(f"plan: {raw.metadata['plan']}")
        keep = [path] if raw.domain == args.raw else []
        record["raw_file"] = path.name
    else:
        raw, keep = _simulate(folder, scene, args, console, watch, run_hash, workers), []
        known = {"scene": scene.name, "look_side": raw.radar.look_side}
        raw = dataclasses.replace(raw, metadata={**known, **raw.metadata, results.RUN_HASH: run_hash})
    for note in raw.metadata.get("notes", ()):
        console.note(str(note))
    if raw.domain != args.raw:
        with watch.stage("chirp"):
            raw = to_chirped(raw)
    passes = [folder.path / results.PASSES] if folder.run_hash == run_hash else []
    folder.clear(run_hash, keep=[*keep, *passes])
    with watch.stage("write raw"):
        results.save_raw(folder, raw, formats, leave_out=keep)
    remove_journal(folder.path / results.BLOCKS)
    record |= {"raw_domain": raw.domain, "simulation": raw.metadata, "plan": raw.metadata.get("plan")}
    if args.no_focus:
        return folder.path / formats.names(raw=True)[0]
    style = PictureStyle.of(args, lambda: scene, labelled=args.labels)
    return focus_into(folder, raw, args, console, watch, record, style, workers=workers)


def _announcing(
    console: Console, args: argparse.Namespace, watch: StageTimer, limit: float | None = None
) -> "Ready":
    """Print the predicted time and the effects of a run before tracing; ``limit``: time limit of several passes, s."""
    from sarmitsuba.commands import results
    from sarmitsuba.signal.chirp import n_fast_chirped

    console.busy("building the geometry and planning")

    def ready(run: "Run") -> None:
        needs, radar = run.needs() if limit is None else run.needs().of_passes, run.scene.radar
        if args.raw == "chirped" and needs.raw_bytes:
            needs = needs.recorded(radar.window.n_samples, n_fast_chirped(radar))
        formats, channels = results.Formats.parse(args.format), run.scene.radar.channels
        needs = results.add_file_needs(
            needs, formats, channels, image=not args.no_focus, chart=not args.no_chart
        )
        if args.labels:
            needs = needs.labelled(run.label_needs())
        needs = dataclasses.replace(needs, spent=(watch.total, time.process_time()))
        needs.check()
        console.say(str(needs))
        console.say(f"plan: {run.plan.summary()}")
        if run.finished is not None and str(run.finished):
            console.say(str(run.finished))
        stages = needs.by_progress
        if limit is not None:  # passes report as one stage
            stages = {"refine": max(limit, stages.pop("trace", 0.0)), **stages}
        console.expect(stages)
        console.busy("laying out rays")

    return ready


def _simulate(
    folder: "OutputFolder",
    scene: "Scene",
    args: argparse.Namespace,
    console: Console,
    watch: StageTimer,
    run_hash: str,
    workers: "DaskWorkers | None",
) -> "RawData":
    """Return the raw data of one pass, or of as many passes as the target error or the time limit asks for."""
    from sarmitsuba.commands import results
    from sarmitsuba.machine.journal import remove_journal
    from sarmitsuba.simulation.execution.render import RenderOptions, execute

    settings = scene.settings
    state, limit = folder.path / results.BLOCKS, None
    if settings.adds_passes:
        state, limit = folder.path / results.PASSES, settings.time_limit
        if (
            args.force
        ):  # the saved passes of an interrupted run belong to the new results, not to the old ones
            folder.clear(run_hash)
        folder.announce(results.PASSES)
    with watch.stage("simulate"):
        try:
            done = execute(
                scene,
                RenderOptions(range_window=args.window, azimuth_window=args.window),
                focused=False,
                progress=console.progress,
                ready=_announcing(console, args, watch, limit),
                state=state,
                run_hash=run_hash,
                workers=workers,
            )
        except RadarError:  # no echoes: another run would give the same
            if not settings.adds_passes:
                remove_journal(state)
            raise
        finally:
            if settings.adds_passes:
                folder.enter(results.PASSES)
    refined = done.refinement
    if refined is not None and settings.target_error_db < 0.0 and not refined.met:
        console.warn(
            f"{scene.name}: the sampling error is {refined.error_db:.1f} dB after {refined.passes} passes. The time "
            f"limit of {settings.time_limit:g} s ended before {settings.target_error_db:g} dB was reached; run the "
            "command again to add passes"
        )
    assert done.raw is not None
    return done.raw


def _image_only(
    folder: "OutputFolder",
    scene: "Scene",
    args: argparse.Namespace,
    console: Console,
    watch: StageTimer,
    record: dict[str, object],
    run_hash: str,
) -> Path:
    """Simulate the image without raw data, or that of several bursts, and write it. Return the picture's path."""
    from sarmitsuba.commands import results
    from sarmitsuba.simulation.execution.render import render

    focusing = (
        {}
        if scene.settings.one_look
        else {
            "focuser": args.focuser,
            "motion_compensation": args.motion_compensation,
            "autofocus": args.autofocus,
            "interference_filter": args.interference_filter,
        }
    )
    with watch.stage("simulate"):
        image = render(
            scene,
            range_window=args.window,
            azimuth_window=args.window,
            **focusing,
            progress=console.progress,
            ready=_announcing(console, args, watch),
        )
    known = {"scene": scene.name, "look_side": scene.radar.look_side}
    image = dataclasses.replace(image, metadata={**known, **image.metadata})
    for note in image.metadata.get("notes", ()):
        console.note(str(note))
    folder.clear(run_hash)
    record |= {"simulation": image.metadata, "plan": image.metadata.get("plan"), "window": args.window}
    return results.store_image(
        folder,
        image,
        results.Formats.parse(args.format),
        watch,
        record,
        console,
        chart=not args.no_chart,
        style=PictureStyle.of(args, lambda: scene, labelled=args.labels),
    )
