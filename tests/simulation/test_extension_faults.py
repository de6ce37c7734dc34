"""A fault in a user's stage, effect or scatterer is one line that names it: no traceback, no NaN."""

from collections.abc import Callable, Iterator, Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any, ClassVar

import numpy as np
import pytest

from sarmitsuba import PointTarget, RadarDescription, Scene, SceneMesh, build_scene, simulate
from sarmitsuba.core.errors import ExtensionError, RadarError, SarmitsubaWarning, SceneError
from sarmitsuba.core.registry import load_extension
from sarmitsuba.effects.context import SceneContext
from sarmitsuba.effects.effect import EFFECTS, Assessment, Decision, Effect
from sarmitsuba.loading.load import load_scene
from sarmitsuba.machine.backend import dr, mi
from sarmitsuba.radar.film import FilmDescription
from sarmitsuba.scene.scatterers import SCATTERERS, ScattererTarget
from sarmitsuba.simulation.execution.path_table import trace_paths
from sarmitsuba.simulation.execution.turntable import Aspects, rcs_sweep
from sarmitsuba.simulation.planning.pilot import plan_scene
from sarmitsuba.simulation.planning.prediction.prediction import explain
from sarmitsuba.tracing.kernel.stage import STAGES, Stage
from sarmitsuba.tracing.scatterers.reflectors.reflector import LocalWaves, Reflector
from tests.support.unweighted import render

PLATE = np.array([[-8.0, -8.0, 0.0], [8.0, -8.0, 0.0], [8.0, 8.0, 0.0], [-8.0, 8.0, 0.0]])
WALL = np.array([[-3.0, 2.0, 0.0], [3.0, 1.0, 0.0], [3.0, 1.0, 4.0], [-3.0, 2.0, 4.0]])
FACES = [[0, 1, 2], [0, 2, 3]]
RADAR = RadarDescription(
    slant_range=2e3, bandwidth=50e6, azimuth_resolution=6.0, aim_x=0.0, aim_y=0.0, aim_z=0.0
)
FILM = FilmDescription(image_extent_azimuth=16.0, image_extent_range=20.0)

pytestmark = pytest.mark.filterwarnings("ignore::sarmitsuba.core.errors.SarmitsubaWarning")


class Faulty(Effect):
    """Always on, with the flag of the stage."""

    name = "faulty"
    title = documentation = off_when = off_means = "a fault"
    rank = 150
    kernel_flags: ClassVar[Mapping[str, str]] = {"faulty": "a fault"}

    def assess(self, context: SceneContext, decided: Mapping[str, Decision]) -> Assessment:
        return Assessment(True, "always", error_db=0.0)

    def flags(self, on: bool, context: SceneContext, decided: Mapping[str, Decision]) -> Mapping[str, Any]:
        return {"faulty": on}


class FaultyStage(Stage):
    """One of the faults."""

    name = "faulty"

    def __init__(self, fault: str) -> None:
        self.fault = fault

    def at_hit(self, kernel: Any, lane: Any, ray: Any, hit: Any) -> Any:
        if self.fault == "at_hit raises":
            raise KeyError("fog")
        if self.fault == "at_hit returns nothing":
            return None
        if self.fault == "at_hit is not a number":
            lost = mi.Float(dr.nan)
            return replace(ray, fields=tuple((re * lost, im) for re, im in ray.fields))
        if self.fault == "numpy fields":
            return replace(ray, fields=tuple((np.float32(0.0), im) for _, im in ray.fields))
        if self.fault == "too few fields":
            return replace(ray, fields=())
        return ray

    def at_mirror(self, kernel: Any, properties: Any, cosine: mi.Float) -> Any:
        return mi.Float([1.0, 2.0, 3.0]) if self.fault == "wide mirror" else None

    def at_closing(self, kernel: Any, lane: Any, ray: Any, hit: Any, tube: Any, closing: Any) -> Any:
        if self.fault == "slant range is not a number":
            return replace(closing, slant_range=closing.slant_range * dr.nan)
        if self.fault == "wide factor":
            return replace(closing, factor=mi.Float(np.ones(7, np.float32)))
        return closing

    def at_echo(self, wavenumber: mi.Float, echo: Any) -> Any:
        if self.fault == "at_echo raises":
            raise ValueError("no such\nrain")
        if self.fault == "at_echo is not a number":
            return replace(echo, amplitudes=tuple(a * mi.Float(dr.nan) for a in echo.amplitudes))
        if self.fault == "number":
            return replace(echo, amplitudes=tuple(1.0 for _ in echo.amplitudes))
        if self.fault == "too few amplitudes":
            return replace(echo, amplitudes=())
        if self.fault == "leaves":
            raise SystemExit(3)
        if self.fault == "range rate is not a number":
            return replace(echo, range_rate=echo.range_rate + dr.nan)
        if self.fault == "dark":
            return replace(echo, amplitudes=tuple(0.0 * a for a in echo.amplitudes))
        return echo


class FaultyScatterer(Reflector):
    """One of the faults."""

    name = "faulty_kind"

    def __init__(self, fault: str) -> None:
        self.fault = fault

    def amplitude(self, waves: LocalWaves) -> Any:
        if self.fault == "raises":
            return waves.values["missing"]
        return "text" if self.fault == "text" else waves.co_polar * mi.Float(dr.nan)


@pytest.fixture
def register() -> Iterator[Callable[..., None]]:
    """Registers entries for one test."""
    taken = []

    def add(registry: Any, entry: Any) -> None:
        registry.register(entry)
        taken.append((registry, entry.name))

    yield add
    for registry, name in taken:
        del registry._entries[name]


def scene_of(*, kind: bool = False, points: bool = False) -> Scene:
    shapes = [SceneMesh(PLATE, FACES, "concrete", "ground"), SceneMesh(WALL, FACES, "pec", "wall")]
    more = [ScattererTarget("one", "faulty_kind", np.array([1.0, 0.0, 2.0]), np.eye(3), {})] if kind else []
    ideal = [PointTarget("point", np.array([2.0, -3.0, 0.5]), 1.0)] if points else []
    return build_scene(shapes, ideal, radar=RADAR, film=FILM, scatterers=more)


ASPECTS = Aspects(np.zeros(1), np.full(1, np.radians(50.0)))


@pytest.mark.parametrize(
    ("fault", "words"),
    [
        ("at_hit raises", r"at_hit: KeyError: 'fog' \(test_extension_faults.py, line \d+\)"),
        ("at_echo is not a number", "gives an echo that is not a finite number"),
        pytest.param(
            "at_hit returns nothing",
            "at_hit: TypeError: returns NoneType, not RayState",
            marks=pytest.mark.slow,
        ),
        pytest.param(
            "at_echo raises",
            r"at_echo: ValueError: no such rain \(test_extension_faults.py",
            marks=pytest.mark.slow,
        ),
        pytest.param(
            "at_hit is not a number", "gives an echo that is not a finite number", marks=pytest.mark.slow
        ),
    ],
)
def test_a_fault_of_a_stage_is_one_line(register: Callable[..., None], fault: str, words: str) -> None:
    register(EFFECTS, Faulty())
    register(STAGES, FaultyStage(fault))
    scene = scene_of(points="at_echo" in fault)
    text = rf"stage of the trace kernel 'faulty': {words}"
    for method in ("hybrid", "image"):
        with pytest.raises(ExtensionError, match=text):
            render(scene.replace(method=method))
    with pytest.raises(ExtensionError, match=text):
        trace_paths(scene)
    with pytest.raises(ExtensionError, match=text):
        rcs_sweep(scene, ASPECTS)
    assert np.isfinite(simulate(scene.replace(faulty="off")).data).all()


@pytest.mark.parametrize(
    ("fault", "words"),
    [
        ("numpy fields", r"at_hit: TypeError: fields\[0\]\[0\] is float32, not Vector3f"),
        ("too few fields", r"at_hit: ValueError: fields has 0 entries, not \d"),
        ("wide mirror", r"at_mirror: ValueError: the factor has 3 values; the kernel has \d+ lanes"),
        ("wide factor", r"at_closing: ValueError: factor has 7 values; the kernel has \d+ lanes"),
        ("number", r"at_echo: TypeError: amplitudes\[0\] is float, not Complex2f"),
        ("too few amplitudes", "at_echo: ValueError: amplitudes has 0 entries, not 1"),
        ("leaves", r"at_echo: SystemExit: 3 \(test_extension_faults.py, line \d+\)"),
        ("slant range is not a number", "gives an echo that is not a finite number"),
        ("range rate is not a number", "gives an echo that is not a finite number"),
    ],
)
def test_a_value_of_another_kind_is_named(register: Callable[..., None], fault: str, words: str) -> None:
    register(EFFECTS, Faulty())
    register(STAGES, FaultyStage(fault))
    with pytest.raises(ExtensionError, match=f"stage of the trace kernel 'faulty': {words}"):
        simulate(scene_of())


def test_echoes_without_amplitude_are_not_blamed_on_the_receive_window(register: Callable[..., None]) -> None:
    register(EFFECTS, Faulty())
    register(STAGES, FaultyStage("dark"))
    with pytest.raises(RadarError, match=r"every echo has the amplitude 0; check .* stages of extensions"):
        simulate(scene_of())


@pytest.mark.parametrize("registry", [EFFECTS, STAGES, SCATTERERS])
def test_an_entry_of_another_class_is_refused(registry: Any) -> None:
    for entry, found in ((object(), "an object of object"), (FaultyStage, "a class")):
        with pytest.raises(ExtensionError, match=f"^{registry.kind}: {found} is registered; give an object"):
            registry.register(entry)


def test_an_extension_that_fails_at_import_is_one_line(tmp_path: Path) -> None:
    path = tmp_path / "broken.py"
    path.write_text("x = 1\nx / 0\n")
    with pytest.raises(ExtensionError, match=r"ZeroDivisionError: division by zero \(broken.py, line 2\)$"):
        load_extension(str(path))


class Impatient(Faulty):
    """Asks about an effect that comes later."""

    def assess(self, context: SceneContext, decided: Mapping[str, Decision]) -> Assessment:
        return Assessment(decided["later"].on, "", 0.0)


class Silent(Faulty):
    """Decides nothing."""

    def assess(self, context: SceneContext, decided: Mapping[str, Decision]) -> Any:
        return None


@pytest.mark.parametrize(
    ("effect", "words"),
    [(Impatient(), "KeyError: 'later'"), (Silent(), "TypeError: returns NoneType, not Assessment")],
)
def test_a_fault_of_an_effect_is_one_line(register: Callable[..., None], effect: Effect, words: str) -> None:
    register(EFFECTS, effect)
    with pytest.raises(ExtensionError, match=f"effect 'faulty': assess: {words}"):
        simulate(scene_of())


@pytest.mark.parametrize(
    ("fault", "words"),
    [
        ("raises", "amplitude: KeyError: 'missing'"),
        ("text", "amplitude: TypeError: returns str, not Complex2f"),
        ("not a number", '.*amplitude of "one" is not a finite number'),
    ],
)
def test_a_fault_of_a_scatterer_is_one_line(register: Callable[..., None], fault: str, words: str) -> None:
    register(SCATTERERS, FaultyScatterer(fault))
    for method in ("hybrid", "raw"):
        with pytest.raises(ExtensionError, match=f"kind of scatterer ['\"]faulty_kind['\"]: {words}"):
            simulate(scene_of(kind=True).replace(method=method))


class StatedFrequencies(FaultyScatterer):
    """A kind that says at how many frequencies it is traced."""

    frequencies = 3


@pytest.mark.parametrize(
    ("kind", "words"),
    [
        (FaultyScatterer(""), "faulty_kind does not set `frequencies`; the default 2 is used"),
        (StatedFrequencies(""), "faulty_kind asks for 3 frequencies"),
    ],
)
def test_the_plan_says_who_set_the_frequencies(
    register: Callable[..., None], kind: Reflector, words: str
) -> None:
    register(SCATTERERS, kind)
    plan = plan_scene(scene_of(kind=True).replace(bandwidth=0.8e9), pilot=False)
    decision = plan.decision("wideband")
    assert decision is not None
    assert decision.why.startswith(words)


SCENE = """<scene version="3.0.0"><sensor type="sar_antenna"><film type="range_film"/></sensor>
<shape type="sphere">{shape}<bsdf type="{bsdf}"/></shape></scene>"""


@pytest.mark.parametrize("name", ["diffuse", "sphere", "to_world", "twosided", "point_scatterer"])
def test_a_kind_with_a_name_of_mitsuba_is_refused(
    register: Callable[..., None], tmp_path: Path, name: str
) -> None:
    register(SCATTERERS, type("Named", (FaultyScatterer,), {"name": name})(""))
    path = tmp_path / "scene.xml"
    path.write_text(SCENE.format(shape="", bsdf="diffuse"))
    with pytest.raises(
        ExtensionError, match=f"kind of scatterer '{name}': that is a name of .*; take another"
    ):
        load_scene(path)


def test_a_bsdf_or_radius_that_would_be_ignored_is_said(
    register: Callable[..., None], tmp_path: Path
) -> None:
    path = tmp_path / "scene.xml"
    path.write_text(SCENE.format(shape="", bsdf="faulty_kind"))
    with pytest.warns(SarmitsubaWarning, match=r'BSDF "faulty_kind" .*load the extension .*--extension FILE'):
        load_scene(path)
    register(SCATTERERS, FaultyScatterer(""))
    assert load_scene(path).scatterers[0].kind == "faulty_kind"
    path.write_text(SCENE.format(shape='<float name="radius" value="2"/>', bsdf="faulty_kind"))
    with pytest.raises(SceneError, match="gives its place and axes only; leave radius out"):
        load_scene(path)


def test_a_gridding_kernel_that_is_too_wide_is_refused() -> None:
    scene = scene_of()
    wide = replace(scene, settings=replace(scene.settings, gridding_width=10))
    with pytest.raises(RadarError, match=r"gridding_width = 10 is not within 1 \.\.\. 8; take 4"):
        simulate(wide)
    with pytest.raises(SceneError, match="gridding_width = 10 is above the bound 8"):
        scene.replace(gridding_width=10)


@pytest.mark.slow
def test_explain_does_not_try_what_is_switched_off(register: Callable[..., None]) -> None:
    class Counting(FaultyStage):
        calls = 0

        def at_hit(self, kernel: Any, lane: Any, ray: Any, hit: Any) -> Any:
            Counting.calls += 1
            return ray

    register(EFFECTS, Faulty())
    register(STAGES, Counting(""))
    explain(scene_of().replace(faulty="off"), measured=True)
    assert Counting.calls == 0
