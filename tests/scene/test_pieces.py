"""How far apart rays may lie on pieces of surface."""

import numpy as np
import pytest
import trimesh

from sarmitsuba.scene.mesh.pieces import LEAST_SLANT, ROUND_RAYS, SLANTED, round_needs, slant_factor
from sarmitsuba.scene.mesh.topology import weld


def test_slanted_pieces_keep_their_rays() -> None:
    square = np.array([[[0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0]]])
    for cosine in (0.9, SLANTED, 0.5 * SLANTED, 0.03, 1e-4):
        antenna = 1e6 * np.array([np.sqrt(1.0 - cosine**2), 0.0, cosine])
        for side in (1.0, -1.0):
            factor = slant_factor(square, antenna * [1.0, 1.0, side])[0]
            # rays that meet it go with the cosine over the square of their distance
            rays = cosine / factor**2
            least = SLANTED if cosine > LEAST_SLANT else SLANTED * cosine / LEAST_SLANT
            # tol: 1e6 m are not infinitely far
            assert rays == pytest.approx(max(cosine, least), rel=1e-3)


def test_sides_and_ends_of_a_small_cylinder_are_round() -> None:
    rod = trimesh.creation.cylinder(1.0, 4.0, sections=90)
    box = trimesh.creation.box(
        (3.0, 3.0, 3.0), transform=trimesh.transformations.translation_matrix((9, 0, 0))
    )
    corners = np.concatenate([rod.triangles, box.triangles])
    normal = np.concatenate([rod.face_normals, box.face_normals])
    side = np.zeros(len(corners), dtype=bool)
    side[: len(rod.triangles)] = np.abs(rod.face_normals[:, 2]) < 0.5
    # flat facets: by their planes
    planes = np.round(np.column_stack([normal, np.einsum("ti,ti->t", normal, corners[:, 0])]), 6)
    part = np.unique(planes, axis=0, return_inverse=True)[1].reshape(-1)
    vertex = weld(corners.reshape(-1, 3))
    rod_faces = np.arange(len(corners)) < len(rod.triangles)
    assert (np.isfinite(round_needs(corners, vertex, part, side, 0.2)) == rod_faces).all()
    # the side alone has 8 pi m^2, an end pi m^2: short waves want more rays than there may be
    for area, found in ((8.0 * np.pi, rod_faces & ~side), (2.0 * np.pi, np.zeros_like(side))):
        wavelength = 9.0 * np.sqrt(0.24 * area / ROUND_RAYS)
        assert (np.isfinite(round_needs(corners, vertex, part, side, wavelength)) == found).all()


def test_smaller_round_bodies_get_finer_rays() -> None:
    ball = trimesh.creation.icosphere(subdivisions=3, radius=1.0)
    corners = np.asarray(ball.triangles)
    vertex, part, bent = weld(corners.reshape(-1, 3)), np.arange(len(corners)), np.ones(len(corners), bool)
    for wavelengths, per_wavelength in ((1.4, 36.0), (1.6, 18.0), (5.9, 18.0), (6.2, 9.0), (24.0, 9.0)):
        need = round_needs(corners, vertex, part, bent, 1.0 / wavelengths)
        assert np.allclose(need * wavelengths * per_wavelength, 1.0)
    assert np.isinf(round_needs(corners, vertex, part, bent, 1.0 / 24.6)).all()
