"""Heights of Munich's buildings from an interferometric pair, against the mesh: median error and spread.

    python -m benchmarks.studies.munich_heights --radar airborne_x -o out/munich_airborne_x

Renders both passes (kept in the output folder and used again), makes the interferogram, and compares the height of
every block of pixels that shows one building alone with what the first antenna sees of the mesh there.
"""

import argparse
import itertools
import json
import os
import sys
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from benchmarks.support import harness
from sarmitsuba.core.arrays import F64, I64

# rays a metre of level ground that find what is seen: several in every block, and in every window's width of a facade
RAYS_PER_METRE = 3.0
# a block shows one building where this share of what is seen there belongs to it, within this height, m
SHARE, WITHIN = 0.9, 2.0
# lower ones are kerbs and ledges; buildings of fewer blocks are left out of the statistics by building
LEAST_HEIGHT, LEAST_BLOCKS = 3.0, 4
LEAST_COHERENCE = 0.5
# what else lies in a block costs coherence: errors are stated between these, too
COHERENCES = (0.5, 0.8, 0.95, 0.98, 1.0)


@dataclass(frozen=True, eq=False)
class Truth:
    """What the first antenna sees in every block.

    Parameters
    ----------
    height : (n_azimuth, n_range) m, mean of the building seen there
    building : its number, -1 where no single building is seen
    names : of the buildings
    """

    height: F64
    building: I64
    names: tuple[str, ...]


def buildings_of(scene: Any) -> tuple[I64, tuple[str, ...]]:
    """Building of every face, and the names; a mesh's name is mesh-BUILDING-MATERIAL."""
    names = [name.removeprefix("mesh-").rsplit("-", 1)[0] for name in scene.geometry.mesh_names]
    unique, number = np.unique(names, return_inverse=True)
    return np.repeat(number, np.diff(scene.geometry.mesh_face_offset)), tuple(str(n) for n in unique)


def seen(scene: Any, reach: float) -> tuple[F64, I64]:
    """Points that mid-aperture sees, (n, 3) m, and their faces; on a square of ``reach`` about the image's centre."""
    from sarmitsuba.machine.backend import ensure_backend, mi

    ensure_backend()
    from sarmitsuba.tracing.kernel.scene_tables import build_trace_scene

    antenna = scene.radar.track.center_position
    traced = build_trace_scene(scene.geometry, scene.materials, scene.radar.waveform.wavelength)
    top = float(scene.geometry.vertices[:, 2].max()) + 5.0
    n = int(2.0 * reach * RAYS_PER_METRE)
    axis = np.linspace(-reach, reach, n)
    points, faces = [], []
    for rows in np.array_split(axis, max(1, n * n // 2_000_000)):
        x, y = (a.ravel() for a in np.meshgrid(axis + scene.image.center_x, rows + scene.image.center_y))
        target = np.stack([x, y, np.full(x.size, scene.image.height)], axis=-1)
        d = target - antenna
        d /= np.linalg.norm(d, axis=-1, keepdims=True)
        origin = target - d * (top / -d[:, 2:])
        hit = traced.mi_scene.ray_intersect_preliminary(
            mi.Ray3f(mi.Point3f(origin.T.astype(np.float32)), mi.Vector3f(d.T.astype(np.float32)))
        )
        t, valid = np.array(hit.t), np.array(hit.is_valid())
        points.append((origin + t[:, None] * d)[valid])
        faces.append(traced.geometry_faces[np.array(hit.prim_index)[valid]])
    return np.concatenate(points), np.concatenate(faces)


def truth_of(scene: Any, pair: Any) -> Truth:
    """Mean height and building of every block that shows one building alone."""
    reach = 0.5 * float(np.hypot(scene.image.extent_azimuth, scene.image.extent_range)) + 120.0
    points, faces = seen(scene, reach)
    owner, names = buildings_of(scene)
    building = owner[faces]
    grid = pair.grid
    # where the first image shows a point: its range, at zero Doppler of the look to it
    places = points + scene.offset
    look = pair.views[0].look(places)
    flat = np.array([*grid.origin[:2], grid.height]) + grid.offset
    azimuth = (places - flat) @ grid.along
    distance = look.distance(places)
    drop = look.center[:, 2] - flat[2]
    along = (places - look.center) @ grid.along
    across = np.sqrt(np.maximum(distance**2 - drop**2 - along**2, 0.0)) + (look.center - flat) @ grid.across
    column = across if grid.kind == "ground" else np.hypot(across, drop)
    i = np.round((azimuth - grid.azimuth[0]) / grid.azimuth_spacing).astype(int)
    j = np.round((column - grid.range[0]) / grid.range_spacing).astype(int)
    inside = (i >= 0) & (i < grid.shape[0]) & (j >= 0) & (j < grid.shape[1])
    block = (i * grid.shape[1] + j)[inside]
    return Truth(*_of_blocks(block, places[inside, 2], building[inside], grid.shape), names)


def _of_blocks(block: I64, z: F64, building: I64, shape: tuple[int, int]) -> tuple[F64, I64]:
    """Height and building of blocks in which one building has the share and little relief."""
    size = shape[0] * shape[1]
    order = np.lexsort((z, block))
    block, z, building = block[order], z[order], building[order]
    first = np.searchsorted(block, np.arange(size))
    last = np.searchsorted(block, np.arange(size), side="right")
    count = last - first
    middle = np.clip((first + last) // 2, 0, max(z.size - 1, 0))
    mode = np.where(count > 0, building[middle], -1)
    own = np.bincount(block, building == mode[block], size)
    mean = np.bincount(block, z, size) / np.maximum(count, 1)
    spread = np.sqrt(np.maximum(np.bincount(block, z * z, size) / np.maximum(count, 1) - mean**2, 0.0))
    single = (count > 0) & (own >= SHARE * count) & (spread <= 0.5 * WITHIN) & (mean >= LEAST_HEIGHT)
    return np.where(single, mean, np.nan).reshape(shape), np.where(single, mode, -1).reshape(shape)


def evaluate(out: Path, radar: str, definitions: dict[str, str], lowest: float) -> dict[str, Any]:
    """Statistics of the errors; writes ``munich_heights.json`` and ``munich_heights.png``."""
    from sarmitsuba.analysis.interferometry import height_map, interferogram
    from sarmitsuba.files import read_image

    scene = load(radar, definitions)
    first = read_image(out / "first" / "image.h5")
    second = read_image(out / "second_on_first.h5")
    pair = interferogram(first, second)
    found = height_map(pair, lowest=lowest)
    truth = truth_of(scene, pair)
    compared = (truth.building >= 0) & (found.coherence >= LEAST_COHERENCE)
    error = np.where(compared, found.z - truth.height, np.nan)
    per_building = {}
    for number in np.unique(truth.building[compared]):
        mine = compared & (truth.building == number)
        if mine.sum() >= LEAST_BLOCKS:
            per_building[truth.names[number]] = (
                float(np.median(truth.height[mine])),
                float(np.median(found.z[mine])),
                int(mine.sum()),
            )
    by_block, by_building = error[compared], np.array([b[1] - b[0] for b in per_building.values()])
    record = {
        "radar": radar,
        "definitions": definitions,
        **pair.as_dict(),
        "height_sigma_m": float(np.median(found.sigma[compared])),
        "blocks": _spread(by_block),
        "by_coherence": {
            f"{low:g} to {high:g}": _spread(error[compared & _within(found.coherence, low, high)])
            for low, high in itertools.pairwise(COHERENCES)
        },
        "buildings": _spread(by_building),
        "per_building": {
            k: {"mesh_m": m, "found_m": f, "blocks": n} for k, (m, f, n) in per_building.items()
        },
    }
    (out / "munich_heights.json").write_text(json.dumps(record, indent=1), encoding="utf-8")
    picture(out / "munich_heights.png", pair, found, truth, per_building, record)
    return record


def _within(coherence: F64, low: float, high: float) -> NDArray[np.bool_]:
    """Blocks of a coherence from low up to high, which one itself belongs to."""
    return np.asarray((coherence >= low) & ((coherence < high) | (high == 1.0)))


def _spread(error: F64) -> dict[str, float]:
    """Median, 1.4826 times the median absolute deviation, and count."""
    median = float(np.median(error)) if error.size else float("nan")
    spread = float(1.4826 * np.median(np.abs(error - median))) if error.size else float("nan")
    return {"median_m": median, "spread_m": spread, "count": int(error.size)}


def load(radar: str, definitions: dict[str, str]) -> Any:
    """Munich under that radar."""
    from sarmitsuba.loading.library import resolve_radar
    from sarmitsuba.loading.load import load_scene

    path = harness.munich()
    if path is None:
        sys.exit("munich_heights: the package sionna-rt, which carries the scene, is not installed")
    return load_scene(path, radar=resolve_radar(radar), parameters=definitions)


def picture(path: Path, pair: Any, found: Any, truth: Truth, per_building: Any, record: Any) -> None:
    """Found and true heights side by side, and building by building."""
    from matplotlib.figure import Figure

    grid = pair.grid
    extent = (grid.range[0], grid.range[-1], grid.azimuth[0], grid.azimuth[-1])
    shape = float(np.clip((extent[3] - extent[2]) / (extent[1] - extent[0]), 0.5, 1.5))
    figure = Figure(figsize=(16.0, 5.0 * shape + 0.8), dpi=100, layout="constrained")
    panels = figure.subplots(1, 3)
    top = float(np.nanpercentile(truth.height, 99.0)) if np.isfinite(truth.height).any() else 1.0
    kept = np.where(found.coherence >= LEAST_COHERENCE, found.z, np.nan)
    for axes, values, title in (
        (panels[0], kept, f"found (m); grey: coherence below {LEAST_COHERENCE:g}"),
        (panels[1], truth.height, "mesh (m), where one building is seen alone"),
    ):
        axes.set_facecolor("0.75")
        shown = axes.imshow(
            values, origin="lower", extent=extent, cmap="viridis", vmin=0.0, vmax=top, interpolation="none"
        )
        axes.set(title=title, xlabel=f"{grid.kind} range (m)", ylabel="azimuth (m)")
        axes.locator_params(axis="x", nbins=5)
        axes.ticklabel_format(useOffset=False, style="plain")
        figure.colorbar(shown, ax=axes, shrink=0.8)
    if per_building:
        mesh, got, count = np.array(list(per_building.values())).T
        panels[2].scatter(mesh, got, s=4.0 + count, alpha=0.6)
        line = [0.0, 1.1 * float(max(mesh.max(), got.max()))]
        panels[2].plot(line, line, color="0.4", lw=0.8)
        panels[2].set_aspect("equal")
    by = record["buildings"]
    panels[2].set(
        xlabel="mesh (m)",
        ylabel="found (m)",
    )
    panels[2].set_title(
        f"{by['count']} buildings: median error {by['median_m']:.2f} m, spread {by['spread_m']:.2f} m",
        fontsize=10,
    )
    b = record["baseline"]
    figure.suptitle(
        f"Munich, {record['radar']}: perpendicular baseline {b['perpendicular_m']:.4g} m, height of ambiguity "
        f"{b['height_of_ambiguity_m']:.4g} m, {record['independent_looks']:.0f} looks",
        fontsize=10,
    )
    figure.savefig(path)


def render(out: Path, radar: str, definitions: dict[str, str], ambiguity: float, more: list[str]) -> None:
    """Both passes with the baseline of a height of ambiguity."""
    from sarmitsuba import cli

    scene = load(radar, definitions)
    line = scene.radar.aim_point - scene.radar.track.center_position
    distance = float(np.linalg.norm(line))
    line -= (line @ scene.radar.track.along) * scene.radar.track.along
    sine = float(np.hypot(line[0], line[1]) / np.linalg.norm(line))
    baseline = scene.radar.waveform.wavelength * distance * sine / (2.0 * ambiguity)
    defined = [text for name, value in definitions.items() for text in ("-D", f"{name}={value}")]
    options = ["--radar", radar, *defined, "-o", str(out), "--baseline", repr(baseline), *more]
    status = cli.main(["insar", str(harness.munich()), *options])
    if status:
        sys.exit(status)


def main() -> None:
    """Render, evaluate, print."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--radar", default="airborne_x", help="a shipped radar or an XML file")
    parser.add_argument("-o", "--output", required=True, help="folder for runs, figures and picture")
    parser.add_argument("--ambiguity", type=float, default=80.0, help="height of ambiguity, m (default: 80)")
    parser.add_argument("--lowest", type=float, default=-8.0, help="lowest height, m (default: -8)")
    parser.add_argument(
        "-D", "--define", action="append", default=[], help="parameter of radar or scene, as in `render`"
    )
    parser.add_argument("--only-evaluate", action="store_true", help="take the runs that are there")
    args, more = parser.parse_known_args()
    out = Path(args.output)
    fixed = {"aim_x": "0", "aim_y": "0", "aim_z": "0"}
    definitions = fixed | dict(text.split("=", 1) for text in args.define)
    if not args.only_evaluate:
        render(out, args.radar, definitions, args.ambiguity, more)
    record = evaluate(out, args.radar, definitions, args.lowest)
    for what in ("blocks", "buildings"):
        s = record[what]
        print(f"{what}: median error {s['median_m']:.2f} m, spread {s['spread_m']:.2f} m over {s['count']}")
    for what, s in record["by_coherence"].items():
        print(
            f"coherence {what}: median error {s['median_m']:.2f} m, spread {s['spread_m']:.2f} m over {s['count']}"
        )
    print(
        f"phase noise alone: {record['height_sigma_m']:.2f} m a block of {record['independent_looks']:.0f} looks"
    )
    print(f"CPU {sum(os.times()[:2]):.0f} s")
    print(out / "munich_heights.png")


if __name__ == "__main__":
    main()
