"""Raw data and images of every shipped scene, recorded and compared: a change of structure changes no result.

``python benchmarks/studies/golden.py record DIR`` renders; ``python benchmarks/studies/golden.py compare BEFORE
AFTER`` prints the largest difference of every file in dB of its peak and fails above -100 dB.
"""

import argparse
import contextlib
import io
import sys
from pathlib import Path

# -100 dB of the peak: float64 sums in another order, stored as complex64 (2^-24 is -144 dB), and nothing else
LIMIT_DB = -100.0
METHODS = ("raw", "hybrid", "image", "raster")
QUAD_POL = ("-D", "sar_antenna.polarisation=HH,HV,VH,VV", "-D", "sar_path.keep_orders=true", "--seed", "3")
# every pulse of these scenes traced with automatic rays takes many minutes; wider rays take the same way
WIDE_RAYS = {
    "bridge": 1.0,
    "buildings16": 2.0,
    "flat_ground": 1.0,
    "tower": 0.5,
    "urban_block": 1.0,
    "sphere": 0.05,
}
NO_MESH = ("point",)


def cases() -> dict[str, list[str]]:
    from sarmitsuba.loader.library import list_scenes

    out: dict[str, list[str]] = {}
    for entry in list_scenes():
        for method in METHODS:
            if entry.name in NO_MESH and method == "raster":
                continue
            wide = WIDE_RAYS.get(entry.name) if method == "raw" else None
            more = ["-D", f"sar_path.ray_spacing={wide}"] if wide else []
            out[f"{entry.name}_{method}"] = [entry.name, "--method", method, *QUAD_POL, *more]
    out["flat_ground_single_set"] = ["flat_ground", "--no-error-bars", "--seed", "3"]
    out["urban_block_look"] = [
        "urban_block",
        "-D",
        "heading_deg=33",
        "-D",
        "look_angle_deg=38.5",
        "--seed",
        "5",
    ]
    out["point_noise_chirped"] = [
        *("point", "--raw", "chirped", "--seed", "3", "--window", "taylor"),
        *("-D", "sar_antenna.noise_temperature=300"),
    ]
    out["dihedral_omega_k"] = ["dihedral", "--focuser", "omega_k", "--seed", "3"]
    out["tower_stripmap"] = [
        *("tower", "--seed", "3", "-D", "sar_antenna.mode=stripmap", "-D", "sar_antenna.pattern=gaussian"),
        *("-D", "sar_antenna.azimuth_beamwidth_deg=1.5", "-D", "sar_antenna.elevation_beamwidth_deg=5"),
    ]
    return out


def record(folder: Path, only: list[str]) -> None:
    import time

    from sarmitsuba.cli import main

    for name, arguments in cases().items():
        if only and not any(o in name for o in only):
            continue
        start = time.perf_counter()
        text = io.StringIO()
        with contextlib.redirect_stderr(text), contextlib.redirect_stdout(text):
            status = main(["render", *arguments, "-o", str(folder / name), "--force"])
        print(f"{name}: status {status}, {time.perf_counter() - start:.1f} s", flush=True)
        if status:
            print(text.getvalue())


def compare(before: Path, after: Path) -> int:
    import h5py
    import numpy as np

    worst = -400.0
    for path in sorted(before.glob("*/*.h5")):
        other = after / path.relative_to(before)
        if not other.exists():
            print(f"{path.relative_to(before)}: missing")
            worst = 0.0
            continue
        with h5py.File(path) as a, h5py.File(other) as b:
            x, y = (np.stack([file[name][()] for name in file["layers"].asstr()]) for file in (a, b))
        if x.shape != y.shape:
            print(f"{path.relative_to(before)}: shape {x.shape} is now {y.shape}")
            worst = 0.0
            continue
        peak = float(np.abs(x).max())
        rms = float(np.sqrt(np.mean(np.abs(x) ** 2)))
        change = float(np.abs(y - x).max())
        mean_change = float(np.sqrt(np.mean(np.abs(y - x) ** 2)))
        db = 20.0 * np.log10(max(change / peak, 1e-20))
        mean_db = 20.0 * np.log10(max(mean_change / rms, 1e-20))
        worst = max(worst, db)
        print(f"{path.relative_to(before)}: largest {db:.1f} dB of the peak, rms {mean_db:.1f} dB of the rms")
    print(f"worst: {worst:.1f} dB")
    return int(worst > LIMIT_DB)


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__)
    verbs = parser.add_subparsers(dest="verb", required=True)
    one = verbs.add_parser("record")
    one.add_argument("folder", type=Path)
    one.add_argument("only", nargs="*")
    two = verbs.add_parser("compare")
    two.add_argument("before", type=Path)
    two.add_argument("after", type=Path)
    args = parser.parse_args()
    if args.verb == "record":
        record(args.folder, args.only)
        return 0
    return compare(args.before, args.after)


if __name__ == "__main__":
    sys.exit(main())
