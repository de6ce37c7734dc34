"""Meshes and tables of the bodies that were measured."""

import numpy as np
import pytest
import trimesh
from scipy.integrate import quad

from sarmitsuba.core.errors import DataError
from sarmitsuba.truth.validation.measured import bodies
from sarmitsuba.truth.validation.measured.azimuth_tables import FOLDER, azimuth_table


def solid(mesh: bodies.Mesh) -> trimesh.Trimesh:
    body = trimesh.Trimesh(*mesh, process=False)
    assert body.is_watertight and body.is_winding_consistent and body.volume > 0.0
    assert (body.area_faces > 0.0).all()
    return body


def test_almond_has_the_volume_and_ends_of_its_formula() -> None:
    d = bodies.ALMOND_LENGTH

    def section(t: float) -> float:
        if t < 0.0:
            b = 0.193333 * np.sqrt(1.0 - (t / 0.416667) ** 2)
        else:
            b = 4.83345 * (np.sqrt(1.0 - (t / 2.08335) ** 2) - 0.96)
        return float(np.pi * b * b / 3.0)

    exact = d**3 * (quad(section, -0.416667, 0.0)[0] + quad(section, 0.0, 0.583333)[0])
    almond = solid(bodies.almond())
    # tol: facets inscribed in 96 around: 2 pi^2 / (3 96^2) = 0.07 %, and 20 rings of the round end
    assert almond.volume == pytest.approx(exact, rel=2e-3)
    # tol: the two halves of the formula differ by 5e-6 of the length where they meet
    assert np.allclose(np.ptp(almond.vertices, axis=0) / d, [1.0, 2 * 0.193333, 2 * 0.064444], atol=2e-5)
    assert almond.vertices[almond.vertices[:, 0].argmax()] == pytest.approx([0.583333 * d, 0.0, 0.0])


def test_boxes_and_the_duct_have_their_volumes() -> None:
    assert solid(bodies.thick_plate()).volume == pytest.approx(0.2667 * 0.1524 * 1.6256e-3)
    prism, duct = solid(bodies.prism()), solid(bodies.duct())
    assert prism.volume == pytest.approx(0.13 * (0.4 * 0.32 - 0.108**2))
    # surface of the suite's own model; tol: its curved walls of 1000 pieces are drawn by 119
    assert duct.area == pytest.approx(0.565313, rel=1e-4)
    assert np.array_equal(duct.bounds, prism.bounds)
    # the opening is 110 mm x 84 mm
    front = duct.triangles_center[:, 0] > 0.2 - 1e-9
    assert duct.area_faces[front].sum() == pytest.approx(0.13 * 0.104 - 0.11 * 0.084)


def test_tables_hold_solver_and_chamber_at_the_same_azimuths() -> None:
    table = azimuth_table("III_A_s1", 7e9, "VV")
    assert np.array_equal(table.azimuth, np.arange(0.0, 180.25, 0.5))
    assert table.solver.max() == -24.2807
    assert np.isfinite(table.chamber).all()
    assert np.isnan(azimuth_table("II_A_sx1", 2.56e9, "HH").chamber).all()
    with pytest.raises(DataError, match="no integral_equation curve of HH at 1e"):
        azimuth_table("III_A_s1", 1e9, "HH")
    assert "above copyright notice" in (FOLDER / "LICENSE-AustinRCSBenchmarks.txt").read_text(
        encoding="utf-8"
    )
