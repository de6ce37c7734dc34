"""Render an interferometric pair of a scene and evaluate it: two parallel passes, phase, coherence and heights.

The second pass is the first moved by a baseline across the line of sight. Both runs stay in OUT/first and OUT/second;
`interferogram OUT/first OUT/second` evaluates them again. See docs/interferometry.md.
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
HELP = "render two passes over a scene and make their interferogram"

# automatic: the scene's relief is this part of the height of ambiguity, and level ground keeps this coherence
_RELIEF, _COHERENCE = 0.6, 0.8


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
    from sarmitsuba.errors import DataError

    if args.no_focus or args.page:
        raise DataError("insar: --no-focus and --page belong to render; leave them out")
    out = Path(args.output)
    scene = scene_of(args)
    offset = pass_offset(scene, args.baseline)
    render.run(_changed(args, out / "first"), console)
    second = _changed(args, out / "second", no_focus=True)
    second.define = [
        *args.define,
        *((f"sar_antenna.pass_offset_{axis}", repr(v)) for axis, v in offset.items()),
    ]
    render.run(second, console)
    pair = argparse.Namespace(**{**vars(args), "first": str(out / "first"), "second": str(out / "second")})
    return interferogram.run(pair, console)


def pass_offset(scene: "Scene", baseline: float | None) -> dict[str, float]:
    """Offset (m) across and up of the second pass: along the normal of line of sight and flight.

    Parameters
    ----------
    scene : gives the radar and, for an automatic baseline, its relief
    baseline : perpendicular, m; None: automatic
    """
    import numpy as np

    radar = scene.radar
    along = radar.track.along
    right = np.array([along[1], -along[0], 0.0])
    center = radar.track.center_position
    sight = radar.aim_point - center
    distance = float(np.linalg.norm(sight))
    normal = np.cross(sight / distance, along)
    normal *= np.sign(normal[2]) / np.linalg.norm(normal)
    if baseline is None:
        drop = sight - (sight @ along) * along
        incidence = float(np.arccos(-drop[2] / np.linalg.norm(drop)))
        wavelength = radar.waveform.wavelength
        critical = wavelength * distance * np.tan(incidence) / (2.0 * radar.waveform.range_cell)
        baseline = (1.0 - _COHERENCE) * critical
        relief = float(np.ptp(scene.geometry.vertices[:, 2])) if scene.geometry.n_faces else 0.0
        if relief > 0.0:
            baseline = min(baseline, _RELIEF * wavelength * distance * np.sin(incidence) / (2.0 * relief))
    return {"across": float(baseline * (normal @ right)), "up": float(baseline * normal[2])}


def _changed(args: argparse.Namespace, output: Path, **changes: object) -> argparse.Namespace:
    return argparse.Namespace(**{**vars(args), "output": str(output), **changes})


__all__ = ["HELP", "NAME", "add_arguments", "pass_offset", "run"]
