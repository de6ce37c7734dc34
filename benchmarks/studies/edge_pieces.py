"""Edges of metal in pieces as long as the coherent rays are apart, and in pieces of two wavelengths, in one process.

    python -m benchmarks.studies.edge_pieces             # the shipped harbour
    python -m benchmarks.studies.edge_pieces munich      # of the package sionna-rt

Prints pieces, seconds of the processor to lay out the edges and to trace them, and the energy relative to the raw data
of the edges' echoes and of their change.
"""

import argparse
import importlib.util
import time
import warnings
from pathlib import Path
from typing import Any

import numpy as np

from sarmitsuba import SarmitsubaWarning, Scene, load_scene, simulate
from sarmitsuba.core.arrays import C64
from sarmitsuba.loading.library import resolve_radar
from sarmitsuba.simulation.execution.tracing import Tracer
from sarmitsuba.simulation.planning.sampling import density_plan
from sarmitsuba.tracing.kernel.source import PointSource
from sarmitsuba.tracing.scatterers.edges.diffraction import FringeCurrents

SCENES = Path(__file__).resolve().parents[2] / "scenes"


def scene_of(name: str, edges: str) -> Scene:
    """A shipped scene, or one of the package sionna-rt with the radar ``airborne_x``."""
    switch = {"sar_path.edge_diffraction": edges}
    shipped = SCENES / f"{name}.xml"
    if shipped.exists():
        return load_scene(shipped, parameters=switch)
    spec = importlib.util.find_spec("sionna")
    if spec is None or not spec.submodule_search_locations:
        raise SystemExit(
            f"edge_pieces: no scene {name} is shipped, and the package sionna-rt is not installed"
        )
    folder = Path(next(iter(spec.submodule_search_locations))) / "rt" / "scenes" / name
    return load_scene(folder / f"{name}.xml", radar=resolve_radar("airborne_x"), parameters=switch)


def main() -> None:
    """Print a line for each length of the pieces."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("scene", nargs="?", default="harbour")
    name = parser.parse_args().scene
    warnings.simplefilter("ignore", SarmitsubaWarning)
    as_rays, launch = density_plan.edges_of, Tracer.launch
    seconds = {"laying out": 0.0, "tracing": 0.0}
    pieces = 0

    def made(*given: Any) -> Any:
        nonlocal pieces
        start = time.process_time()
        found = as_rays(*given) if rays else as_rays(*given[:4])
        seconds["laying out"] += time.process_time() - start
        pieces = found.n
        return found

    def traced(self: Tracer, one: Any, *given: Any) -> Any:
        start = time.process_time()
        found = launch(self, one, *given)
        if isinstance(one.source, PointSource) and isinstance(one.source.scatterers, FringeCurrents):
            seconds["tracing"] += time.process_time() - start
        return found

    density_plan.edges_of, Tracer.launch = made, traced  # type: ignore[assignment, method-assign]
    rays = True
    without = simulate(scene_of(name, "off")).data
    simulate(scene_of(name, "on"))  # compiles
    data: list[C64] = []
    for rays in (False, True):
        seconds.update({"laying out": 0.0, "tracing": 0.0})
        data.append(simulate(scene_of(name, "on")).data)
        shown = ", ".join(f"{stage} {value:.2f} CPU s" for stage, value in seconds.items())
        print(
            f"{name}: pieces {'as long as rays are apart' if rays else 'of two wavelengths':26} {pieces:7d}, {shown}"
        )
    energy = [float(np.sum(np.abs(a - b) ** 2)) for a, b in ((data[0], without), (data[1], data[0]))]
    whole = float(np.sum(np.abs(data[0]) ** 2))
    edges, change = (10.0 * np.log10(max(e / whole, 1e-40)) for e in energy)
    print(f"{name}: edges {edges:.1f} dB of the data, their change {change:.1f} dB")


if __name__ == "__main__":
    main()
