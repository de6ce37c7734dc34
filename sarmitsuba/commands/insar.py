"""Render an interferometric pair of a scene and evaluate it: phase, coherence and heights.

The second pass is the first moved by a baseline across the line of sight; with --one-pass it is a second receiver. Both
runs stay in OUT/first and OUT/second; `interferogram OUT/first OUT/second` evaluates them again. See
docs/analysis.md.
"""

import argparse
from pathlib import Path
from typing import TYPE_CHECKING

from sarmitsuba.commands import interferogram, render
from sarmitsuba.commands.console import Console
from sarmitsuba.commands.scene_arguments import scene_of

if TYPE_CHECKING:
    from sarmitsuba.scene.scene import Scene

NAME = "insar"
# days between two passes, where none are given
DAYS = 1.0
MOST_DAYS = 1e5  # largest value, also of pass_days
HELP = "render two passes over a scene, or one with two receivers, and make their interferogram"


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add this command's arguments: those of `render`, and the pair's."""
    render.add_arguments(parser)
    group = parser.add_argument_group("pair")
    group.add_argument(
        "--baseline",
        type=float,
        metavar="M",
        help="perpendicular baseline, m, positive upwards (default: the scene's relief is 0.6 of the height of "
        "ambiguity, but at most a fifth of the critical baseline)",
    )
    group.add_argument(
        "--one-pass",
        action="store_true",
        help="one transmission and two receivers, the second beside the first, in place of two passes",
    )
    group.add_argument(
        "--days",
        type=float,
        metavar="D",
        help="days from the first pass to the second, for materials with temporal_coherence below 1 (default: 1)",
    )
    interferogram.add_pair_arguments(group)  # type: ignore[arg-type]


def run(args: argparse.Namespace, console: Console) -> int:
    """Render both passes and evaluate them."""
    from sarmitsuba.analysis.baseline import second_pass
    from sarmitsuba.core.errors import DataError

    if args.no_focus or args.page:
        raise DataError("insar: --no-focus and --page belong to render; leave them out")
    if args.one_pass and args.days is not None:
        raise DataError(
            f"insar: --days {args.days:g} with --one-pass, whose two images are of one time; leave one out"
        )
    if args.days is not None and not 0.0 <= args.days <= MOST_DAYS:
        raise DataError(
            f"insar: --days {args.days:g} is not between 0 and {MOST_DAYS:g} days; give the time between the passes"
        )
    out = Path(args.output)
    scene = scene_of(args)
    days = 0.0 if args.one_pass else DAYS if args.days is None else args.days
    offset = second_pass(scene.radar, relief_of(scene), args.baseline, passes=1 if args.one_pass else 2)
    render.run(_change_output(args, out / "first"), console)
    second = _change_output(args, out / "second", no_focus=True)
    second.define = [
        *args.define,
        *((f"sar_antenna.{name}", repr(value)) for name, value in offset.parameters.items()),
        ("sar_path.pass_days", repr(scene.settings.pass_days + days)),
    ]
    render.run(second, console)
    pair = argparse.Namespace(**{**vars(args), "first": str(out / "first"), "second": str(out / "second")})
    return interferogram.run(pair, console)


def relief_of(scene: "Scene") -> float:
    """From the lowest to the highest corner of the geometry in the image, m; of all geometry where there is none."""
    import numpy as np

    corners, image = scene.geometry.vertices, scene.image
    if not corners.size:
        return 0.0
    reach = 0.5 * float(np.hypot(image.extent_azimuth, image.extent_range))
    inside = np.linalg.norm(corners[:, :2] - [image.center_x, image.center_y], axis=1) <= reach
    return float(np.ptp(corners[inside if inside.any() else slice(None), 2]))


def _change_output(args: argparse.Namespace, output: Path, **changes: object) -> argparse.Namespace:
    return argparse.Namespace(**{**vars(args), "output": str(output), **changes})
