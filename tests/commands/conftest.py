"""Stand-ins for loading, simulating and focusing, so that the command line is tested without them."""

import sys
import types
import warnings
from typing import Any

import numpy as np
import pytest

from sarmitsuba.core.errors import SarmitsubaWarning
from sarmitsuba.radar.antenna import Antenna, Pointing
from sarmitsuba.radar.image_request import ImageRequest
from sarmitsuba.radar.radar import Radar, ReceiveWindow
from sarmitsuba.radar.track import Track
from sarmitsuba.radar.waveform import Waveform
from sarmitsuba.scene.geometry import Geometry
from sarmitsuba.scene.scene import Scene
from sarmitsuba.scene.settings import TraceSettings
from sarmitsuba.signal.image import ImageGrid, SarImage
from sarmitsuba.signal.raw_data import Layer, RawData
from sarmitsuba.simulation.planning.prediction.needs import Needs


def make_scene() -> Scene:
    n = 4
    triad = np.broadcast_to(np.eye(3), (n, 3, 3))
    radar = Radar(
        "stripmap",
        Track.straight([-5e3, 0.0, 5e3], [0.0, 100.0, 0.0], 200.0, n),
        Waveform(1e10, 1e8, 1e-6),
        Antenna(),
        Pointing(triad[:, 0].copy(), triad[:, 1].copy(), triad[:, 2].copy()),
        ReceiveWindow(np.full(n, 7.0615e3), 1.2, 16),
    )
    settings = TraceSettings(seed=3, keep_orders=True)
    asked = ImageRequest(extent_azimuth=20.0, extent_range=20.0)
    return Scene("fake", None, Geometry.empty(), (), (), radar, settings, asked, notes=("a note",))


class FakeNeeds(Needs):
    @property
    def elapsed(self) -> dict[str, float]:
        return dict(self.seconds)

    def __str__(self) -> str:
        return "expected: little"


def fake_execute(scene: Scene, options: Any, *, progress: Any, ready: Any, **kept: Any) -> Any:
    needs = FakeNeeds("box", "raw", 1, (8, 8), 2, {"image": 1}, {"image": 1}, {"trace": 2.0, "focus": 1.0})
    plan = types.SimpleNamespace(summary=lambda: "max_depth 2")
    ready(types.SimpleNamespace(needs=lambda: needs, plan=plan, finished=None, scene=scene))
    progress("trace", 1, 2, {"rays/s": 1e6})
    warnings.warn("the beam misses a corner", SarmitsubaWarning, stacklevel=2)
    warnings.warn("the beam misses a corner", SarmitsubaWarning, stacklevel=2)
    rng = np.random.default_rng(scene.settings.seed)
    layers = (Layer("VV", 1), Layer("VV", 2))
    data = rng.normal(size=(2, 4, 16)).astype(np.complex64)
    metadata = {"scene": scene.name, "plan": "max_depth 2", "method": scene.settings.method}
    raw = RawData(data, layers, "compressed", scene.radar, metadata, scene.image)
    return types.SimpleNamespace(raw=raw, image=None, refinement=None)


def fake_focus(raw: RawData, grid: Any = None, **options: Any) -> SarImage:
    axes = (np.array([0.0, 1.0, 0.0]), np.array([1.0, 0.0, 0.0]))
    grid = ImageGrid("slant", np.arange(4.0), 7e3 + np.arange(16.0), np.array([0.0, 0.0, 5e3]), *axes)
    return SarImage(raw.data, raw.layers, grid, 0.03, 1.0, 1.0, np.full(16, 0.7), dict(raw.metadata))


def install_fakes(monkeypatch: pytest.MonkeyPatch) -> dict[str, Any]:
    """Replace loading, simulating and focusing; the dictionary receives the loader's arguments."""
    seen: dict[str, Any] = {}

    def load_scene(path: str, *, radar: Any = None, parameters: Any = None, **how: object) -> Scene:
        seen.update(path=path, radar=radar, parameters=parameters)
        return make_scene()

    def module(name: str, **content: Any) -> None:
        fake = types.ModuleType(name)
        vars(fake).update(content)
        monkeypatch.setitem(sys.modules, name, fake)

    backend = types.SimpleNamespace(variant="none")
    monkeypatch.setattr("sarmitsuba.machine.backend.ensure_backend", lambda: backend)
    module("sarmitsuba.loading.load", load_scene=load_scene)
    monkeypatch.setattr("sarmitsuba.simulation.execution.render.execute", fake_execute)
    monkeypatch.setattr("sarmitsuba.signal.focusing.focus", fake_focus)
    return seen


@pytest.fixture
def fake_stages(monkeypatch: pytest.MonkeyPatch) -> dict[str, Any]:
    return install_fakes(monkeypatch)


@pytest.fixture
def simulations(fake_stages: dict[str, Any], monkeypatch: pytest.MonkeyPatch) -> list[Scene]:
    """Scenes that were simulated, one entry a run."""
    runs: list[Scene] = []

    def execute(scene: Scene, options: Any, **how: Any) -> Any:
        runs.append(scene)
        return fake_execute(scene, options, **how)

    monkeypatch.setattr("sarmitsuba.simulation.execution.render.execute", execute)
    return runs
