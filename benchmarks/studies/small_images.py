"""Processor time of small images in a loop: a trihedral and a car, every heading another, loading included.

Usage: python -m benchmarks.studies.small_images [--images N]

Each image is made twice in turn: by one thread, as short runs are, and by all threads of the pool. The pixels of both
have the same bits. Medians of all images but the first quarter, which compiles and loads kernels. The last columns are
the launches of an image by one thread and the part of its time in which Python records their kernels.
"""

import argparse
import importlib
import statistics
import tempfile
import time
import warnings
from pathlib import Path
from typing import Any

import numpy as np

CAR = """<scene version="3.0.0">
    <integrator type="sar_path"/>
    <sensor type="sar_antenna">
        <string name="mode" value="spotlight"/>
        <float name="slant_range" value="5000"/>
        <float name="look_angle_deg" value="55"/>
        <float name="speed" value="100"/>
        <float name="center_frequency" value="9.6e9"/>
        <float name="bandwidth" value="500e6"/>
        <float name="azimuth_resolution" value="0.3"/>
        <film type="range_film">
            <string name="image_grid" value="ground"/>
            <float name="image_extent_azimuth" value="20"/>
            <float name="image_extent_range" value="20"/>
        </film>
    </sensor>
    <bsdf type="radar_material" id="soil">
        <string name="material" value="medium_dry_ground"/>
        <float name="rms_height" value="0.01"/>
        <string name="diffuse_law" value="constant_gamma"/>
        <float name="diffuse_level_db" value="-12"/>
    </bsdf>
    <bsdf type="radar_material" id="bodywork">
        <string name="material" value="metal"/><boolean name="smooth" value="true"/>
    </bsdf>
    <shape type="rectangle" id="ground">
        <transform name="to_world"><scale x="20" y="20" z="1"/></transform>
        <ref id="soil"/>
    </shape>
    <shape type="cube" id="body">
        <transform name="to_world"><scale x="2.2" y="0.9" z="0.35"/><translate z="0.75"/></transform>
        <ref id="bodywork"/>
    </shape>
    <shape type="cube" id="cabin">
        <transform name="to_world"><scale x="1.1" y="0.8" z="0.3"/><translate x="-0.3" z="1.4"/></transform>
        <ref id="bodywork"/>
    </shape>
</scene>
"""


def measure(name: str, images: int) -> None:
    """Print one row."""
    from sarmitsuba.loading.load import load_scene
    from sarmitsuba.tracing.kernel.source import Launch
    from tests.support.unweighted import render

    run = importlib.import_module("sarmitsuba.simulation.execution.run")
    usual, record = run.ONE_THREAD, Launch.record
    taken: dict[str, list[float]] = {"one thread": [], "pool": []}
    recorded: list[float] = []
    recordings: list[tuple[int, float]] = []

    def timed(self: Launch, *arguments: Any) -> Any:
        before = time.process_time()
        found = record(self, *arguments)
        recorded.append(1e3 * (time.process_time() - before))
        return found

    Launch.record = timed  # type: ignore[method-assign]
    differ = 0
    for i in range(images):
        pixels = []
        for way in taken:
            run.ONE_THREAD = usual if way == "one thread" else 0.0
            recorded.clear()
            before = time.process_time()
            scene = load_scene(name, parameters={"sar_antenna.heading_deg": str((7 + 13 * i) % 360)})
            image = render(scene)
            taken[way].append(1e3 * (time.process_time() - before))
            pixels.append(image.data)
            if way == "one thread":
                recordings.append((len(recorded), sum(recorded)))
        differ += int(not np.array_equal(*pixels))
    run.ONE_THREAD, Launch.record = usual, record  # type: ignore[method-assign]
    one, pool = (statistics.median(values[images // 4 :]) for values in taken.values())
    launches, recording = (
        statistics.median(column) for column in zip(*recordings[images // 4 :], strict=True)
    )
    size, pulses = " x ".join(str(n) for n in image.data.shape[1:]), scene.radar.track.n_pulses
    print(
        f"{Path(name).stem:12} {size:>10} {pulses:>7} {one:>12.0f} {pool:>10.0f} {one / pool:>6.2f} {differ:>8}"
        f" {launches:>9.0f} {recording:>10.0f}"
    )


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--images", type=int, default=40, help="of each scene (default %(default)s)")
    images = parser.parse_args().images
    warnings.simplefilter("ignore")
    print(
        f"{'scene':12} {'pixels':>10} {'pulses':>7} {'one thread':>12} {'pool':>10} {'ratio':>6} {'differ':>8}"
        f" {'launches':>9} {'recording':>10}"
    )
    print(f"{'':12} {'':>10} {'':>7} {'CPU ms':>12} {'CPU ms':>10} {'':>6} {'':>8} {'':>9} {'CPU ms':>10}")
    with tempfile.TemporaryDirectory() as folder:
        car = Path(folder) / "car.xml"
        car.write_text(CAR, encoding="utf-8")
        for name in ("trihedral", str(car)):
            measure(name, images)


if __name__ == "__main__":
    main()
