"""Drawn metal boxes in triangles that do not match, against the physical-optics integral over these triangles."""

import numpy as np
import pytest
import scipy

from sarmitsuba.loading.build import SceneMesh, build_scene
from sarmitsuba.radar.description import RadarDescription
from sarmitsuba.scene.settings import TraceSettings
from sarmitsuba.simulation.execution.turntable import Aspects, rcs_sweep

WAVELENGTH = 0.03
C0 = 299792458.0


def physical_optics(triangles: np.ndarray, towards: np.ndarray) -> np.ndarray:
    """Moduli of the root of the RCS of lit triangles, m, in directions (n, 3), by Gauss-Legendre quadrature."""
    k = 2.0 * np.pi / WAVELENGTH
    first, second = triangles[:, 1] - triangles[:, 0], triangles[:, 2] - triangles[:, 0]
    twice = np.cross(first, second)
    out = np.zeros(len(towards), dtype=complex)
    for n, u in enumerate(towards):
        for corner, a, b, area in zip(triangles[:, 0], first, second, twice, strict=True):
            if area @ u <= 0.0:
                continue
            rate = 2.0 * k * np.array([a @ u, b @ u])
            x, w = np.polynomial.legendre.leggauss(24 + int(np.abs(rate).sum() / 1.2))
            x, w = 0.5 * (x + 1.0), 0.5 * w
            s, t = x[:, None], x * (1.0 - x[:, None])
            weight = w[:, None] * w * (1.0 - x[:, None])
            phase = np.exp(1j * (rate[0] * s + rate[1] * t))
            out[n] += (area @ u) * np.exp(2j * k * (corner @ u)) * (weight * phase).sum()
    return np.abs(k / np.sqrt(np.pi) * out)


def drawn_box(rng: np.random.Generator, noise: float) -> list[tuple[np.ndarray, np.ndarray]]:
    """Vertices, noisy, and outward faces of the six sides of a turned box, each in triangles of its own."""
    size = rng.uniform(0.1, 0.25, 3)
    turn = scipy.spatial.transform.Rotation.random(random_state=int(rng.integers(1 << 30))).as_matrix()
    parts = []
    for axis in range(3):
        for low in (-0.5, 0.5):
            n = rng.integers(1, 4, 4)
            on = [np.column_stack([rng.random(n[k]), np.full(n[k], k % 2)]) for k in range(4)]
            on = [side if k < 2 else side[:, ::-1] for k, side in enumerate(on)]
            plane = np.concatenate([[[0, 0], [0, 1], [1, 0], [1, 1]], *on, rng.random((2, 2))])
            # a vertex close to a side: slivers, whose normals are noise
            plane = np.concatenate([plane, [[rng.random(), 0.003]]]) - 0.5
            faces = scipy.spatial.Delaunay(plane).simplices
            vertices = np.insert(plane, axis, low, axis=1) * size
            corners = vertices[faces]
            area = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
            inward = area[:, axis] * low < 0.0
            faces[inward] = faces[inward, ::-1]
            parts.append((vertices @ turn.T + noise * rng.uniform(-1.0, 1.0, vertices.shape), faces))
    return parts


def compared(seed: int, noise: float, middle: np.ndarray, *, twice: bool = False) -> tuple[float, float]:
    """Error of the amplitudes of nine aspects, dB, and the error that the sweep states."""
    rng = np.random.default_rng(seed)
    parts = drawn_box(rng, noise * WAVELENGTH)
    azimuth, elevation = (
        np.radians(rng.uniform(0, 360) + np.linspace(0, 40, 9)),
        np.radians(rng.uniform(10, 60)),
    )
    meshes = [
        SceneMesh(vertices + middle, faces, "pec", name=f"{i} {j}")
        for i, (vertices, faces) in enumerate(parts)
        for j in range(2 if twice and i % 2 else 1)
    ]
    radar = RadarDescription(
        center_frequency=C0 / WAVELENGTH, polarisation="HH", slant_range=2000, bandwidth=1e8
    )
    settings = TraceSettings(effects={"edge_diffraction": "off"}, max_depth=1)
    swept = rcs_sweep(
        build_scene(meshes, radar=radar, settings=settings), Aspects(azimuth, np.full(9, elevation))
    )
    towards = np.stack(
        [
            np.cos(elevation) * np.cos(azimuth),
            np.cos(elevation) * np.sin(azimuth),
            np.full(9, np.sin(elevation)),
        ],
        axis=1,
    )
    expected = physical_optics(np.concatenate([vertices[faces] for vertices, faces in parts]), towards)
    found = np.abs(swept.result.amplitude.sum(axis=1)[:, 0])
    error = float(20.0 * np.log10(np.linalg.norm(found - expected) / np.linalg.norm(expected)))
    stated = float(np.max(swept.error_db))
    print(f"seed {seed}, noise {noise:g} wavelengths: error {error:.1f} dB, stated {stated:.1f} dB")
    return error, stated


# tol: rays that hit a neighbour within the noise of an edge, and the noise itself, 4 pi of it in phase
LIMITS = {0.0: -35.0, 1e-8: -35.0, 1e-6: -35.0, 3e-5: -35.0, 3e-4: -27.0, 1e-3: -20.0}


def own_error(noise: float) -> float:
    """Error, dB, of the noise's own phase and of float32, which no sampling error states."""
    return float(20.0 * np.log10(4.0 * np.pi * noise + 1e-4))


@pytest.mark.filterwarnings("ignore::sarmitsuba.core.errors.SarmitsubaWarning")
@pytest.mark.parametrize(("seed", "noise"), [(0, 3e-5)])
def test_noise_of_vertices(seed: int, noise: float) -> None:
    error, stated = compared(seed, noise, np.zeros(3))
    assert error < min(LIMITS[noise], max(stated + 3.0, own_error(noise)))


@pytest.mark.slow
@pytest.mark.filterwarnings("ignore::sarmitsuba.core.errors.SarmitsubaWarning")
@pytest.mark.parametrize("seed", range(1, 5))
@pytest.mark.parametrize("noise", sorted(LIMITS))
def test_noise_of_vertices_drawn(seed: int, noise: float) -> None:
    test_noise_of_vertices(seed, noise)


@pytest.mark.slow
@pytest.mark.filterwarnings("ignore::sarmitsuba.core.errors.SarmitsubaWarning")
@pytest.mark.parametrize("seed", range(5, 8))
def test_faces_given_twice_and_far_from_the_origin(seed: int) -> None:
    error, stated = compared(seed, 0.0, np.array([2600.0, -3100.0, 20.0]), twice=True)
    assert error < min(LIMITS[0.0], max(stated + 3.0, own_error(0.0)))
