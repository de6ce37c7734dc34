"""Work that is shared out comes back as one process makes it, whoever does it, in whatever order, and whoever dies."""

import argparse
import dataclasses
import os
import pickle
import random
import signal
import stat
import tempfile
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from sarmitsuba import load_scene, simulate
from sarmitsuba.apps.cluster import ClusterAddress, ClusterPlan
from sarmitsuba.cli import main
from sarmitsuba.commands.cluster_arguments import open_workers
from sarmitsuba.commands.console import Console
from sarmitsuba.core.errors import ClusterError
from sarmitsuba.core.progress import silent
from sarmitsuba.scene.scene import Scene
from sarmitsuba.scene.settings import Method, TraceSettings
from sarmitsuba.signal.focusing import default_grid
from sarmitsuba.signal.focusing.focuser import FocusTask
from sarmitsuba.signal.focusing.focusers.backprojection import Backprojection, backproject
from sarmitsuba.signal.focusing.windows import parse_window
from sarmitsuba.signal.raw_data import Layer, RawData
from sarmitsuba.simulation.execution.tracing import Batch, Traced, TraceJob

FEW = {"azimuth_resolution": "1.5", "image_extent_azimuth": "24"}


def scene_of(name: str, few: dict[str, str], **settings: object) -> Scene:
    plugins = {"azimuth_resolution": "sar_antenna", "image_extent_azimuth": "range_film"}
    scene = load_scene(name, parameters={f"{plugins[k]}.{k}": v for k, v in few.items()})
    return dataclasses.replace(scene, settings=dataclasses.replace(scene.settings, **settings))


class Scattered:
    """Two workers of another process's kind: all they know was pickled; results come in a drawn order."""

    n_workers = 2

    def __init__(self, seed: int) -> None:
        self.draw = random.Random(seed)
        self.batches: list[Batch] = []

    def trace(self, job: TraceJob, batches: Sequence[Batch]) -> Iterator[Traced]:
        tracers = [pickle.loads(pickle.dumps(job)).tracer() for _ in range(self.n_workers)]
        self.batches = self.draw.sample(batches, len(batches))
        for batch in self.batches:
            yield pickle.loads(pickle.dumps(self.draw.choice(tracers).trace(batch)))


def assert_same(shared: RawData, alone: RawData) -> None:
    assert np.any(alone.data)
    np.testing.assert_array_equal(shared.data, alone.data)
    apart = {key for key in alone.metadata if shared.metadata[key] != alone.metadata[key]}
    # seconds, and those of the pilot in the effects, are the run's own
    assert apart <= {"seconds", "processor_seconds", "effects"}
    assert shared.metadata["effects"]["effects"] == alone.metadata["effects"]["effects"]


@pytest.mark.parametrize(
    ("name", "few", "settings"),
    [
        ("tower", FEW, {"keep_subsets": True, "key_pulse_interval": 24}),
        (
            "tower",
            {"azimuth_resolution": "8", "image_extent_azimuth": "6"},
            {"keep_orders": True, "method": "raw", "keep_subsets": True},
        ),
        pytest.param(
            "moving_cars",
            {"azimuth_resolution": "3", "image_extent_azimuth": "120"},
            {"key_pulse_interval": 2},
            marks=pytest.mark.slow,
        ),
    ],
)
def test_the_bits_do_not_depend_on_who_traces(
    name: str, few: dict[str, str], settings: dict[str, object]
) -> None:
    scene = scene_of(name, few, **settings)
    workers = Scattered(seed=len(str(settings)))
    shared = simulate(scene, workers=workers)
    assert_same(shared, simulate(scene))
    assert len(workers.batches) > 1


def test_progress_counts_every_batch_and_tells_the_workers() -> None:
    scene = scene_of("tower", FEW, key_pulse_interval=16)
    told: list[tuple[float, float]] = []

    def progress(stage: str, done: float, total: float, info: dict[str, float]) -> None:
        told.append((done / total, info["workers"]))

    workers = Scattered(seed=3)
    simulate(scene, workers=workers, progress=progress)
    shares = [share for share, _ in told]
    assert shares == sorted(shares) and shares[-1] == 1.0
    assert len(set(shares)) == len(workers.batches) + 1  # and the two that settle the interval
    assert {workers for _, workers in told} == {2.0}


def test_a_client_that_ends_goes_on_from_what_came_back(tmp_path: Path) -> None:
    scene = scene_of("tower", FEW, key_pulse_interval=16)
    state, first, second = tmp_path / "blocks", Scattered(seed=4), Scattered(seed=5)
    told = 0

    def stop_at_the_third(stage: str, done: float, total: float, info: dict[str, float]) -> None:
        nonlocal told
        told += 1
        if told == 3:  # the two blocks that settle the interval, and two that were shared
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        simulate(scene, workers=first, state=state, progress=stop_at_the_third)
    again = simulate(scene, workers=second, state=state)
    assert set(second.batches) == set(first.batches[2:])
    assert_same(again, simulate(scene))


def test_what_is_not_shared_is_said(capsys: pytest.CaptureFixture[str]) -> None:
    methods: tuple[Method, ...] = ("image", "raster")
    for method in methods:
        settings = TraceSettings(method=method)
        with open_workers(argparse.Namespace(cluster="local"), Console(), settings) as workers:
            assert workers is None
        assert f"note: --cluster local: method {method} takes one look" in capsys.readouterr().err
    with open_workers(argparse.Namespace(cluster=None), Console(), TraceSettings()) as workers:
        assert workers is None
    assert capsys.readouterr() == ("", "")
    assert main(["render", "tower", "-o", "nowhere", "--cluster", "somewhere"]) == 2
    assert capsys.readouterr().err.startswith("error: cluster somewhere: not the address")
    assert main(["explain", "tower", "--workers", "0"]) == 2
    assert capsys.readouterr().err.startswith("error: explain: --workers 0 needs")


@pytest.mark.slow
def test_a_killed_worker_loses_nothing() -> None:
    """Two processes; at drawn moments one is killed with SIGKILL: same bits."""
    from sarmitsuba.apps.cluster import SharedBackprojection
    from sarmitsuba.apps.cluster import open_workers as opened

    scene = scene_of("tower", {}, keep_subsets=True, key_pulse_interval=32)
    alone = simulate(scene)
    draw = random.Random(16)
    with opened(ClusterAddress("", 2)) as workers:
        assert_same(simulate(scene, workers=workers), alone)
        for _ in range(2):
            moment, killed = draw.uniform(0.1, 0.8), []

            def progress(
                stage: str, done: float, total: float, info: dict[str, float], moment=moment, killed=killed
            ) -> None:
                if done > moment * total and not killed:
                    killed.append(draw.choice(sorted(workers.client.run(os.getpid).values())))
                    os.kill(killed[0], signal.SIGKILL)

            assert_same(simulate(scene, workers=workers, progress=progress), alone)
            assert killed and killed[0] not in workers.client.run(os.getpid).values()
        grid, window = default_grid(alone), parse_window("taylor")
        task = FocusTask(alone, grid, window, window, silent)
        shared = SharedBackprojection(workers=workers, tile_pixels=20_000)
        pixels = shared.focus(task).pixels
        assert pixels[0].size > 3 * shared.tile_pixels
    again = backproject(
        alone, grid, range_window=window, azimuth_window=window, tile_pixels=shared.tile_pixels
    )
    np.testing.assert_array_equal(pixels, again)


@pytest.mark.parametrize("text", ["local:0", "local:x", "local:", "local:100000", "somewhere", "http//x", ""])
def test_what_is_no_address_is_said_in_one_line(text: str) -> None:
    with pytest.raises(ClusterError) as caught:
        ClusterAddress.parse(text)
    assert str(caught.value).startswith(f"cluster {text}: ") and "\n" not in str(caught.value)


def test_addresses() -> None:
    assert ClusterAddress.parse("tcp://10.0.0.1:8786") == ClusterAddress("tcp://10.0.0.1:8786", 0)
    assert ClusterAddress.parse("head:8786").scheduler == "head:8786"
    assert ClusterAddress.parse("local:1").workers == 1
    assert not ClusterAddress.parse("local").scheduler


def test_planned_hours_are_those_of_a_schedule() -> None:
    """Against workers that each take the next of equal parts when they are done with the last."""
    draw = random.Random(7)
    for _ in range(50):
        workers, batches, tiles = draw.randint(1, 40), draw.randint(1, 200), draw.randint(1, 60)
        trace, focus, own = draw.uniform(1, 1e5), draw.uniform(1, 1e5), draw.uniform(0, 30)
        raw, image, scene = (draw.uniform(0, 1e9) for _ in range(3))
        plan = ClusterPlan(workers, trace, focus, batches, tiles, own, raw, image, scene, 1e8, 0.5)
        clock = own
        for parts, seconds in ((batches, trace), (tiles, focus)):
            busy = [clock] * workers
            for _ in range(parts):
                busy[busy.index(min(busy))] += seconds / parts
            clock = max(busy)
        moved = raw + image + sum(scene + raw for _ in range(workers))
        # tol: float rounding
        assert plan.seconds == pytest.approx(clock + moved / 1e8)
        assert plan.price == pytest.approx(0.5 * workers * plan.seconds / 3600)
        assert 0 < plan.efficiency <= 1


class ByTiles:
    """Makes the tool anew from what was pickled, and the tiles in a drawn order."""

    n_workers = 3

    def spread(self, make: Any, use: Any, tasks: Sequence[int]) -> Iterator[Any]:
        tool = pickle.loads(pickle.dumps(make))()
        for number in random.Random(5).sample(tasks, len(tasks)):
            yield use(tool, number)


@pytest.mark.parametrize("kind", ["slant", "ground"])
def test_tiles_of_workers_are_the_backprojection(kind: str) -> None:
    pytest.importorskip("distributed")
    from sarmitsuba.apps.cluster import SharedBackprojection

    few = {"azimuth_resolution": "2", "image_extent_azimuth": "40"}
    scene = scene_of("tower", few)
    radar, rng = scene.radar, np.random.default_rng(11)
    shape = (6, radar.track.n_pulses, radar.window.n_samples)  # more layers than share one launch
    data = rng.standard_normal((*shape, 2), dtype=np.float32).view(np.complex64)[..., 0]
    layers = tuple(Layer("VV", order) for order in range(1, 7))
    raw = RawData(data, layers, "compressed", radar, request=scene.image)
    grid = default_grid(raw, {"grid": kind, "extent_range": 40.0})
    window = parse_window("taylor")
    task = FocusTask(raw, grid, window, window, silent)
    workers: Any = ByTiles()
    shared = SharedBackprojection("kernel:4", workers=workers, tile_pixels=1500)
    alone = backproject(
        raw, grid, range_window=window, azimuth_window=window, interpolation="kernel:4", tile_pixels=1500
    )
    np.testing.assert_array_equal(shared.focus(task).pixels, alone)
    assert np.ptp(np.abs(alone)) > 0.0 and alone[0].size > 3 * 1500
    assert shared.options == Backprojection("kernel:4").options


def test_a_stranger_is_refused_by_the_cluster_of_this_machine() -> None:
    """Workers of this machine listen on the loopback address alone, to who holds the run's certificate; no pages."""
    import urllib.error
    import urllib.request

    import dask
    from distributed import Client
    from distributed.security import Security

    from sarmitsuba.apps.cluster import open_workers as started

    with started(ClusterAddress.parse("local:1")) as workers:
        address = workers.client.scheduler.address
        assert address.startswith("tls://127.0.0.1:")
        for stranger in (
            {"address": address.replace("tls://", "tcp://")},
            {"address": address, "security": Security.temporary()},
        ):
            with dask.config.set({"distributed.comm.timeouts.connect": "3s"}), pytest.raises(OSError):
                Client(**stranger)
        pages = workers.client.cluster.scheduler.http_server.port
        with pytest.raises(urllib.error.HTTPError, match="404"):
            urllib.request.urlopen(f"http://127.0.0.1:{pages}/info/main/workers.html")
        # workers import from their folder: nobody else may lay modules there, or move it
        (worker,) = workers.client.scheduler_info()["workers"].values()
        above = Path(worker["local_directory"]).relative_to(tempfile.gettempdir()).parts[0]
        assert stat.S_IMODE((Path(tempfile.gettempdir()) / above).stat().st_mode) == 0o700
