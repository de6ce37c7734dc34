"""Ctrl-C and SIGTERM at drawn times of a run: exit status, what is said, what is left on the disk.

    python benchmarks/studies/interrupt.py --count 200

The clock of a run starts when the program has begun to be its own: before that Python itself answers a signal, which no
program can change.
"""

import argparse
import collections
import random
import re
import signal
import subprocess
import sys
import tempfile
import time
from dataclasses import dataclass
from pathlib import Path

SEED = 26
STATUS = {signal.SIGINT: 130, signal.SIGTERM: 143}


@dataclass(frozen=True)
class Ended:
    """How one run ended.

    Parameters
    ----------
    status : of the process
    wrong : what was not as promised; empty: nothing
    """

    status: int
    wrong: str


def interrupted(folder: Path, number: int, delay: float) -> Ended:
    """Start `render point` in a folder of its own, send the signal after ``delay`` seconds, look at what is left."""
    out = Path(tempfile.mkdtemp(dir=folder)) / "out"
    command = [sys.executable, "-m", "sarmitsuba", "render", "point", "-o", str(out)]
    with subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True) as process:
        wait_until_it_listens(process)
        time.sleep(delay)
        process.send_signal(number)
        _, errors = process.communicate(timeout=120)
    return Ended(process.returncode, judged(process.returncode, number, errors, out))


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


def judged(status: int, number: int, errors: str, out: Path) -> str:
    """What is wrong with an end; a run that was through when the signal came has its results and status 0."""
    if "Traceback" in errors or "Error in" in errors or "Exception ignored" in errors:
        return f"traceback: {errors[-300:]}"
    left = sorted(path.name for path in out.rglob("*") if "-part-" in path.name) if out.exists() else []
    if left:
        return f"left {left}"
    if status == 0:
        return "" if (out / "image.h5").exists() else "status 0 without an image"
    if status != STATUS[signal.Signals(number)]:
        return f"status {status}: {errors[-200:]}"
    lines = [line for line in errors.splitlines() if line.startswith("error:")]
    return "" if len(lines) == 1 else f"{len(lines)} lines of errors"


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("--count", type=int, default=200, help="runs (default: 200)")
    parser.add_argument(
        "--longest", type=float, default=0.0, help="s; 0 (default): those of a run left alone"
    )
    options = parser.parse_args()
    # a shell that starts this in the background has it ignored, and so would the runs
    signal.signal(signal.SIGINT, signal.default_int_handler)
    rng = random.Random(SEED)
    ends: collections.Counter[str] = collections.Counter()
    with tempfile.TemporaryDirectory() as name:
        begin = time.perf_counter()
        subprocess.run(
            [sys.executable, "-m", "sarmitsuba", "render", "point", "--quiet", "-o", f"{name}/whole"],
            check=True,
        )
        longest = options.longest or 1.1 * (time.perf_counter() - begin)
        for _ in range(options.count):
            number, delay = rng.choice(tuple(STATUS)), rng.uniform(0.0, longest)
            ended = interrupted(Path(name), number, delay)
            ends[ended.wrong or f"{signal.Signals(number).name}: status {ended.status}"] += 1
            if ended.wrong:
                print(f"{signal.Signals(number).name} after {delay:.3f} s: {ended.wrong}", flush=True)
    for what, count in ends.most_common():
        print(f"{count:4d}  {what}")
    return int(any(not re.match(r"SIG\w+: status", what) for what in ends))


if __name__ == "__main__":
    sys.exit(main())
