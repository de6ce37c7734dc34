"""Forty small runs by two trees, bit by bit: a change of structure changes no result and no kernel.

``make golden BASE=<commit>`` records the tree of that commit and this one, and compares them: the SHA-256 of every data
set and the hashes of the Dr.Jit kernels, single-threaded. ``python benchmarks/studies/golden.py record --tree DIR -o
FILE`` records one tree, ``compare BEFORE AFTER`` compares two records. It fails where a data set differs, unless
``--allow NAME`` names the run; kernels of another hash are listed.

Notes
-----
Bits are those of one type of machine: LLVM compiles for the vector width of the processor, NumPy's sums depend on its
own. Records of different machines are not compared.
"""

import argparse
import contextlib
import hashlib
import io
import json
import os
import subprocess
import sys
import tempfile
import time
import warnings
from collections.abc import Callable, Iterator
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]
QUAD_POL = ("-D", "sar_antenna.polarisation=HH,HV,VH,VV", "-D", "sar_path.keep_orders=true")
STRIPMAP = (
    *("-D", "sar_antenna.mode=stripmap", "-D", "sar_antenna.pattern=gaussian"),
    *("-D", "sar_antenna.azimuth_beamwidth_deg=1.5", "-D", "sar_antenna.elevation_beamwidth_deg=5"),
)
# scene, then further arguments of ``render``
RENDERS: dict[str, tuple[str, ...]] = {
    # every kind of content, by the automatic method
    "point": ("point",),
    "sphere": ("sphere", "-D", "sar_path.ray_spacing=0.05"),
    "plate": ("plate",),
    "dihedral_quad_pol": ("dihedral", *QUAD_POL),
    "trihedral": ("trihedral",),
    "flat_ground": ("flat_ground",),
    "edges": ("plate_edges",),
    "wires": ("railing",),
    "crowns": ("street_trees",),
    "pairs": ("courtyard",),
    "panes": ("glass_house",),
    "water": ("harbour",),
    "movers": ("moving_cars",),
    "bitmap": ("land_cover",),
    "town": ("urban_block",),
    # every method
    "tower_raw": ("tower", "--method", "raw", "-D", "sar_path.ray_spacing=1.0"),
    "tower_hybrid": ("tower", "--method", "hybrid", "-D", "sar_path.keep_orders=true"),
    "tower_image": ("tower", "--method", "image", *QUAD_POL),
    "tower_raster": ("tower", "--method", "raster"),
    "tower_one_set": ("tower", "--no-error-bars"),
    "tower_passes": ("tower", "--target-error", "-60", "--time-limit", "0.001"),
    # every focuser
    **{
        f"focus_{name.partition(',')[0]}": ("dihedral", "--focuser", name)
        for name in (
            "backprojection,interpolation=kernel:8",
            "factorised",
            "omega_k",
            "range_doppler",
            "chirp_scaling",
            "polar_format",
        )
    },
    # modes, platforms, receivers, noise, waveforms, windows
    "stripmap": ("tower", *STRIPMAP),
    "orbit": ("point", "--radar", "terrasar_spotlight"),
    "bistatic": ("tower", "-D", "sar_antenna.receiver_offset_along=300"),
    "chirped_noise": ("point", "--raw", "chirped", "-D", "sar_antenna.noise_temperature=300"),
    "autofocus": ("point", "--autofocus", "phase_gradient", "--window", "hamming"),
    "labels": ("tower", "--labels"),
    "cluster": ("tower", "--cluster", "local:1"),
}
COMMON = ("--seed", "3", "--pixels", "24x24", "--no-chart", "--format", "hdf5", "--force")


def run_command(*arguments: str) -> None:
    """Run a command of the program in this process; raise with its output where it fails."""
    from sarmitsuba.cli import main

    text = io.StringIO()
    with contextlib.redirect_stderr(text), contextlib.redirect_stdout(text):
        status = main(list(arguments))
    if status:
        raise RuntimeError(text.getvalue().strip())


def arrays_of(folder: Path) -> Iterator[tuple[str, bytes]]:
    """Data sets of all HDF5 files of a folder, and lines of its tables."""
    import h5py
    import numpy as np

    for path in sorted(folder.rglob("*.h5")):
        found: list[tuple[str, bytes]] = []
        with h5py.File(path) as file:

            def keep(name: str, item: object, found: list[tuple[str, bytes]] = found) -> None:
                if isinstance(item, h5py.Dataset) and item.dtype.kind in "biufc":
                    found.append((name, np.ascontiguousarray(item[()]).tobytes()))

            file.visititems(keep)
        yield from ((f"{path.relative_to(folder)}/{name}", data) for name, data in found)
    for path in sorted(folder.rglob("*.csv")):
        yield str(path.relative_to(folder)), path.read_bytes()


def render(*arguments: str) -> Callable[[Path], Iterator[tuple[str, bytes]]]:
    """Case of ``render``."""

    def case(folder: Path) -> Iterator[tuple[str, bytes]]:
        run_command("render", *arguments, *COMMON, "-o", str(folder))
        yield from arrays_of(folder)

    return case


def rcs(folder: Path) -> Iterator[tuple[str, bytes]]:
    """Sweep of a corner."""
    run_command("rcs", "dihedral", "--azimuth=-10:10:5", "-o", str(folder), "--force")
    yield from arrays_of(folder)


def dataset(folder: Path) -> Iterator[tuple[str, bytes]]:
    """One sample of a shipped recipe."""
    run_command("dataset", "vehicles_and_boats", "--sample", "0", "--jobs", "1", "-o", str(folder), "--force")
    yield from arrays_of(folder)


def derivatives(folder: Path) -> Iterator[tuple[str, bytes]]:
    """Derivatives of the echoes of a small tower by a level, and the gradient of their energy by it."""
    import numpy as np

    import sarmitsuba

    size = {"range_film.pixels_azimuth": "24", "range_film.pixels_range": "24"}
    scene = sarmitsuba.load_scene(
        "tower", parameters={**size, "sar_path.ray_spacing": "1.0", "sar_path.diffuse_pairs": "off"}
    )
    found = sarmitsuba.jacobian(scene, "level:soil,shift:walls:x")
    yield "jacobian", np.ascontiguousarray(found.derivative).tobytes()
    loss = sarmitsuba.SquaredDifference(0.9 * found.raw.data)
    slope = sarmitsuba.gradient(scene, "level:soil", loss).gradient
    # the last bits of a gradient depend on the order in which threads end
    yield "gradient", np.array2string(slope, precision=6).encode()


def cases() -> dict[str, Callable[[Path], Iterator[tuple[str, bytes]]]]:
    """All runs by name."""
    return {
        **{name: render(*arguments) for name, arguments in RENDERS.items()},
        "rcs": rcs,
        "dataset": dataset,
        "derivatives": derivatives,
    }


def record(output: Path, only: list[str]) -> None:
    """Run the cases with the package that this interpreter imports."""
    os.sched_setaffinity(0, {min(os.sched_getaffinity(0))})
    from sarmitsuba.machine.backend import ensure_backend

    ensure_backend()
    import drjit as dr

    warnings.simplefilter("ignore")
    dr.set_flag(dr.JitFlag.KernelHistory, True)
    found: dict[str, dict[str, object]] = {}
    for name, case in cases().items():
        if only and not any(part in name for part in only):
            continue
        dr.kernel_history_clear()
        start = time.perf_counter()
        entry: dict[str, object] = {}
        try:
            with tempfile.TemporaryDirectory() as folder:
                entry["data"] = {key: hashlib.sha256(data).hexdigest() for key, data in case(Path(folder))}
        except (Exception, SystemExit) as error:  # of one case; the others are still worth recording
            entry["failed"] = f"{type(error).__name__}: {error}"
        entry["kernels"] = sorted({f"{e['hash']}" for e in dr.kernel_history() if "hash" in e})
        found[name] = entry
        print(f"{name}: {entry.get('failed', '')} {time.perf_counter() - start:.1f} s", flush=True)
    output.write_text(json.dumps(found, indent=1), encoding="utf-8")


def compare(before: Path, after: Path, allowed: list[str]) -> int:
    """Print what differs; return 1 where a data set that is not allowed to does."""
    old, new = (json.loads(path.read_text(encoding="utf-8")) for path in (before, after))
    wrong = same = 0
    for name in old | new:
        one, two = old.get(name, {}), new.get(name, {})
        if "failed" in two and "failed" not in one:
            print(f"{name}: fails now: {two['failed']}")
            wrong += 1
            continue
        if "failed" in one:
            print(f"{name}: failed before{'' if 'failed' in two else ', runs now'}: {one['failed']}")
            wrong += "failed" in two and name not in allowed
            continue
        differ = [
            key
            for key in one.get("data", {}) | two.get("data", {})
            if one.get("data", {}).get(key) != two.get("data", {}).get(key)
        ]
        same += len(two.get("data", {})) - len(differ)
        if differ:
            print(f"{name}: other bits in {', '.join(differ)}{' (allowed)' * (name in allowed)}")
            wrong += name not in allowed
        if one.get("kernels") != two.get("kernels"):
            lost, made = (set(a["kernels"]) - set(b["kernels"]) for a, b in ((one, two), (two, one)))
            print(
                f"{name}: kernels {len(lost)} gone, {len(made)} new, {len(set(two['kernels']) - made)} the same"
            )
    print(f"{len(new)} runs, {same} data sets with the same bits, {wrong} runs differ")
    return int(wrong > 0 or same == 0)


def record_tree(tree: Path, output: Path, only: list[str]) -> None:
    """Record a tree in a process of its own, by its own cases where it has them: modules may have moved."""
    environment = {**os.environ, "PYTHONPATH": str(tree), "OPENBLAS_NUM_THREADS": "1", "PYTHONHASHSEED": "0"}
    own = tree / Path(__file__).resolve().relative_to(ROOT)
    script = own if own.is_file() else Path(__file__).resolve()
    command = [sys.executable, str(script), "record", "-o", str(output), *only]
    subprocess.run(command, env=environment, cwd=tree, check=True)


def against(base: str, only: list[str], allowed: list[str]) -> int:
    """Record a commit and this tree, and compare them."""
    with tempfile.TemporaryDirectory() as folder:
        tree = Path(folder) / "base"
        subprocess.run(
            ["git", "-C", str(ROOT), "worktree", "add", "-q", "--detach", str(tree), base], check=True
        )
        try:
            record_tree(tree, Path(folder) / "before.json", only)
            record_tree(ROOT, Path(folder) / "after.json", only)
        finally:
            subprocess.run(["git", "-C", str(ROOT), "worktree", "remove", "--force", str(tree)], check=False)
        return compare(Path(folder) / "before.json", Path(folder) / "after.json", allowed)


def main() -> int:
    """Command line."""
    parser = argparse.ArgumentParser(description=__doc__)
    verbs = parser.add_subparsers(dest="verb", required=True)
    one = verbs.add_parser("record")
    one.add_argument("-o", "--output", type=Path, required=True)
    one.add_argument("only", nargs="*")
    two = verbs.add_parser("compare")
    two.add_argument("before", type=Path)
    two.add_argument("after", type=Path)
    three = verbs.add_parser("against")
    three.add_argument("base")
    three.add_argument("only", nargs="*")
    for verb in (two, three):
        verb.add_argument("--allow", nargs="*", default=[], metavar="NAME", help="runs whose bits may differ")
    args = parser.parse_args()
    if args.verb == "record":
        record(args.output, args.only)
        return 0
    if args.verb == "compare":
        return compare(args.before, args.after, args.allow)
    return against(args.base, args.only, args.allow)


if __name__ == "__main__":
    sys.exit(main())
