"""Derivatives by what moves in front of others: against means over lattices of whole runs."""

from __future__ import annotations

import numpy as np
import pytest

from sarmitsuba.apps.fit.forward_model import ForwardModel
from sarmitsuba.apps.fit.parsing import parse
from sarmitsuba.scene.mesh.facet_edges import FacetEdges
from tests.support.differences import drawn, relative
from tests.support.occluders import (
    SIDEWAYS,
    EdgeModel,
    displacements,
    edge_share,
    half_hidden_corner,
    hidden_wall,
)

# scenes, the parameter, its step (None: usual) and what is special
FAST = (
    (11, "height:body", None, {}),
    (13, "shift:body:x", None, {"method": "raw", "pulses": 2}),
    (15, "height:body", None, {"polarisation": "HH", "rough": True}),
)
SLOW = (
    *((seed, "height:body", None, {}) for seed in range(31, 36)),
    *((seed, "shift:body:x", None, {}) for seed in range(41, 46)),
    *((seed, "shift:body:y", SIDEWAYS, {}) for seed in range(51, 56)),
    *((seed, "scale:body", None, {}) for seed in range(61, 64)),
    *((seed, "rotation:body", None, {}) for seed in range(71, 74)),
)


@pytest.mark.parametrize(("seed", "parameter", "step", "given"), FAST)
def test_what_a_body_hides_is_in_the_derivative(
    seed: int, parameter: str, step: float | None, given: dict[str, object]
) -> None:
    found = edge_share(hidden_wall(seed, **given), parameter, 4, step)  # type: ignore[arg-type]
    assert found.without > 0.9  # it hides, and returns nothing itself
    # tol: lattices end within the body's edges, in the mean of four; the step
    assert found.found < 0.08 + 3.0 * found.noise


@pytest.mark.parametrize(("place", "beyond"), [(-1.3, False), (-1.3, True), (1.7, False), (1.7, True)])
def test_a_screen_before_a_corner_hides_every_path_once(place: float, beyond: bool) -> None:
    r"""All three legs of a double bounce are beside the edge of a tall screen, in one plane with the antenna.

    The return of the corner is that of its lit length, :math:`E = \int f e^{-2 j k R(y)} dy` with the distance R of the
    fold, and its derivative by the place of the edge the integrand there.
    """
    scene, sign = half_hidden_corner(place, beyond=beyond)
    model = EdgeModel.of(scene, "shift:body:y")
    (edges,) = model.beside_edges(model.placed(), displacements(model))
    data = np.zeros(model.shape[2], dtype=np.complex128)
    for k in range(4):
        model.rays = model.run.rays(model.sampling, k)
        data += 0.25 * model.data()[0, 0]
    sample = int(np.abs(data).argmax())
    away, k = scene.radar.track.center_position, 2.0 * np.pi / scene.radar.waveform.wavelength
    across = np.linspace(-3.0, place, 4001) if beyond else np.linspace(place, 3.0, 4001)
    distance = np.sqrt(away[0] ** 2 + (across - sign * away[1]) ** 2 + away[2] ** 2)
    lit = np.trapezoid(np.exp(-2j * k * distance), across)
    at = np.exp(-2j * k * distance[-1 if beyond else 0]) * (1.0 if beyond else -1.0)
    # tol: lattices end within the screen's edge, in the mean of four; single bounces from the facets' outlines
    assert abs(sign * edges[0, 0, sample] / data[sample] * lit / at - 1.0) < 0.03


@pytest.mark.slow
@pytest.mark.parametrize(("seed", "parameter", "step", "given"), SLOW)
def test_what_bodies_hide_is_in_the_derivative_in_the_mean_of_many_lattices(
    seed: int, parameter: str, step: float | None, given: dict[str, object]
) -> None:
    found = edge_share(hidden_wall(seed, **given), parameter, 40, step)  # type: ignore[arg-type]
    # tol: the step; noise of the reference
    assert found.found < 0.05 + 3.0 * found.noise


def test_a_lone_shape_hides_nothing_and_its_outline_moves_with_it() -> None:
    scene = drawn(3, "alone")
    model = ForwardModel(scene, parse("shift:box:x,rotation:box", scene))
    _, planes = model.derivative()
    edges_of = model.beside_edges(model.placed(), displacements(model))
    # tol: float32 velocities of edges; scatterers a ray spacing beside a point of an edge turn with another velocity
    for plane, edges, most in zip(planes, edges_of, (1e-5, 1e-3), strict=True):
        assert relative(plane - edges, plane.astype(np.complex128)) < most


def test_edges_of_a_box_are_twelve_and_of_a_round_body_its_outline() -> None:
    corners = np.array([[i, j, k] for k in (0, 1) for j in (0, 1) for i in (0, 1)], dtype=np.float64)
    quads = [(0, 2, 3, 1), (4, 5, 7, 6), (0, 1, 5, 4), (2, 6, 7, 3), (0, 4, 6, 2), (1, 3, 7, 5)]
    triangles = corners[[t for a, b, c, d in quads for t in ((a, b, c), (a, c, d))]]
    box = FacetEdges.of(triangles)
    assert len(box.start) == 12
    assert box.seen(np.array([50.0, 30.0, 40.0])).all()
    import trimesh

    ball = trimesh.creation.icosphere(3)
    edges = FacetEdges.of(np.asarray(ball.triangles, dtype=np.float64))
    assert len(edges.start) == len(ball.edges_unique)
    antenna = np.array([0.0, 1e4, 1e4])
    outline = edges.seen(antenna)
    middle = 0.5 * (edges.start + edges.end)[outline]
    # tol: facets of ten degrees
    assert 0 < outline.sum() < 0.1 * len(outline)
    assert np.abs(middle @ antenna / np.linalg.norm(antenna)).max() < 0.2
