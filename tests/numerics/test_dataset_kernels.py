"""Samples of one recipe share their kernels: nothing is compiled after the first tens."""

from collections.abc import Iterator
from pathlib import Path

import pytest

from sarmitsuba.apps.dataset_draw import Drawer
from sarmitsuba.apps.dataset_sample import make_sample
from sarmitsuba.machine.backend import dr, ensure_backend

RECIPE = """
[dataset]
samples = 100
seed = 2
[images]
pixels_azimuth = 48
pixels_range = 48
[labels]
layers = "shape"
[objects]
heading_deg = {{ uniform = [0, 360] }}
spread = 6.0
[clutter]
count = {{ uniform = [0, 2] }}
spread = 12.0
[ground]
material = {{ choice = ["soil", "grass"] }}
[radar]
look_angle_deg = {{ uniform = [35, 55] }}
heading_deg = {{ uniform = [0, 360] }}
slant_range = {{ uniform = [4000, 9000] }}
azimuth_resolution = {{ uniform = [0.8, 1.2] }}
bandwidth = {{ uniform = [180e6, 220e6] }}
[tracing]
method = "{method}"
"""


@pytest.fixture
def history() -> Iterator[None]:
    import drjit

    ensure_backend()
    flag = drjit.JitFlag.KernelHistory
    before = dr.flag(flag)
    dr.set_flag(flag, True)
    yield
    dr.set_flag(flag, before)


# tests/apps/test_dataset_recipes.py and tests/commands/test_dataset.py hold the code but for its kernels
@pytest.mark.slow
@pytest.mark.parametrize("method", ["raster", "image", "hybrid"])
def test_no_kernel_is_compiled_after_the_first_tens(method: str, history: None, tmp_path: Path) -> None:
    path = tmp_path / "r.toml"
    path.write_text(RECIPE.format(method=method))
    drawer, known = Drawer.of(str(path)), set()
    for number in range(30):
        dr.kernel_history_clear()
        make_sample(drawer, number)
        found = {str(k["hash"]) for k in dr.kernel_history([dr.KernelType.JIT])}
        assert number < 20 or found <= known, number
        known |= found
    assert known
