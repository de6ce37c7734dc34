"""Damaged and hostile files, drawn by seed: each is read, or refused in one short line, and nothing else happens.

    python -m benchmarks.studies.hostile -o out/hostile                # every kind, 400 files each
    python -m benchmarks.studies.hostile --kinds hdf5-raw,scene --count 10000
    python -m benchmarks.studies.hostile --strace --count 30           # watched from outside, by the system's calls

Some kinds damage bytes and text anywhere; the others keep a file's outer form and change what it says (a tag of a
raster, an attribute of a map, a field of a record), so that most of them pass a reader's first check.

Every file is read in a worker process that may take 20 CPU seconds, a minute without any and 1.5 GB for it; a worker
that dies is replaced, and the file that it died of is kept in the output folder. An audit hook in it takes down every
file that is opened, every name that is removed or renamed outside the folder of the case, and every connection and
program.
``--strace`` sees what libraries open past Python.
"""

import argparse
import json
import multiprocessing
import multiprocessing.connection
import os
import random
import re
import resource
import shutil
import signal
import subprocess
import sys
import time
import warnings
from collections import Counter
from collections.abc import Callable
from pathlib import Path
from typing import Any

from benchmarks.support.hostile_files import BOMB, make_samples
from benchmarks.support.hostile_kinds import KINDS, REFUSED, Kind

CPU_LIMIT = 20  # s for one file; the undamaged ones take milliseconds
LONGEST_WAIT = 60  # s on the clock in which a worker and its processes use none: it waits for ever
GROWTH = 1.5e9  # bytes that one file may take; the undamaged ones take a few hundred kB
LONGEST = 1000  # characters of a message
COLUMNS = ("read", "refused", "message", "memory", "traceback", "outside", "connection", "hang", "abort")


class Watch:
    """What this process opens, removes, connects to and starts, by Python's audit hook; on for one case at a time."""

    _OPENED = (
        "open",
        "os.remove",
        "os.rename",
        "os.rmdir",
        "shutil.rmtree",
        "os.truncate",
    )
    _STARTED = (
        "subprocess.Popen",
        "os.system",
        "os.exec",
        "os.posix_spawn",
        "os.startfile",
        "webbrowser.open",
    )
    _CONNECTED = ("socket.connect", "socket.bind", "socket.getaddrinfo", "socket.sendto", "urllib.Request")

    def __init__(self, folder: Path) -> None:
        self.allowed = allowed(folder)
        self.on = False
        self.found: list[str] = []
        self.kind = ""
        sys.addaudithook(self._hear)

    def _hear(self, event: str, args: tuple[Any, ...]) -> None:
        if not self.on:
            return
        if event in self._CONNECTED or event in self._STARTED:
            self.kind = "connection"
            self.found.append(f"{event} {str(args)[:200]}")
        elif event in self._OPENED:
            for place in self._places(event, args):
                if not place.startswith(self.allowed):
                    self.kind = self.kind or "outside"
                    self.found.append(f"{event} {place[:200]}")

    @staticmethod
    def _places(event: str, args: tuple[Any, ...]) -> list[str]:
        """Whole paths that an event names; those of a folder's descriptor lie in it."""
        count = 2 if event == "os.rename" else 1
        names = [name for name in args[:count] if isinstance(name, str | bytes | os.PathLike)]
        if event == "open":
            if isinstance(args[2], int) and args[2] & getattr(os, "O_DIRECTORY", 0):
                return []  # a walk through a folder, whose own descriptor the event leaves out
        folders = (
            [number for number in args[1:] if isinstance(number, int) and number >= 0]
            if event != "open"
            else []
        )
        start = os.path.realpath(f"/proc/self/fd/{folders[0]}") if folders else os.getcwd()
        return [os.path.realpath(os.path.join(start, os.fsdecode(name).replace("\0", ""))) for name in names]


def allowed(folder: Path) -> tuple[str, ...]:
    """Starts of the paths that a case may open: its own folder, the program, the interpreter, the system's devices."""
    import sarmitsuba
    from sarmitsuba.loading.library import scenes_dir
    from sarmitsuba.loading.plugins import plugins_dir

    own = (
        folder,
        scenes_dir(),
        plugins_dir(),
        Path(sarmitsuba.__file__).parent,
        sys.prefix,
        sys.base_prefix,
        Path.home() / ".drjit",
    )
    system = (
        "/proc/",
        "/sys/",
        "/dev/null",
        "/dev/urandom",
        "/dev/shm/",
        "/usr/lib",
        "/lib",
        "/usr/share",
        "/etc/ld.so",
    )
    return (*(os.path.realpath(place) for place in own), *system)


def read_one(kind: Kind, path: Path) -> tuple[str, str]:
    """Outcome of reading a file, and what was said."""
    from sarmitsuba.core.errors import SarmitsubaError

    before = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            outcome, text = "refused" if kind.read(path) == REFUSED else "read", ""
    except SarmitsubaError as error:
        text = str(error)
        outcome = "refused" if "\n" not in text and 10 < len(text) <= LONGEST else "message"
    except Exception as error:  # what this looks for
        frame = error.__traceback__
        while frame is not None and frame.tb_next is not None:
            frame = frame.tb_next
        place = f"{Path(frame.tb_frame.f_code.co_filename).name}:{frame.tb_lineno}" if frame else ""
        outcome, text = "traceback", f"{type(error).__name__}: {error} ({place})"
    if (resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - before) * 1024 > GROWTH:
        outcome = "memory"
    return outcome, text[:2000]


def lay_out(samples: Path, folder: Path) -> None:
    """Put what drawn files may name beside them, and a file that must stay one folder above."""
    for path in samples.iterdir():
        if path.suffix in {".ply", ".xml", ".spd", ".png"}:
            shutil.copy(path, folder)
    shutil.copytree(samples / "run", folder / "run", dirs_exist_ok=True)
    (folder / "outside.txt").write_text("stays", encoding="utf-8")


def prepare(samples: Path, folder: Path) -> None:
    """Lay a case's folder out, and run where the same names are but nothing may be read."""
    lay_out(samples, folder)
    elsewhere = folder.parent / "elsewhere"  # where the program runs, which is no place to look for anything
    shutil.copytree(folder, elsewhere, dirs_exist_ok=True)
    os.chdir(elsewhere)


def work(
    name: str,
    samples: Path,
    folder: Path,
    seeds: range,
    tell: Callable[[tuple[int, str, str]], object],
    mark: str = "",
) -> None:
    """Read the files of the seeds, one after the other, and tell of each.

    ``mark`` is the start of a name that is opened, in vain, before and after every case, for who listens outside.
    """
    kind = KINDS[name]
    samples, folder = samples.resolve(), folder.resolve()
    whole = (samples / kind.file).read_bytes()
    prepare(samples, folder)
    watch = Watch(folder)
    path = kind.place(folder)
    path.write_bytes(whole)
    outcome, text = read_one(kind, path)  # loads what is needed
    if outcome != "read":
        raise AssertionError(f"{name}: the undamaged file: {outcome}: {text}")
    for seed in seeds:
        path.write_bytes(drawn(name, seed, whole))
        used = resource.getrusage(resource.RUSAGE_SELF)
        limit = int(used.ru_utime + used.ru_stime) + CPU_LIMIT
        resource.setrlimit(resource.RLIMIT_CPU, (limit, resource.RLIM_INFINITY))
        if mark:
            Path(f"{mark}-begin-{name}-{seed}").exists()
        watch.on, watch.found, watch.kind = True, [], ""
        outcome, text = read_one(kind, path)
        watch.on = False
        if mark:
            Path(f"{mark}-end-{name}-{seed}").exists()
        if watch.found:
            outcome, text = watch.kind, "; ".join(watch.found[:5]) + f" | {outcome}: {text}"
        tell((seed, outcome, text))


def drawn(name: str, seed: int, whole: bytes) -> bytes:
    """The file of a seed; what a library refuses to write is drawn again."""
    for attempt in range(100):
        try:
            return KINDS[name].mutate(random.Random(f"{name} {seed} {attempt}"), whole)
        except (
            ArithmeticError,
            AttributeError,
            LookupError,
            MemoryError,
            OSError,
            RuntimeError,
            TypeError,
            ValueError,
        ):
            continue
    raise AssertionError(f"{name} {seed}: nothing could be drawn")


def _work(
    name: str, samples: Path, folder: Path, seeds: range, pipe: "multiprocessing.connection.Connection"
) -> None:
    sys.stdout = open(os.devnull, "w", encoding="utf-8")
    work(name, samples, folder, seeds, pipe.send)
    pipe.close()


def cpu_seconds(process: int) -> float:
    """CPU time of a process and of those that it started, s; whatever else the machine does."""
    total = 0
    for path in Path("/proc").glob("[0-9]*/stat"):
        try:
            fields = path.read_text(encoding="ascii", errors="replace").rpartition(")")[2].split()
        except OSError:  # ended meanwhile
            continue
        if process in (int(path.parent.name), int(fields[1])):
            total += sum(int(field) for field in fields[11:15])
    return total / os.sysconf("SC_CLK_TCK")


def attack(name: str, samples: Path, folder: Path, seeds: range) -> tuple[Counter[str], list[dict[str, Any]]]:
    """Counts of outcomes over drawn files of a kind, and what went wrong."""
    found: Counter[str] = Counter()
    wrong: list[dict[str, Any]] = []
    context = multiprocessing.get_context("spawn")
    scratch = folder / f"scratch_{name}" / "case"
    start = seeds.start
    while start < seeds.stop:
        scratch.mkdir(parents=True, exist_ok=True)
        here, there = context.Pipe(duplex=False)
        rest = range(start, seeds.stop)
        worker = context.Process(target=_work, args=(name, samples, scratch, rest, there))
        worker.start()
        there.close()
        waited, before = False, 0.0
        try:
            while True:
                if not here.poll(LONGEST_WAIT):
                    now = cpu_seconds(worker.pid or 0)
                    if now > before:
                        before = now
                        continue
                    waited = True
                    worker.kill()
                    break
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
            if code == 1:
                raise SystemExit(f"{name}: the worker could not begin")
            outcome = "hang" if waited or -code == signal.SIGXCPU else "abort"
            found[outcome] += 1
            kept = folder / f"{name}_{start}{Path(KINDS[name].file).suffix}"
            shutil.copy(KINDS[name].place(scratch), kept)
            wrong.append({"kind": name, "seed": start, "outcome": outcome, "text": f"exit {code}: {kept}"})
            start += 1
    shutil.rmtree(scratch.parent, ignore_errors=True)
    return found, wrong


def trace(names: list[str], samples: Path, folder: Path, seeds: range) -> int:
    """Read the files under ``strace``; print files opened outside the case's folder and connections; their number."""
    mark, log = "/sarmitsuba-case", folder / "strace.log"
    strange: Counter[str] = Counter()
    cases = calls = 0
    for name in names:
        scratch = folder / f"scratch_{name}" / "case"
        scratch.mkdir(parents=True, exist_ok=True)
        code = (
            "from pathlib import Path; from benchmarks.studies import hostile\n"
            f"hostile.work({name!r}, Path({str(samples)!r}), Path({str(scratch)!r}), {seeds!r}, "
            f"lambda told: None, {mark!r})"
        )
        watched = "trace=openat,open,connect,sendto,execve,newfstatat,stat"
        command = [
            "strace",
            "-f",
            "--seccomp-bpf",
            "-e",
            watched,
            "-e",
            "signal=none",
            "-s",
            "400",
            "-o",
            str(log),
        ]
        ended = subprocess.run([*command, sys.executable, "-c", code], stdout=subprocess.DEVNULL, check=False)
        if ended.returncode:
            print(f"{name}: ended with {ended.returncode}")
        roots = allowed(scratch)
        on = False
        with log.open(encoding="utf-8", errors="replace") as lines:
            for line in lines:
                if mark in line:
                    on = "-begin-" in line
                    cases += on
                elif on and not ("open" in line and " = -1 " in line):  # what is not there is not read
                    call = re.search(r"(open|openat|connect|sendto|execve)\((.*)", line)
                    if call is None:
                        continue
                    calls += 1
                    place = re.search(r'"([^"]*)"', call[2])
                    inside = place is not None and os.path.realpath(place[1]).startswith(roots)
                    if call[1] not in ("open", "openat") or not inside:
                        strange[f"{name}: {call[0][:160]}"] += 1
        shutil.rmtree(scratch.parent, ignore_errors=True)
    print(f"strace: {cases} cases, {calls} calls that opened, connected or started something")
    print(f"of them outside: {sum(strange.values())}")
    for text, count in strange.most_common(20):
        print(f"{count} x {text}")
    return sum(strange.values())


def main() -> int:
    """Draw, read, count."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--kinds", default=",".join(KINDS), help="comma separated")
    parser.add_argument("--count", type=int, default=400)
    parser.add_argument("--first", type=int, default=0, help="first seed")
    parser.add_argument(
        "--strace", action="store_true", help="watch the system's calls instead of counting outcomes"
    )
    parser.add_argument("-o", "--out", type=Path, default=Path("out/hostile"))
    args = parser.parse_args()
    samples, seeds, names = (
        args.out / "samples",
        range(args.first, args.first + args.count),
        args.kinds.split(","),
    )
    make_samples(samples)
    if args.strace:
        return 1 if trace(names, samples.resolve(), args.out.resolve(), seeds) else 0
    print("| kind | " + " | ".join(COLUMNS) + " | CPU s |\n" + "|---" * (len(COLUMNS) + 2) + "|", flush=True)
    record: dict[str, Any] = {"first": args.first, "count": args.count, "found": {}, "wrong": []}
    total: Counter[str] = Counter()

    def cpu() -> float:
        used = resource.getrusage(resource.RUSAGE_CHILDREN)
        return used.ru_utime + used.ru_stime

    begun = time.monotonic()
    for name in names:
        before = cpu()
        found, wrong = attack(name, samples, args.out.resolve(), seeds)
        print(
            f"| {name} | " + " | ".join(str(found[c]) for c in COLUMNS) + f" | {cpu() - before:.0f} |",
            flush=True,
        )
        total += found
        record["found"][name] = dict(found)
        record["wrong"] += wrong
        (args.out / "hostile.json").write_text(json.dumps(record, indent=1), encoding="utf-8")
    print("| all | " + " | ".join(str(total[c]) for c in COLUMNS) + f" | {cpu():.0f} |")
    print(
        f"seeds {seeds.start} to {seeds.stop - 1}, {sum(total.values())} files, {time.monotonic() - begun:.0f} s"
    )
    for each in record["wrong"][:40]:
        print(f"{each['kind']} {each['seed']}: {each['outcome']}: {each['text'][:300]}")
    return 1 if record["wrong"] else 0


__all__ = ["BOMB", "KINDS", "Kind", "attack", "make_samples", "read_one"]

if __name__ == "__main__":
    sys.exit(main())
