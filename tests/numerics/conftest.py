"""The table of hard cases: what every test of this folder measures, and `benchmarks/studies/numerics.py` prints."""

from collections.abc import Callable
from pathlib import Path
from types import ModuleType

import numpy as np
import pytest

from sarmitsuba.machine.backend import ensure_backend, mi
from sarmitsuba.scene.geometry import Geometry


@pytest.fixture
def row(record_property: Callable[[str, object], None]) -> Callable[..., None]:
    """Check one line of the table: our error within the bound, the naive way's beyond it.

    Arguments: case, our error, its bound, unit; ``naive`` the error of the naive way where the test measures it,
    and ``remedy``, what is done in its place. ``benchmarks/studies/numerics.py`` collects the lines.
    """

    def check(
        case: str,
        ours: float,
        bound: float,
        unit: str = "",
        *,
        naive: float | None = None,
        remedy: str = "",
    ) -> None:
        line = {"case": case, "ours": float(ours), "bound": float(bound), "unit": unit, "remedy": remedy}
        if naive is not None:
            line["naive"] = float(naive)
        record_property("numerics", line)
        print(f"\n{case}: naive {naive}, ours {ours:.3g}, bound {bound:g} {unit}")
        assert ours <= bound, f"{case}: {ours:g} {unit} is above {bound:g}"
        if naive is not None:
            assert not np.isfinite(naive) or naive > bound, (
                f"{case}: the naive way would do: {naive:g} {unit}"
            )

    return check


@pytest.fixture
def plain_scene() -> Callable[..., "mi.Scene"]:
    """Geometry -> scene of one mesh, faces as listed, as Mitsuba sets it up by itself: the naive way's."""
    ensure_backend()

    def build(target: Geometry, *, robust: bool = False) -> "mi.Scene":
        n = target.n_faces
        mesh = mi.Mesh("target", 3 * n, n)
        params = mi.traverse(mesh)
        params["vertex_positions"] = mi.Float(target.vertices[target.faces].ravel().astype(np.float32))
        params["faces"] = mi.UInt32(np.arange(3 * n, dtype=np.uint32))
        params.update()
        return mi.load_dict({"type": "scene", "embree_use_robust_intersections": robust, "mesh": mesh})

    return build


@pytest.fixture(scope="session")
def hostile(benchmark_script: Callable[[str], ModuleType]) -> ModuleType:
    """benchmarks/studies/hostile.py, whose drawn files a part of the tests reads."""
    return benchmark_script("hostile")


@pytest.fixture(scope="session")
def samples(hostile: ModuleType, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Folder of sound files of every kind that hostile ones are drawn from; no test changes them."""
    folder = tmp_path_factory.mktemp("samples")
    hostile.make_samples(folder)
    return folder
