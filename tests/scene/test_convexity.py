"""What is, and what is not, proven to be one convex body."""

import numpy as np
import pytest
import trimesh

from sarmitsuba.scene.mesh.convexity import is_convex_body


def body_of_revolution(top: np.ndarray, radius: np.ndarray, around: int) -> tuple[np.ndarray, np.ndarray]:
    """Closed: a bowl z = r^2 - 1 of ``radius``, from its rim to its pole, under a lid of heights ``top``."""
    angle = 2.0 * np.pi * np.arange(around) / around
    rings = [(r, r * r - 1.0) for r in radius[1:]] + [
        (r, z) for r, z in zip(radius[-2:0:-1], top[-2:0:-1], strict=True)
    ]
    v = [[0.0, 0.0, -1.0]]
    v += [[r * np.cos(a), r * np.sin(a), z] for r, z in rings for a in angle]
    v.append([0.0, 0.0, float(top[0])])
    f, n, last = [], around, len(v) - 1
    for i in range(n):
        j = (i + 1) % n
        f.append([0, 1 + j, 1 + i])
        for k in range(len(rings) - 1):
            a, b = 1 + k * n, 1 + (k + 1) * n
            f += [[a + i, a + j, b + i], [a + j, b + j, b + i]]
        f.append([1 + (len(rings) - 1) * n + i, 1 + (len(rings) - 1) * n + j, last])
    return np.array(v), np.array(f, dtype=np.int32)


def test_sphere_and_box() -> None:
    for mesh in (trimesh.creation.icosphere(subdivisions=4), trimesh.creation.box(extents=(1, 2, 3))):
        assert is_convex_body(np.asarray(mesh.vertices), np.asarray(mesh.faces, dtype=np.int32))


@pytest.mark.parametrize(("sag", "convex"), [(-0.05, True), (0.05, False), (0.002, False)])
def test_lids(sag: float, convex: bool) -> None:
    """A bowl under a bulging lid is convex, under a dish it is not, however shallow each of its edges."""
    radius = np.linspace(0.0, 1.0, 61)
    lid = sag * (radius**2 - 1.0)
    vertices, faces = body_of_revolution(lid, radius, 200)
    assert is_convex_body(vertices, faces) is convex


def test_two_bodies() -> None:
    a = trimesh.creation.icosphere(subdivisions=2)
    b = a.copy()
    b.apply_translation((3.0, 0.0, 0.0))
    both = trimesh.util.concatenate([a, b])
    assert not is_convex_body(np.asarray(both.vertices), np.asarray(both.faces, dtype=np.int32))
