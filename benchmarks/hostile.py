"""Damaged and hostile files, drawn by seed: each is read, or refused in one short line; no traceback, hang or abort.

    python benchmarks/hostile.py -o out/hostile                        # every kind, 2000 files each
    python benchmarks/hostile.py --kinds hdf5-raw,scene --count 10000

Every file is read in a worker process that may take 20 CPU seconds and 1.5 GB for it; a worker that dies is replaced,
and the file that it died of is kept in the output folder.
"""

import argparse
import json
import multiprocessing
import multiprocessing.connection
import random
import resource
import shutil
import signal
import sys
import warnings
from collections import Counter
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

CPU_LIMIT = 20  # s for one file; the undamaged ones take milliseconds
GROWTH = 1.5e9  # bytes that one file may take; the undamaged ones take a few hundred kB
LONGEST = 1000  # characters of a message

SCENE = """<scene version="3.0.0">
<default name="look" value="40"/>
<integrator type="sar_path"><integer name="max_depth" value="2"/></integrator>
<sensor type="sar_antenna" id="radar"><float name="slant_range" value="1000"/><integer name="n_pulses" value="8"/>
  <float name="look_angle_deg" value="$look"/><string name="polarisation" value="HH,VV"/>
  <film type="range_film"><float name="image_extent_range" value="8"/></film></sensor>
<bsdf type="radar_material" id="m"><string name="material" value="concrete"/>
  <float name="rms_height" value="0.001"/></bsdf>
<shape type="cube" id="c"><transform name="to_world"><scale x="2" y="3" z="1"/></transform><ref id="m"/></shape>
<shape type="ply"><string name="filename" value="mesh.ply"/><ref id="m"/></shape>
<shape type="sphere"><point name="center" x="0" y="0" z="2"/><bsdf type="point_scatterer">
  <float name="rcs_dbsm" value="10"/></bsdf></shape>
</scene>"""
BOMB = "".join(f'<!ENTITY e{i} "{f"&e{i - 1};" * 10 if i else "haha" * 10}">' for i in range(12))
TOKENS = (
    *(
        "0",
        "-1",
        "1e400",
        "nan",
        "inf",
        "-inf",
        "1e-320",
        "",
        "abc",
        "$n",
        "1" * 30,
        "9" * 400,
        "1,2,3",
        "-0",
        "1e308",
    ),
    *(
        "x" * 5000,
        "../" * 2000 + "x",
        "/dev/zero",
        "/dev/stdin",
        "/etc/passwd",
        "é",
        "\x00",
        "\n",
        "&e11;",
        "&x;",
        "]]>",
    ),
    *(
        "<",
        "&",
        "'",
        '"',
        "<!--",
        "4294967296",
        "2147483648",
        "18446744073709551615",
        "1e18",
        "true",
        "%s",
        "{}",
    ),
)
INSERTIONS = (
    f"<!DOCTYPE a [{BOMB}]>",
    '<!DOCTYPE a [<!ENTITY x SYSTEM "file:///etc/passwd">]>',
    '<!DOCTYPE a SYSTEM "file:///etc/passwd">',
    '<include filename="/dev/zero"/>',
    '<include filename="../../etc/passwd"/>',
    '<shape type="ply"><string name="filename" value="/dev/zero"/></shape>',
    f"<{'y' * 5000}/>",
)


def mutate_text(rng: random.Random, data: bytes) -> bytes:
    """One to six changes: values, lines, characters, cuts and insertions."""
    text = data.decode("utf-8", "surrogateescape")
    for _ in range(rng.choice((1, 1, 1, 2, 3, 6))):
        kind = rng.choice(
            ("value", "value", "value", "insert", "line", "lines", "character", "cut", "end", "start")
        )
        at = rng.randrange(len(text) + 1)
        if kind == "value":
            end = at
            while at > 0 and text[at - 1] not in '\n\t",;<> ':
                at -= 1
            while end < len(text) and text[end] not in '\n\t",;<> ':
                end += 1
            text = text[:at] + rng.choice(TOKENS) + text[end:]
        elif kind == "insert":
            text = text[:at] + rng.choice((*TOKENS, *INSERTIONS)) + text[at:]
        elif kind == "start":
            text = rng.choice(INSERTIONS) + text
        elif kind == "character":
            text = text[:at] + chr(rng.randrange(1, 256)) + text[at + 1 :]
        elif kind == "cut":
            text = text[:at] + text[at + rng.choice((1, 3, 10, 60)) :]
        elif kind == "end":
            text = text[:at]
        else:
            lines = text.split("\n")
            i = rng.randrange(len(lines))
            if kind == "lines":
                lines[i:i] = [lines[i]] * rng.choice((1, 3, 1000))
            else:
                del lines[i]
            text = "\n".join(lines)
    return text.encode("utf-8", "surrogateescape")


def mutate_bytes(rng: random.Random, data: bytes) -> bytes:
    """One to eight changes: bytes, numbers of 2, 4 and 8 bytes, runs, cuts, and text where there is some."""
    found = bytearray(data)
    for _ in range(rng.choice((1, 1, 2, 3, 8))):
        if not found:
            break
        # heads hold the structure, and most of a file are samples
        at = rng.randrange(len(found)) if rng.random() < 0.4 else rng.randrange(min(len(found), 4000))
        kind = rng.choice(
            ("byte", "byte", "bit", "number", "number", "run", "cut", "grow", "end", "copy", "text")
        )
        if kind == "byte":
            found[at] = rng.randrange(256)
        elif kind == "bit":
            found[at] ^= 1 << rng.randrange(8)
        elif kind == "number":
            size = rng.choice((2, 4, 8))
            value = rng.choice((0, 1, 2**31 - 1, 2**31, 2**32 - 1, 2**62, 2**63, 2**64 - 1, 1000, 65535))
            number = (value % 256**size).to_bytes(size, rng.choice(("little", "big")))
            found[at : at + size] = number
        elif kind == "run":
            size = rng.randrange(1, 64)
            found[at : at + size] = bytes([rng.choice((0, 255))]) * size
        elif kind == "cut":
            del found[at : at + rng.choice((1, 8, 100))]
        elif kind == "grow":
            found[at:at] = rng.randbytes(rng.choice((1, 8, 100)))
        elif kind == "end":
            del found[at:]
        elif kind == "copy":
            other = rng.randrange(len(found))
            found[at : at + 32] = found[other : other + 32]
        else:
            found = bytearray(mutate_text(rng, bytes(found)))
    return bytes(found)


@dataclass(frozen=True)
class Kind:
    """One kind of file.

    Parameters
    ----------
    file : name of the undamaged one among the samples
    mutate : makes another of its bytes
    read : reads a file, as the program would
    """

    file: str
    mutate: Callable[[random.Random, bytes], bytes]
    read: Callable[[Path], object]


def _scene(path: Path) -> object:
    from sarmitsuba.loader.load import load_scene

    return load_scene(path)


def _render(path: Path) -> object:
    """What the command line does; its errors are its own lines and the exit status 2."""
    from sarmitsuba import cli

    status = cli.main(["render", str(path), "--quiet", "--force", "-o", str(path.parent / "out")])
    if status not in (0, 2):
        raise AssertionError(f"exit status {status}")
    return status


def _raw(path: Path) -> object:
    from sarmitsuba.io import read_raw

    return read_raw(path)


def _image(path: Path) -> object:
    from sarmitsuba.io import read_image

    return read_image(path)


def _mesh(path: Path) -> object:
    from sarmitsuba.loader.mesh_files import read_mesh, read_parts

    read = read_parts if path.suffix == ".glb" else read_mesh
    return read(path, path.name)


def _track(path: Path) -> object:
    from sarmitsuba.radar.track import Track

    return Track.from_csv(path)


def _vectors(path: Path) -> object:
    from sarmitsuba.radar.ephemeris import StateVectors

    return StateVectors.read(path)


def _pattern(path: Path) -> object:
    from sarmitsuba.loader.load import load_scene

    table = {"sar_antenna.pattern": "table", "sar_antenna.pattern_file": str(path)}
    return load_scene("point", parameters=table)


def _passes(path: Path) -> object:
    from sarmitsuba.simulation.refinement.passes import Passes

    return Passes.load(path, "made here")


KINDS = {
    "scene": Kind("scene.xml", mutate_text, _scene),
    "render": Kind("scene.xml", mutate_text, _render),
    "hdf5-raw": Kind("raw.h5", mutate_bytes, _raw),
    "hdf5-image": Kind("image.h5", mutate_bytes, _image),
    "cphd": Kind("raw.cphd", mutate_bytes, _raw),
    "sicd": Kind("image.nitf", mutate_bytes, _image),
    "matlab": Kind("raw.mat", mutate_bytes, _raw),
    "passes": Kind("passes.npz", mutate_bytes, _passes),
    "ply": Kind("mesh.ply", mutate_bytes, _mesh),
    "ply-text": Kind("text.ply", mutate_text, _mesh),
    "stl": Kind("mesh.stl", mutate_bytes, _mesh),
    "obj": Kind("mesh.obj", mutate_text, _mesh),
    "glb": Kind("mesh.glb", mutate_bytes, _mesh),
    "track": Kind("track.csv", mutate_text, _track),
    "vectors": Kind("vectors.csv", mutate_text, _vectors),
    "orbit-file": Kind("vectors.EOF", mutate_text, _vectors),
    "pattern": Kind("pattern.csv", mutate_text, _pattern),
}


def make_samples(folder: Path) -> None:
    """Write one undamaged file of every kind."""
    import scipy.io
    import trimesh

    from sarmitsuba.focusing import focus
    from sarmitsuba.io import write_image, write_raw
    from sarmitsuba.loader.load import load_scene
    from sarmitsuba.simulation.raw import simulate
    from sarmitsuba.simulation.refinement.passes import Passes

    folder.mkdir(parents=True, exist_ok=True)
    box = trimesh.creation.box()
    for name in ("mesh.ply", "mesh.stl", "mesh.obj", "mesh.glb"):
        box.export(folder / name)
    box.export(folder / "text.ply", encoding="ascii")
    (folder / "scene.xml").write_text(SCENE, encoding="utf-8")
    small = {"range_film.image_extent_azimuth": "4", "range_film.image_extent_range": "4"}
    raw = simulate(load_scene("point", parameters=small | {"slant_range": "1000", "azimuth_resolution": "2"}))
    image = focus(raw)
    for name in ("raw.h5", "raw.cphd"):
        write_raw(raw, folder / name)
    for name in ("image.h5", "image.nitf"):
        write_image(image, folder / name)
    angle = np.linspace(0.0, 0.05, 24)
    place = 7000.0 * np.stack([np.cos(angle), np.sin(angle), np.ones(24)])
    frequency = 9.6e9 + 1e6 * np.arange(32.0)
    data = {
        "fp": np.ones((32, 24), np.complex64),
        "freq": frequency[:, None],
        "r0": np.linalg.norm(place, axis=0),
    }
    data |= dict(zip("xyz", place[:, None], strict=True))
    scipy.io.savemat(folder / "raw.mat", {"data": data})
    passes = Passes("made here", 1, 1.0, raw.data)
    passes.save(folder / "passes.npz")
    track = [f"{i * 0.01},{i * 1.0},-5000,4000" for i in range(24)]
    (folder / "track.csv").write_text("time_s,x_m,y_m,z_m\n" + "\n".join(track), encoding="utf-8")
    a, rate = 7.0e6, 1.0e-3
    rows, items = [], []
    for t in np.arange(0.0, 80.0, 10.0):
        c, s = np.cos(rate * t), np.sin(rate * t)
        row = (a * c, 0.0, a * s, -a * rate * s, 0.0, a * rate * c)
        rows.append(",".join(f"{v:.6f}" for v in (t, *row)))
        tags = zip(("X", "Y", "Z", "VX", "VY", "VZ"), row, strict=True)
        numbers = "".join(f"<{tag}>{value:.6f}</{tag}>" for tag, value in tags)
        items.append(f"<OSV><UTC>UTC=2020-01-01T00:00:{int(t) % 60:02d}.0</UTC>{numbers}</OSV>\n")
    (folder / "vectors.csv").write_text("\n".join(rows), encoding="utf-8")
    whole = f"<Earth_Explorer_File>\n<Ref_Frame>EARTH_FIXED</Ref_Frame>\n{''.join(items[:6])}</Earth_Explorer_File>"
    (folder / "vectors.EOF").write_text(whole, encoding="utf-8")
    cut = [f"{axis},{angle},{-0.1 * angle**2}" for axis in ("azimuth", "elevation") for angle in range(-8, 9)]
    (folder / "pattern.csv").write_text("cut,angle_deg,gain_db\n" + "\n".join(cut), encoding="utf-8")


def read_one(kind: Kind, path: Path) -> tuple[str, str]:
    """Outcome of reading a file, and what was said."""
    from sarmitsuba.errors import SarmitsubaError

    before = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            kind.read(path)
        outcome, text = "read", ""
    except SarmitsubaError as error:
        text = str(error)
        outcome = "refused" if "\n" not in text and 10 < len(text) <= LONGEST else "message"
    except Exception as error:  # what this looks for
        outcome, text = "traceback", f"{type(error).__name__}: {error}"
    if (resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - before) * 1024 > GROWTH:
        outcome = "memory"
    return outcome, text[:2000]


def work(
    name: str, samples: Path, folder: Path, seeds: range, pipe: "multiprocessing.connection.Connection"
) -> None:
    """Read the files of the seeds, one after the other, and tell of each."""
    kind = KINDS[name]
    whole = (samples / kind.file).read_bytes()
    for path in samples.iterdir():
        if path.suffix == ".ply":
            shutil.copy(path, folder)
    path = folder / f"drawn{Path(kind.file).suffix}"
    for seed in seeds:
        path.write_bytes(kind.mutate(random.Random(seed), whole))
        used = resource.getrusage(resource.RUSAGE_SELF)
        limit = int(used.ru_utime + used.ru_stime) + CPU_LIMIT
        resource.setrlimit(resource.RLIMIT_CPU, (limit, resource.RLIM_INFINITY))
        pipe.send((seed, *read_one(kind, path)))
    pipe.close()


def attack(name: str, samples: Path, folder: Path, seeds: range) -> tuple[Counter[str], list[dict[str, Any]]]:
    """Counts of outcomes over drawn files of a kind, and what went wrong."""
    found: Counter[str] = Counter()
    wrong: list[dict[str, Any]] = []
    context = multiprocessing.get_context("spawn")
    scratch = folder / f"scratch_{name}"
    start = seeds.start
    while start < seeds.stop:
        scratch.mkdir(parents=True, exist_ok=True)
        here, there = context.Pipe(duplex=False)
        rest = range(start, seeds.stop)
        worker = context.Process(target=work, args=(name, samples, scratch, rest, there))
        worker.start()
        there.close()
        try:
            while True:
                seed, outcome, text = here.recv()
                found[outcome] += 1
                start = seed + 1
                if outcome not in ("read", "refused"):
                    wrong.append({"kind": name, "seed": seed, "outcome": outcome, "text": text})
        except EOFError:
            pass
        worker.join()
        if start < seeds.stop:
            code = worker.exitcode or 0
            outcome = "hang" if -code == signal.SIGXCPU else "abort"
            found[outcome] += 1
            kept = folder / f"{name}_{start}{Path(KINDS[name].file).suffix}"
            shutil.copy(scratch / f"drawn{kept.suffix}", kept)
            wrong.append({"kind": name, "seed": start, "outcome": outcome, "text": f"exit {code}: {kept}"})
            start += 1
    shutil.rmtree(scratch, ignore_errors=True)
    return found, wrong


def main() -> int:
    """Draw, read, count."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--kinds", default=",".join(KINDS), help="comma separated")
    parser.add_argument("--count", type=int, default=2000)
    parser.add_argument("--first", type=int, default=0, help="first seed")
    parser.add_argument("-o", "--out", type=Path, default=Path("out/hostile"))
    args = parser.parse_args()
    make_samples(args.out / "samples")
    columns = ("read", "refused", "message", "memory", "traceback", "hang", "abort")
    print("| kind | " + " | ".join(columns) + " |\n" + "|---" * (len(columns) + 1) + "|", flush=True)
    record: dict[str, Any] = {"first": args.first, "count": args.count, "found": {}, "wrong": []}
    for name in args.kinds.split(","):
        found, wrong = attack(
            name, args.out / "samples", args.out, range(args.first, args.first + args.count)
        )
        print(f"| {name} | " + " | ".join(str(found[c]) for c in columns) + " |", flush=True)
        record["found"][name] = dict(found)
        record["wrong"] += wrong
        (args.out / "hostile.json").write_text(json.dumps(record, indent=1), encoding="utf-8")
    for each in record["wrong"][:20]:
        print(f"{each['kind']} {each['seed']}: {each['outcome']}: {each['text'][:300]}")
    return 1 if record["wrong"] else 0


if __name__ == "__main__":
    sys.exit(main())
