"""Velocities of the points of a shape away from the start values, with other values of the same shape."""

from pathlib import Path

import numpy as np
import pytest

import sarmitsuba
from sarmitsuba.apps.fit.forward_model import ForwardModel
from sarmitsuba.apps.fit.parsing import parse
from sarmitsuba.core.arrays import F64

# a pyramid on a right-angled triangle: the box around it, and so the middle of its base, changes as it turns
CORNERS = "v 0 0 1\nv 4 0 1\nv 0 2 1\nv 1 1 4\nf 1 2 4\nf 2 3 4\nf 3 1 4\n"
SCENE = """<scene version="3.0.0">
    <integrator type="sar_path"><integer name="max_depth" value="1"/></integrator>
    <sensor type="sar_antenna">
        <float name="slant_range" value="2000"/>
        <float name="center_frequency" value="5e9"/>
        <float name="bandwidth" value="1e8"/>
        <integer name="n_pulses" value="4"/>
    </sensor>
    <shape type="obj" id="body">
        <string name="filename" value="body.obj"/>
        <bsdf type="radar_material" id="rough">
            <float name="permittivity_real" value="5"/>
            <string name="diffuse_law" value="lambert"/>
            <float name="diffuse_level_db" value="-10"/>
        </bsdf>
    </shape>
</scene>"""


@pytest.fixture(scope="module")
def scene(tmp_path_factory: pytest.TempPathFactory) -> sarmitsuba.Scene:
    folder: Path = tmp_path_factory.mktemp("body")
    (folder / "body.obj").write_text(CORNERS)
    (folder / "scene.xml").write_text(SCENE)
    return sarmitsuba.load_scene(folder / "scene.xml")


@pytest.mark.parametrize(
    ("parameters", "values"),
    [
        ("scale", [1.2]),
        ("rotation", [0.4]),
        ("height,scale", [3.5, 1.2]),
        ("scale,height", [1.2, 3.5]),
        ("rotation,scale", [0.4, 0.8]),
        ("scale,rotation,height", [1.1, -0.3, 2.5]),
    ],
)
def test_points_move_as_the_shape_does(scene: sarmitsuba.Scene, parameters: str, values: list[float]) -> None:
    """The derivative by a scale of 1.2 was 1.2 times what it is: that at 1, of the scaled shape."""
    words = ",".join(f"{kind}:body" for kind in parameters.split(","))
    model = ForwardModel(scene, parse(words, scene))
    at = np.array(values)

    def corners(values: F64) -> F64:
        geometry = model.at(values).geometry
        return geometry.vertices[geometry.faces]

    mesh = scene.geometry.face_mesh
    for k, parameter in enumerate(model.parameters):
        (move,) = model.moves(at).of(parameter, model.at(at), mesh)
        assert move.offset is not None and move.gradient is not None
        step = 1e-3 * np.eye(len(at))[k]
        expected = (corners(at + step) - corners(at - step)) / 2e-3
        # tol: the differences of a rotation by 1e-3 rad are off by 1e-6 / 6 of it
        np.testing.assert_allclose(move.offset + corners(at) @ move.gradient.T, expected, atol=1e-6)


@pytest.mark.slow  # kernels of derivatives, forwards and back
def test_data_at_another_scale(scene: sarmitsuba.Scene) -> None:
    """Derivative of raw data at a scale of 1.5 against differences of whole runs; the gradient is of the same data."""
    model = ForwardModel(scene, parse("scale:body", scene))
    at, step = np.array([1.5]), np.array([2e-4])
    expected = (model.data(at + step).astype(np.complex128) - model.data(at - step)) / 4e-4
    data, (plane,) = model.derivative(at)
    ratio = np.vdot(plane, expected) / np.vdot(plane, plane)
    # tol: single rays that move over edges of facets; it was 0.73
    assert abs(ratio - 1.0) < 0.15
    weights = np.asarray(1.0 / np.mean(np.abs(data) ** 2))
    loss = sarmitsuba.SquaredDifference(np.zeros(model.shape, dtype=np.complex64), weights)
    found = sarmitsuba.gradient(scene, "scale:body", loss, values=at).gradient
    # tol: float32 rounding of two sums
    assert found == pytest.approx(float(weights) * np.vdot(data, plane).real, rel=1e-3)


def test_other_shapes_do_not_count(scene: sarmitsuba.Scene) -> None:
    """A value at the start keeps its own displacement, to the bit."""
    model = ForwardModel(scene, parse("scale:body,gain", scene))
    at = np.array([1.0, 2.0])
    (move,) = model.moves(at).of(model.parameters[0], model.at(at), scene.geometry.face_mesh)
    (own,) = model.parameters[0].displacements(scene, scene.geometry.face_mesh)
    for field in ("gradient", "offset"):
        np.testing.assert_array_equal(getattr(move, field), getattr(own, field))
    assert move.turn_rate == own.turn_rate
