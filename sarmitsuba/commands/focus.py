"""Focus saved raw data into a calibrated complex image."""

import argparse
import hashlib
import os
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from sarmitsuba.commands.console import Console
from sarmitsuba.commands.image_arguments import (
    PictureStyle,
    add_axes_argument,
    add_label_arguments,
    add_scene_picture_arguments,
)
from sarmitsuba.commands.scene_arguments import pixels, scene_of_data
from sarmitsuba.core.constants import DEFAULT_WINDOW
from sarmitsuba.core.errors import DataError
from sarmitsuba.core.timing import StageTimer

if TYPE_CHECKING:
    from sarmitsuba.apps.cluster import DaskWorkers
    from sarmitsuba.machine.output import OutputFolder
    from sarmitsuba.radar.image_request import ImageRequest
    from sarmitsuba.radar.radar import Radar
    from sarmitsuba.signal.focusing.comparison import Alternative
    from sarmitsuba.signal.focusing.focuser import Focuser
    from sarmitsuba.signal.raw_data import RawData

# every focuser and their comparison; the image of the run is the reference focuser's
_ALL, COMPARISON = "all", "focusers.png"

NAME = "focus"
HELP = "focus saved raw data into an image"


class _Listing(argparse.Action):
    """Argument whose help ends with a list of registered names; the modules are imported only when help is shown."""

    def __init__(
        self,
        entries: Callable[[], str],
        option_strings: Sequence[str],
        dest: str,
        *,
        default: str | None,
        metavar: str,
        help: str,
    ) -> None:
        self._entries = entries
        super().__init__(option_strings, dest, default=default, metavar=metavar, help=help)

    @property
    def help(self) -> str:
        """Help text with the list."""
        return self._text + self._entries().replace("%", "%%")

    @help.setter
    def help(self, text: str) -> None:
        self._text = text

    def __call__(
        self,
        parser: argparse.ArgumentParser,
        namespace: argparse.Namespace,
        values: str | Sequence[object] | None,
        option_string: str | None = None,
    ) -> None:
        setattr(namespace, self.dest, values)


class _PairAction(argparse.Action):
    """Stores two numbers; one stands for both."""

    def __call__(
        self,
        parser: argparse.ArgumentParser,
        namespace: argparse.Namespace,
        values: str | Sequence[object] | None,
        option_string: str | None = None,
    ) -> None:
        given = list(values or ())
        if len(given) > 2:
            parser.error(f"argument {option_string}: expected 1 or 2 numbers, azimuth and range")
        setattr(namespace, self.dest, given if len(given) == 2 else 2 * given)


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add this command's arguments."""
    parser.add_argument(
        "raw",
        metavar="RAW",
        help="raw data written by `render` (raw.h5), or phase histories from elsewhere: a MATLAB file or a folder of "
        "them (docs/files.md)",
    )
    parser.add_argument("-o", "--output", required=True, metavar="OUT", help="folder for the results")
    parser.add_argument(
        "--force", action="store_true", help="replace results of other raw data in OUT; other files stay"
    )
    add_focus_arguments(parser)
    add_scene_picture_arguments(parser)
    parser.add_argument(
        "--scene",
        metavar="SCENE",
        help="scene of the data, for --labels, --outlines and --with-view (default: that of the run in RAW's folder)",
    )
    parser.add_argument(
        "--autofocus-records",
        action="store_true",
        help="apply the autofocus corrections that the provider delivered with the data (data.af of Gotcha files)",
    )
    image = parser.add_argument_group(
        "image", "pixel grid of the image (default: the scene's, as stored in RAW)"
    )
    image.add_argument(
        "--grid", choices=("slant", "ground"), help="slant range and azimuth, or ground metres"
    )
    image.add_argument(
        "--center",
        nargs=2,
        type=float,
        metavar=("X", "Y"),
        help="centre of the image, m in the frame of the scene's file",
    )
    image.add_argument("--height", type=float, metavar="Z", help="height of the image plane, m")
    image.add_argument(
        "--extent",
        nargs="+",
        action=_PairAction,
        type=float,
        metavar="M",
        help="size of the image on the ground in azimuth and range, m; one number is for both",
    )
    image.add_argument(
        "--pixels",
        type=pixels,
        metavar="AZIMUTHxRANGE",
        help="size of the image in pixels, such as 128x128, in place of --extent",
    )
    image.add_argument(
        "--spacing",
        nargs="+",
        action=_PairAction,
        type=float,
        metavar="M",
        help="pixel spacing in azimuth and range, m, one number for both; 0 = half a cell",
    )


def add_focus_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the arguments for focusing and for the files of the image."""
    parser.add_argument(
        "--no-chart", action="store_true", help="do not draw accuracy.png: error by cause and time by stage"
    )
    add_axes_argument(parser)
    add_label_arguments(parser)
    parser.add_argument(
        "--focuser",
        action=_Listing,
        entries=_focusers,
        default=None,
        metavar="NAME[,OPTION=VALUE...]",
        help="how to focus (default: the first of the list). all: every one of them, side by side in focusers.png. ",
    )
    parser.add_argument(
        "--motion-compensation",
        choices=("auto", "off"),
        default="auto",
        help="motion compensation for a focuser that needs a straight track, where the recorded one is not: auto "
        "compensates, off refuses (default: auto)",
    )
    parser.add_argument(
        "--autofocus",
        action=_Listing,
        entries=_autofocusers,
        default="none",
        metavar="NAME[,OPTION=VALUE...]",
        help="autofocus: estimate the track's error from the data (default: none). ",
    )
    parser.add_argument(
        "--interference-filter",
        action=_Listing,
        entries=_interference_filters,
        default="none",
        metavar="NAME[,OPTION=VALUE...]",
        help="filter against interference, before focusing (default: none). ",
    )
    parser.add_argument(
        "--window",
        action=_Listing,
        entries=_windows,
        default=DEFAULT_WINDOW,
        metavar="WINDOW",
        help="window against sidelobes in range and azimuth (default: taylor), with parameters if wanted, e.g. "
        "taylor:4:-35; rectangular is the sharpest. ",
    )
    parser.add_argument(
        "--format",
        action=_Listing,
        entries=_formats,
        default="hdf5,openexr",
        metavar="NAME[,NAME...]",
        help="file formats of the results (default: hdf5,openexr); what none of those named can hold is written as "
        "hdf5. ",
    )


def check_focus_arguments(args: argparse.Namespace) -> None:
    """Raise a SarmitsubaError for an unknown focuser, window or format, before any other work; fill in defaults."""
    from sarmitsuba.commands.results import Formats
    from sarmitsuba.signal.focusing.focuser import DEFAULT, parse_focuser

    Formats.parse(args.format)
    args.focuser = DEFAULT if args.focuser is None else args.focuser
    if args.focuser not in (DEFAULT, _ALL):
        parse_focuser(args.focuser)
    if args.autofocus != "none":
        from sarmitsuba.signal.focusing.autofocus import parse_autofocus

        parse_autofocus(args.autofocus)
    if args.interference_filter != "none":
        from sarmitsuba.signal.focusing.interference_filter import parse_interference_filter

        parse_interference_filter(args.interference_filter)
    if args.outlines:
        from sarmitsuba.view.outlines import check_installed

        check_installed()
    if args.window != DEFAULT_WINDOW:
        from sarmitsuba.signal.focusing.windows import parse_window

        parse_window(args.window)


def _focusers() -> str:
    from sarmitsuba.signal.focusing.focuser import FOCUSERS, Auto

    return " ".join(f"{focuser.name}: {focuser.help}." for focuser in (Auto(), *FOCUSERS))


def _autofocusers() -> str:
    from sarmitsuba.signal.focusing.autofocus import AUTOFOCUSERS

    return " ".join(f"{entry.name}: {entry.help}." for entry in AUTOFOCUSERS)


def _interference_filters() -> str:
    from sarmitsuba.signal.focusing.interference_filter import INTERFERENCE_FILTERS

    return " ".join(f"{entry.name}: {entry.help}." for entry in INTERFERENCE_FILTERS)


def _formats() -> str:
    from sarmitsuba.files import FORMATS

    return " ".join(f"{entry.name}: {entry.doc}." for entry in FORMATS)


def _windows() -> str:
    from sarmitsuba.signal.focusing.windows import WINDOWS

    return " ".join(f"{family.syntax}: {family.doc}." for family in WINDOWS)


def run(args: argparse.Namespace, console: Console) -> int:
    """Focus."""
    from sarmitsuba.commands import results
    from sarmitsuba.files import read_raw
    from sarmitsuba.loading.kept_paths import kept_path
    from sarmitsuba.machine.output import output_folder
    from sarmitsuba.signal.focusing import apply_autofocus_records, image_request

    check_focus_arguments(args)
    formats = results.Formats.parse(args.format)
    watch = StageTimer()
    with output_folder(args.output) as folder:
        with watch.stage("read raw"):
            raw = read_raw(args.raw)
            if args.autofocus_records:
                raw = apply_autofocus_records(raw)
            elif raw.autofocus_records:
                console.say("autofocus records of the data are not applied; --autofocus-records applies them")
        request = _request(raw, args)
        orders = any(layer.order > 0 for layer in raw.layers)
        names = results.expected_names(
            formats,
            raw.channels,
            raw=False,
            image=True,
            orders=orders,
            chart=not args.no_chart,
            labels=args.labels,
        )
        run_hash = str(raw.metadata.get(results.RUN_HASH) or _run_hash_of(Path(args.raw), raw))
        if args.focuser == _ALL:
            names += (COMPARISON,)
        folder.check(run_hash, names, force=args.force)
        check_focusing(raw.radar, request or image_request(raw), args)
        style = PictureStyle.of(args, lambda: scene_of_data(args, raw.radar), labelled=args.labels)
        folder.clear(run_hash, keep=[Path(args.raw)])
        record: dict[str, object] = {
            "command": "focus",
            "raw_file": kept_path(args.raw, folder.path),
            "versions": results.versions(),
            "radar": results.radar_record(raw.radar),
            "raw_domain": raw.domain,
            "simulation": raw.metadata,
        }
        if request is not None:
            record["image_request"] = request.as_dict()
        picture = focus_into(folder, raw, args, console, watch, record, style, request)
        record["warnings"] = console.warnings
        record["seconds"] = {**watch.seconds, "total": watch.total}
        results.save_record(folder, record)
        console.say(f"{picture} ({watch.total:.1f} s)")
    return 0


def _run_hash_of(path: Path, raw: "RawData") -> str:
    """Run hash of raw data without one: from the file and the one it names, or from the files in the folder."""
    from sarmitsuba.signal.raw_data import DATA_FILE

    files = sorted(path.iterdir()) if os.path.isdir(path) else [path]
    if DATA_FILE in raw.metadata:
        files.append(path.parent / str(raw.metadata[DATA_FILE]))
    facts = ((file.name, file.stat()) for file in files)
    state = hashlib.sha256(
        "".join(f"{name} {status.st_size} {status.st_mtime_ns}\n" for name, status in facts).encode()
    )
    return f"{path.resolve()} {state.hexdigest()}"


def check_focusing(radar: "Radar", request: "ImageRequest", args: argparse.Namespace) -> None:
    """Raise a SarmitsubaError where the requested image cannot be focused, before its data are made or read."""
    from sarmitsuba.analysis.geometric_labels import check_labelled
    from sarmitsuba.commands import results
    from sarmitsuba.signal.focusing import default_grid
    from sarmitsuba.signal.focusing.focuser import parse_focuser
    from sarmitsuba.signal.focusing.motion_compensation import needs_compensation
    from sarmitsuba.signal.image import ShownAxes

    radar = radar.as_recorded()
    grid = default_grid(radar, request)
    if args.labels:
        check_labelled(radar)
    elif args.classes is not None:
        raise DataError("--classes gives shapes their classes in labels, and there are none; add --labels")
    ShownAxes.of(grid, args.axes)
    for entry in results.Formats.parse(args.format).image:
        against = entry.objection(radar, request.grid) if entry.objection else ""
        if against:
            raise DataError(f"--format {entry.name}: {against}")
    if args.focuser == _ALL:
        return
    needs_compensation(parse_focuser(args.focuser), radar, grid, args.motion_compensation)


def _request(raw: "RawData", args: argparse.Namespace) -> "ImageRequest | None":
    """Image request of the data with the changes of the command line; None where there are none."""
    from sarmitsuba.radar.film import FILM

    changes: dict[str, object] = {"grid": args.grid, "height": args.height}
    FILM["image_height"].check_option("--height", args.height, "focus")
    pairs = (
        ("center", "image_", ("center_x", "center_y")),
        ("extent", "image_", ("extent_azimuth", "extent_range")),
        ("spacing", "pixel_", ("spacing_azimuth", "spacing_range")),
        ("pixels", "", ("pixels_azimuth", "pixels_range")),
    )
    for option, prefix, names in pairs:
        for name, value in zip(names, getattr(args, option) or (), strict=False):
            FILM[prefix + name].check_option(f"--{option}", value, "focus")
            changes[name] = value
    changes = {name: value for name, value in changes.items() if value is not None}
    if not changes:
        return None
    from sarmitsuba.signal.focusing import image_request

    return image_request(raw, changes)


def focus_into(
    folder: "OutputFolder",
    raw: "RawData",
    args: argparse.Namespace,
    console: Console,
    watch: StageTimer,
    record: dict[str, object],
    style: PictureStyle,
    request: "ImageRequest | None" = None,
    workers: "DaskWorkers | None" = None,
) -> Path:
    """Focus, write the image and its pictures into the folder, add to the record. Return the picture's path."""
    from sarmitsuba.commands import results
    from sarmitsuba.signal.focusing import focus

    if args.focuser == _ALL:
        return _compare(folder, raw, args, console, watch, record, style, request)
    focuser: str | Focuser = args.focuser
    if workers is not None:
        from sarmitsuba.apps.cluster import distribute_focuser
        from sarmitsuba.signal.focusing.focuser import parse_focuser

        focuser = distribute_focuser(parse_focuser(args.focuser), workers)
    with watch.stage("focus"):
        image = focus(
            raw,
            request=request,
            focuser=focuser,
            range_window=args.window,
            azimuth_window=args.window,
            motion_compensation=args.motion_compensation,
            autofocus=args.autofocus,
            interference_filter=args.interference_filter,
            progress=console.progress,
        )
    facts = image.metadata.get("focus", {})
    done: dict[str, object] = {
        "method": args.focuser,
        "window": args.window,
        "motion_compensation": args.motion_compensation,
        "autofocus": args.autofocus,
        "interference_filter": args.interference_filter,
    }
    record["focus"] = done
    if cost := facts.get("interference_filter"):
        console.say(
            f"interference filter {cost['method']}: {100.0 * cost['removed_share']:.2g} % of the spectrum removed; "
            f"SNR {-cost['snr_loss_db']:.2f} dB, side lobes added {cost['islr_added_db']:.1f} dB"
        )
    if "chosen" in facts:
        record["focus"] = {**done, "method": facts["method"], "chosen": facts["chosen"]}
        console.say(f"focuser: {facts['chosen']}")

    def others() -> "Sequence[Alternative]":
        from sarmitsuba.signal.focusing.comparison import alternatives
        from sarmitsuba.signal.focusing.focuser import parse_focuser

        if "motion_compensation" in facts:  # the straight track's focusers have another error
            return ()
        used = parse_focuser(facts["method"])
        used = used.with_options({name: str(facts[name]) for name in used.options})
        return alternatives(used, raw.radar, image.grid)

    return results.store_image(
        folder,
        image,
        results.Formats.parse(args.format),
        watch,
        record,
        console,
        chart=not args.no_chart,
        style=style,
        others=others,
    )


def _compare(
    folder: "OutputFolder",
    raw: "RawData",
    args: argparse.Namespace,
    console: Console,
    watch: StageTimer,
    record: dict[str, object],
    style: PictureStyle,
    request: "ImageRequest | None",
) -> Path:
    """Focus with every focuser and draw the images side by side; the image of the run is the reference focuser's."""
    from sarmitsuba.commands import results
    from sarmitsuba.signal.focusing import default_grid, image_request
    from sarmitsuba.signal.focusing.comparison import compare_focusers
    from sarmitsuba.signal.focusing.interference_filter import filter_interference, parse_interference_filter
    from sarmitsuba.signal.focusing.range_compression import range_compress
    from sarmitsuba.view.charts import focusers_figure

    with watch.stage("focus"):
        # grid of `focus`: of the start-stop radar
        grid = default_grid(raw.radar.start_stop(), request or image_request(raw))
        if (filtering := parse_interference_filter(args.interference_filter)) is not None:
            raw, record["interference_filter"] = filter_interference(
                range_compress(raw, method="flat"), filtering
            )
        found = compare_focusers(raw, grid, window=args.window, progress=console.progress)
    for result in found:
        facts = f"refused: {result.refusal}"
        if result is found[0]:
            facts = f"{result.seconds:.2f} s, the reference"
        elif result.image is not None:
            facts = (
                f"{result.seconds:.2f} s, error {result.error_db:.1f} dB, coherence {result.coherence:.6f}"
            )
        console.say(f"{result.name}: {facts}")
    record["focus"] = {"method": found[0].name, "window": args.window}
    record["focusers"] = [result.as_dict() for result in found]
    image = found[0].image
    assert image is not None
    results.store_image(
        folder,
        image,
        results.Formats.parse(args.format),
        watch,
        record,
        console,
        chart=not args.no_chart,
        style=style,
    )
    return results.draw_into(folder, COMPARISON, lambda: focusers_figure(found), console)
