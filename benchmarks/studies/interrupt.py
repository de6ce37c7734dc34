"""Ctrl-C and SIGTERM at drawn times of a run: exit status, what is said, what is left on the disk, how long it takes.

    python -m benchmarks.studies.interrupt --count 200
    python -m benchmarks.studies.interrupt --count 60 --inside proj,lapack,hdf5   # in C code that answers no signal

The clock of a run starts when the program has begun to be its own: before that Python itself answers a signal, which no
program can change.
"""

import argparse
import collections
import os
import random
import re
import signal
import statistics
import subprocess
import sys
import tempfile
import time
from dataclasses import dataclass
from pathlib import Path

SEED = 26
STATUS = {signal.SIGINT: 130, signal.SIGTERM: 143}
KILLED = -9  # by the guard, where a library answers no signal
LONGEST = 2.0  # s from the signal to the end
# extensions that stay in C code: some let other threads run meanwhile, some do not
INSIDE = {
    "proj": "from rasterio.warp import transform\n{ready}\ntransform('EPSG:3857', 'EPSG:4326', [1e19], [0.0])",
    "lapack": "import numpy, scipy.linalg\nm = numpy.random.default_rng(1).normal(size=(2500, 2500))\n{ready}\n"
    "while True: scipy.linalg.eig(m)",
    "hdf5": "import h5py, numpy, os\nm = numpy.random.default_rng(1).normal(size=20_000_000)\n"
    "f = h5py.File('big.h5', 'w')\n{ready}\n"
    "f.create_dataset('x', data=m, chunks=(1_000_000,), compression='gzip', compression_opts=9)",
}
# a file that is being written meanwhile, and a sum in which Python itself answers nothing
INSIDE["python"] = (
    "from pathlib import Path\nfrom sarmitsuba.machine.atomic import atomic_path\n"
    "with atomic_path(Path('file.txt')) as path:\n path.touch()\n {ready}\n sum(range(10**15))"
)
READY = "print('ready', flush=True)"


@dataclass(frozen=True)
class Ended:
    """How one run ended.

    Parameters
    ----------
    status : of the process
    wrong : what was not as promised; empty: nothing
    seconds : from the signal to the end
    """

    status: int
    wrong: str
    seconds: float


def interrupted(folder: Path, number: int, delay: float, inside: str = "") -> Ended:
    """Start `render point`, or code that stays inside a library, in a folder of its own; send the signal later."""
    own = Path(tempfile.mkdtemp(dir=folder))
    out = own / "out"
    words = ["render", "point", "-o", str(out)]
    if inside:
        (own / "inside.py").write_text(INSIDE[inside].format(ready=READY), encoding="utf-8")
        words = ["--extension", str(own / "inside.py"), "doctor"]
    command = [sys.executable, "-m", "sarmitsuba", *words]
    environment = os.environ | {"PYTHONPATH": str(Path.cwd())}
    with subprocess.Popen(
        command,
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        cwd=own,
        env=environment,
        # a job in the background starts with the signal ignored
        preexec_fn=lambda: signal.signal(signal.SIGINT, signal.SIG_DFL),
    ) as process:
        if inside:
            assert process.stdout is not None
            process.stdout.readline()
        else:
            wait_until_it_listens(process)
        time.sleep(delay)
        begin = time.perf_counter()
        process.send_signal(number)
        try:
            process.wait(timeout=300)
        except subprocess.TimeoutExpired:
            process.kill()
        seconds = time.perf_counter() - begin
        _, errors = process.communicate(timeout=120)
    return Ended(process.returncode, judged(process.returncode, number, errors, out, inside), seconds)


def wait_until_it_listens(process: subprocess.Popen[str]) -> None:
    """Return when the process handles both signals itself, as /proc tells, or has ended."""
    both = (1 << (signal.SIGINT - 1)) | (1 << (signal.SIGTERM - 1))
    while process.poll() is None:
        try:
            text = Path(f"/proc/{process.pid}/status").read_text(encoding="ascii")
        except OSError:
            return
        caught = re.search(r"SigCgt:\s*([0-9a-f]+)", text)
        if caught is None or int(caught[1], 16) & both == both:
            return
        time.sleep(0.001)


def judged(status: int, number: int, errors: str, out: Path, inside: str) -> str:
    """What is wrong with an end; a run that was through when the signal came has its results and status 0."""
    if "Traceback" in errors or "Error in" in errors or "Exception ignored" in errors:
        return f"traceback: {errors[-300:]}"
    left = sorted(path.name for path in out.parent.rglob("*") if "-part-" in path.name)
    if left:
        return f"left {left}"
    if status == 0 and not inside:
        return "" if (out / "image.h5").exists() else "status 0 without an image"
    if status != STATUS[signal.Signals(number)] and not (inside and status == KILLED):
        return f"status {status}: {errors[-200:]}"
    lines = [line for line in errors.splitlines() if line.startswith("error:")]
    return "" if len(lines) == 1 else f"{len(lines)} lines of errors"


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("--count", type=int, default=200, help="runs (default: 200)")
    parser.add_argument(
        "--longest", type=float, default=0.0, help="s; 0 (default): those of a run left alone"
    )
    parser.add_argument(
        "--inside", default="", help=f"comma separated: {', '.join(INSIDE)}; default: a render"
    )
    options = parser.parse_args()
    kinds = options.inside.split(",")
    # a shell that starts this in the background has it ignored, and so would the runs
    signal.signal(signal.SIGINT, signal.default_int_handler)
    rng = random.Random(SEED)
    ends: collections.Counter[str] = collections.Counter()
    took: list[float] = []
    with tempfile.TemporaryDirectory() as name:
        begin = time.perf_counter()
        subprocess.run(
            [sys.executable, "-m", "sarmitsuba", "render", "point", "--quiet", "-o", f"{name}/whole"],
            check=True,
        )
        longest = options.longest or 1.1 * (time.perf_counter() - begin)
        for i in range(options.count):
            number, delay = rng.choice(tuple(STATUS)), rng.uniform(0.0, longest)
            inside = kinds[i % len(kinds)]
            ended = interrupted(Path(name), number, delay, inside)
            what = f"{inside or 'render'} {signal.Signals(number).name}"
            ends[ended.wrong or f"{what}: status {ended.status}"] += 1
            took.append(ended.seconds)
            if ended.wrong or ended.seconds > LONGEST:
                print(f"{what} after {delay:.3f} s: {ended.seconds:.2f} s, {ended.wrong}", flush=True)
    for what, count in ends.most_common():
        print(f"{count:4d}  {what}")
    late = sum(seconds > LONGEST for seconds in took)
    print(
        f"from the signal to the end: {statistics.median(took):.2f} s in the middle, at most {max(took):.2f} s; "
        f"{len(took) - late} of {len(took)} within {LONGEST:g} s"
    )
    return int(any(not re.match(r"\w+ SIG\w+: status", what) for what in ends))


if __name__ == "__main__":
    sys.exit(main())
