"""Render an interferometric pair of a scene and evaluate it: two parallel passes, phase, coherence and heights.

The second pass is the first moved by a baseline across the line of sight. Both runs stay in OUT/first and OUT/second;
`interferogram OUT/first OUT/second` evaluates them again. See docs/interferometry.md.
"""

import argparse
from pathlib import Path

from sarmitsuba.commands import interferogram, render
from sarmitsuba.commands.console import Console
from sarmitsuba.commands.scene_arguments import scene_of

NAME = "insar"
HELP = "render two passes over a scene and make their interferogram"


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
    interferogram.add_pair_arguments(group)  # type: ignore[arg-type]


def run(args: argparse.Namespace, console: Console) -> int:
    """Render both passes and evaluate them."""
    import numpy as np

    from sarmitsuba.errors import DataError
    from sarmitsuba.interferometry import second_pass

    if args.no_focus or args.page:
        raise DataError("insar: --no-focus and --page belong to render; leave them out")
    out = Path(args.output)
    scene = scene_of(args)
    relief = float(np.ptp(scene.geometry.vertices[:, 2])) if scene.geometry.n_faces else 0.0
    offset = second_pass(scene.radar, relief, args.baseline)
    render.run(_changed(args, out / "first"), console)
    second = _changed(args, out / "second", no_focus=True)
    second.define = [
        *args.define,
        *((f"sar_antenna.pass_offset_{axis}", repr(v)) for axis, v in offset.items()),
    ]
    render.run(second, console)
    pair = argparse.Namespace(**{**vars(args), "first": str(out / "first"), "second": str(out / "second")})
    return interferogram.run(pair, console)


def _changed(args: argparse.Namespace, output: Path, **changes: object) -> argparse.Namespace:
    return argparse.Namespace(**{**vars(args), "output": str(output), **changes})


__all__ = ["HELP", "NAME", "add_arguments", "run"]
