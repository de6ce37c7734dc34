"""Interferogram of two runs of one scene: phase, coherence, baselines and heights, as pictures and JSON.

The second run's raw data are focused on the first image's grid where the second image has another one, as with another
track. See docs/analysis.md.
"""

import argparse
import dataclasses
import os
from pathlib import Path
from typing import TYPE_CHECKING

from sarmitsuba.commands.console import Console
from sarmitsuba.commands.image_arguments import files_of_run, image_file

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray

    from sarmitsuba.analysis.interferometry import HeightMap, Interferogram
    from sarmitsuba.signal.image import SarImage

NAME = "interferogram"
HELP = "phase, coherence, baselines and heights from two runs of one scene"

RECORD, PICTURE, POINTS = "interferogram.json", "interferogram.png", "heights.npz"
# file of the second image, where its raw data were focused on the first's grid
SECOND = "second_on_first.h5"
# share of a block's pixels in shadow from which on side lobes alone are left in it
IN_SHADOW = 0.9


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add this command's arguments."""
    parser.add_argument("first", metavar="RUN_A", help="folder of the first run, or its image file")
    parser.add_argument(
        "second",
        metavar="RUN_B",
        help="folder of the second run with its raw data, or an image on the first's grid",
    )
    parser.add_argument(
        "-o", "--output", metavar="FOLDER", help="folder for the results (default: the folder of RUN_B)"
    )
    add_pair_arguments(parser)


def add_pair_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the arguments that say how a pair is evaluated."""
    parser.add_argument("--channel", metavar="NAME", help="polarisation, such as HH (default: the first)")
    parser.add_argument(
        "--looks",
        nargs=2,
        type=int,
        metavar=("AZIMUTH", "RANGE"),
        help="pixels averaged into one (default: blocks, about square on the ground, of about 16 independent samples)",
    )
    parser.add_argument(
        "--common-band",
        action="store_true",
        help="spectral shift filter: keep the common band of both spectra on level ground; higher coherence, coarser "
        "resolution",
    )
    parser.add_argument(
        "--unwrap",
        action="store_true",
        help="unwrap the phase before conversion to heights (needs scikit-image); without, heights lie within one "
        "height of ambiguity above --lowest-height",
    )
    parser.add_argument(
        "--lowest-height",
        type=float,
        metavar="Z",
        help="lowest height in the scene, m in the frame of its file (default: a tenth of the height of ambiguity "
        "below the image plane)",
    )


def run(args: argparse.Namespace, console: Console) -> int:
    """Evaluate the pair."""
    from sarmitsuba.files import read_image
    from sarmitsuba.machine.output import OutputFolder

    OutputFolder(_target(args)).check_names((RECORD, PICTURE))
    first = read_image(image_file(Path(args.first)))
    second, made = _second(Path(args.second), first, args.channel, console)
    _evaluate(first, second, args, console, made)
    return 0


def _evaluate(
    first: "SarImage", second: "SarImage", args: argparse.Namespace, console: Console, made: bool
) -> None:
    """Print and write the interferogram of two images on one grid; ``made``: the second was focused here: save it."""
    import numpy as np

    from sarmitsuba.analysis.interferometry import height_map, interferogram, unwrapped_phase
    from sarmitsuba.commands.results import draw_into
    from sarmitsuba.files import write_image
    from sarmitsuba.machine import output as parameter_file
    from sarmitsuba.machine.atomic import atomic_path
    from sarmitsuba.machine.output import output_folder
    from sarmitsuba.view.fringes import interferogram_figure

    pair = interferogram(
        first,
        second,
        tuple(args.looks) if args.looks else None,
        channel=args.channel,
        band="common" if args.common_band else "full",
    )
    found = shadow = None
    if pair.baseline.perpendicular:
        phase = unwrapped_phase(pair) if args.unwrap else None
        shadow = _find_shadow(Path(args.first), first, pair, console)
        found = height_map(pair, phase, lowest=args.lowest_height, shadow=shadow)
    for line in _table(pair, found, shadow):
        console.say(line)
    with output_folder(_target(args)) as folder:
        if made:
            with folder.writing(SECOND) as path:
                write_image(second, path)
        record = {
            "command": "interferogram",
            "band": "common" if args.common_band else "full",
            "unwrapped": args.unwrap,
            **pair.as_dict(),
        }
        with folder.writing(RECORD) as path:
            parameter_file.write(path, record)
        if found is not None:
            with folder.writing(POINTS) as path, atomic_path(path) as part, part.open("wb") as file:
                np.savez_compressed(
                    file, points=found.points, sigma=found.sigma, coherence=found.coherence, phase=found.phase
                )
        title = str(first.metadata.get("scene", ""))
        path = draw_into(folder, PICTURE, lambda: interferogram_figure(pair, found, title=title), console)
    console.say(str(path))


def _find_shadow(
    run: Path, image: "SarImage", pair: "Interferogram", console: Console
) -> "NDArray[np.bool_] | None":
    """Blocks of a pair that lie in radar shadow, from the scene of the first run; None, with a note, without it."""
    import numpy as np

    from sarmitsuba.analysis.labels import labels
    from sarmitsuba.core.errors import SarmitsubaError
    from sarmitsuba.signal.image import block_means
    from sarmitsuba.view.page.run_folder import scene_of_run

    try:
        if not os.path.isdir(run):
            raise SarmitsubaError("the first image is not in the folder of its run")
        found = labels(scene_of_run(run), image=image, layers=["layover_shadow"])
    except SarmitsubaError as error:
        console.note(f"heights in radar shadow are not masked, they mean nothing there: {error}")
        return None
    (code,) = (k for k, name in found.layers["layover_shadow"].codes.items() if name == "shadow")
    share = block_means((found["layover_shadow"] == code).astype(np.float64), pair.looks)
    return np.asarray(share > IN_SHADOW)


def _second(given: Path, first: "SarImage", channel: str | None, console: Console) -> tuple["SarImage", bool]:
    """The second image on the first's grid, and whether it was focused here.

    It is the stored image, or one channel of the raw data focused with the first image's windows.
    """
    from sarmitsuba.analysis.interferometry import same_grid
    from sarmitsuba.core.errors import DataError
    from sarmitsuba.files import read_image, read_raw
    from sarmitsuba.signal.focusing import focus
    from sarmitsuba.signal.raw_data import Layer

    found, raw = files_of_run(given) if os.path.isdir(given) else (given, None)
    if found is not None or raw is None:
        image = read_image(found or image_file(given))
        if same_grid(first.grid, image.grid):
            return image, False
    if raw is None:
        raise DataError(
            f"{given}: its image is on another grid than the first, and there are no raw data to focus on that one; "
            "render the second pass with --method hybrid or raw"
        )
    facts = first.metadata.get("focus", {})
    console.say(f"{raw}: focused on the grid of the first image")
    data = read_raw(raw)
    wanted = channel or first.channels[0]
    one = dataclasses.replace(data, data=data.total(wanted)[None], layers=(Layer(wanted),))
    image = focus(
        one,
        first.grid,
        range_window=str(facts.get("range_window", "rectangular")),
        azimuth_window=str(facts.get("azimuth_window", "rectangular")),
        progress=console.progress,
    )
    return image, True


def _target(args: argparse.Namespace) -> Path:
    """Output folder."""
    second = Path(args.second)
    return Path(args.output or (second if os.path.isdir(second) else second.parent))


def _table(pair: "Interferogram", found: "HeightMap | None", shadow: "NDArray[np.bool_] | None") -> list[str]:
    """Text lines of the results."""
    import numpy as np

    b = pair.baseline
    coherence = pair.coherence
    quartiles = np.percentile(coherence, (25, 50, 75))
    lines = [
        f"{pair.kind}, {pair.channel}, {pair.grid.shape[0]} x {pair.grid.shape[1]} blocks of {pair.looks[0]} x "
        f"{pair.looks[1]} pixels, {pair.independent_looks:.1f} independent looks",
        f"baseline          perpendicular {b.perpendicular:.4g} m, parallel {b.parallel:.4g} m, "
        f"along {b.along:.4g} m",
        f"critical baseline {b.critical:.4g} m; share {abs(b.perpendicular) / b.critical:.3g}",
        f"coherence         quartiles {quartiles[0]:.3f}, {quartiles[1]:.3f}, {quartiles[2]:.3f}",
    ]
    if found is not None:
        sigma = float(np.nanmedian(found.sigma[coherence >= quartiles[1]]))
        share = 0.0 if shadow is None else float(shadow.mean())
        unknown = f"; none (nan) in radar shadow, {100.0 * share:.1f} % of the blocks" if share else ""
        lines.append(
            f"height            of ambiguity {b.height_of_ambiguity:.4g} m; standard deviation {sigma:.3g} m in the "
            f"more coherent half{unknown}"
        )
    return lines
