"""What the motion of water costs: the harbour's raw data with it and without, in turn."""

import statistics
import time
import warnings

from benchmarks.support import harness


@harness.benchmark
def run(quick: bool) -> harness.Report:
    from sarmitsuba.core.errors import SarmitsubaWarning
    from sarmitsuba.loading.load import load_scene
    from sarmitsuba.simulation.execution.render import simulate

    report = harness.Report(
        "water",
        "Motion of water under wind",
        "Processor time of the raw data of `harbour`, half of which is a sea of 48 long waves, in pairs: as planned, "
        "and with `water_motion` off, where the same waves stand still.",
    )
    scene = load_scene("harbour")
    jobs = {"as planned": scene, "water_motion off": scene.replace(water_motion="off")}
    taken: dict[str, list[float]] = {name: [] for name in jobs}
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", SarmitsubaWarning)  # what is switched off
        for _ in range(3 if quick else 8):
            for name, each in jobs.items():
                before = time.process_time()
                simulate(each)
                taken[name].append(time.process_time() - before)
    # the first round compiles
    pairs = [a / b for a, b in zip(*(seconds[1:] for seconds in taken.values()), strict=True)]
    rows = [[name, f"{statistics.median(seconds[1:]):.2f}"] for name, seconds in taken.items()]
    report.table("", ["run", "CPU s"], rows)
    report.claim(
        "CPU time over that of frozen water, median of pairs", statistics.median(pairs), 2.0, at_least=False
    )
    return report


if __name__ == "__main__":
    harness.main(run)
