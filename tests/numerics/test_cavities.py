"""Parallel plates and cavities: a hundred bounces, energy that never grows, sums that converge."""

import numpy as np
import pytest

from sarmitsuba.core.constants import SPEED_OF_LIGHT
from sarmitsuba.machine.backend import dr, ensure_backend, mi
from sarmitsuba.scene.materials.material import Material
from sarmitsuba.simulation.execution.rcs import monostatic_rcs
from sarmitsuba.tracing.kernel import field
from sarmitsuba.tracing.kernel.launch import LaunchFrame
from sarmitsuba.truth.validation.targets import PEC, geometry, parallelogram
from tests.support.paths import record_paths, square_grid

FREQUENCY = 9.65e9
WAVELENGTH = SPEED_OF_LIGHT / FREQUENCY
CONCRETE = Material("concrete", permittivity=5.24 - 0.5j)


@pytest.mark.parametrize("material", [PEC[0], CONCRETE], ids=["metal", "concrete"])
def test_between_parallel_plates(row, material: Material) -> None:
    """A ray that runs 100 times between two plates, past the antenna between them, exactly along the vertical.

    Every order's amplitude is 2 sqrt(pi) / lambda times the tube's footprint over both legs, times the reflection
    coefficient once a bounce; its slant range grows by the plates' distance.

    Naive ways: H = u x z / |u x z| of a ray along z is 0 / 0, the table's nan; a shadow ray without an end finds the
    plate behind the antenna and hides all but the first bounce.
    """
    gap, size, at = 0.7391, 50.0, 0.2117
    scene = geometry(
        [parallelogram([-size / 2, -size / 2, z], [size, 0, 0], [0, size, 0]) for z in (0.0, gap)]
    )
    antenna = np.array([0.0, 0.0, at])
    start = 0.1  # m from the antenna to the launch plane
    frame = LaunchFrame(
        (antenna + np.array([0, 0, start]))[None], np.array([[1.0, 0.0, 0.0]]), np.array([[0.0, 1.0, 0.0]])
    )
    grid = square_grid(1e-9, 1e-9, 1e-4)
    assert grid.n_rays == 1
    n = np.arange(100)
    paths = record_paths(scene, (material,), antenna, frame, grid, FREQUENCY, max_depth=100)
    assert paths.seen.all() and paths.hits[0] == 100
    back = np.where(n % 2 == 0, gap - at, at)
    length = (gap - at) + n * gap
    error = (paths.slant_range[:, 0] - 0.5 * (length + back)) * 4.0 * np.pi / WAVELENGTH
    field_at_hit = (
        np.abs(paths.amplitude[:, 0])
        / (2.0 * np.sqrt(np.pi) / WAVELENGTH * (grid.spacing / start) ** 2)
        * back
        / length
    )
    r = (
        1.0
        if material.pec
        else abs((1 - np.sqrt(material.permittivity)) / (1 + np.sqrt(material.permittivity)))
    )
    decay = field_at_hit / r ** (n + 1)
    name = material.name.replace("pec", "metal")
    # the last bounces off concrete are 1e-40 of the first: below float32
    across = np.cross([0.0, 0.0, 1.0], [0.0, 0.0, 1.0])
    with np.errstate(invalid="ignore"):
        naive = float((across / np.linalg.norm(across))[0])
    row(
        f"100 bounces between {name} plates: field",
        float(np.abs(decay[: 100 if r == 1 else 60] - 1).max()),
        1e-4,
        naive=naive,
        remedy="another axis where the line of sight is vertical; shadow rays end at the antenna",
    )
    row(f"100 bounces between {name} plates: phase", float(np.degrees(np.abs(error).max())), 1e-3, "deg")
    assert (np.diff(field_at_hit) <= 1e-6).all()  # tol: float32; never grows


def test_reflections_never_add_energy(row) -> None:
    """10 000 fields reflected 100 times off random surfaces, float32: their power against the first.

    Naive way: unit vectors that are not made unit again: d - 2 (d . n) n drifts off length with every bounce.
    """
    ensure_backend()
    rng = np.random.default_rng(4)
    m = 10_000

    def vectors() -> np.ndarray:
        v = rng.normal(size=(3, m))
        return np.ascontiguousarray((v / np.linalg.norm(v, axis=0)).astype(np.float32))

    growth = {}
    for name, chi in (("metal", None), ("lossless", 4.24 + 0j), ("lossy", 4.24 - 0.5j)):
        d = mi.Vector3f(vectors())
        x = mi.Vector3f(vectors())
        y = mi.Vector3f(vectors())
        e = (x - d * dr.dot(x, d), y - d * dr.dot(y, d))
        first = dr.squared_norm(e[0]) + dr.squared_norm(e[1])
        top = np.zeros(m)
        for _ in range(100):
            n = mi.Vector3f(vectors())
            n = dr.select(dr.dot(d, n) > 0, -n, n)
            d_out = dr.normalize(d - n * (2.0 * dr.dot(d, n)))
            if chi is None:
                e = field.reflect_field_pec(e, n)
            else:
                h = field.incidence_basis(d, n)
                te, tm = field.fresnel(-dr.dot(d, n), mi.Complex2f(chi))
                e = field.reflect_field(e, d, d_out, h, te, tm)
            d = d_out
            dr.eval(e, d)
            top = np.maximum(top, ((dr.squared_norm(e[0]) + dr.squared_norm(e[1])) / first).numpy())
        growth[name] = float(top.max() - 1.0)
    # tol: rounding of the normals' length, 6e-8 a bounce
    row("power after up to 100 reflections off metal: growth", growth["metal"], 2e-5)
    row("the same off dielectrics", max(growth["lossless"], growth["lossy"], 0.0), 2e-5)


def box(width: float, depth: float) -> list[tuple[np.ndarray, np.ndarray]]:
    """Box open at its top."""
    a, b = width / 2, depth
    return [
        parallelogram([-a, -a, 0], [width, 0, 0], [0, width, 0]),
        parallelogram([-a, -a, 0], [width, 0, 0], [0, 0, b]),
        parallelogram([-a, a, 0], [width, 0, 0], [0, 0, b]),
        parallelogram([-a, -a, 0], [0, width, 0], [0, 0, b]),
        parallelogram([a, -a, 0], [0, width, 0], [0, 0, b]),
    ]


def test_open_cavity_converges_with_depth(row) -> None:
    """A well 0.3 m wide and 1.5 m deep seen at a slant: 20 bounces against 40 and 100.

    Naive way: a fixed depth of three bounces, which ends inside the well.
    """
    well = geometry(box(0.3, 1.5))
    look = [[np.sin(t), 0.3 * np.sin(t), np.cos(t)] for t in np.radians([5.0, 15.0, 30.0, 45.0])]

    def amplitude(material: Material, depth: int) -> np.ndarray:
        return monostatic_rcs(
            well, (material,), look, FREQUENCY, max_depth=depth, ray_spacing=0.01, channels=("HH", "VV")
        ).amplitude[:, 0]

    for material in (PEC[0], CONCRETE):
        by_depth = {n: amplitude(material, n) for n in (3, 20, 40, 100)}
        size = np.abs(by_depth[100]).max()
        assert all(np.isfinite(a).all() for a in by_depth.values())
        name = material.name.replace("pec", "metal")
        row(
            f"{name} well: 20 bounces against 100, relative change",
            float(np.abs(by_depth[20] - by_depth[100]).max() / size),
            1e-2,
            naive=float(np.abs(by_depth[3] - by_depth[100]).max() / size) if material.pec else None,
            remedy="as many bounces as it takes; the plan says what a lower depth leaves out",
        )
        row(
            f"{name} well: 40 bounces against 100, relative change",
            float(np.abs(by_depth[40] - by_depth[100]).max() / size),
            1e-4,
        )


def test_closed_cavity(row) -> None:
    """An antenna inside a closed concrete box: the echoes of 40 bounces hold all that 80 and 100 do."""
    walls = geometry([*box(2.0, 2.0), parallelogram([-1, -1, 2.0], [2.0, 0, 0], [0, 2.0, 0])])
    antenna = np.array([0.21, -0.13, 0.9])
    frame = LaunchFrame(
        (antenna + np.array([0.0, 0.0, 0.1]))[None], np.array([[1.0, 0.0, 0.0]]), np.array([[0.0, 1.0, 0.0]])
    )
    grid = square_grid(0.1, 0.1, 0.002, turn=0.6)
    paths = record_paths(walls, (CONCRETE,), antenna, frame, grid, FREQUENCY, max_depth=100)
    assert (paths.hits == 100).all()  # nothing leaves a closed box
    power = np.where(paths.seen, np.abs(paths.amplitude) ** 2, 0.0).sum(axis=1)
    rest = 10 * np.log10(power[40:].sum() / power.sum())
    row("closed concrete box: power beyond 40 of 100 bounces", float(rest), -60.0, "dB")
    # a closed metal box keeps every ray and every ray's field
    metal = record_paths(walls, PEC, antenna, frame, grid, FREQUENCY, max_depth=100)
    assert (metal.hits == 100).all() and np.isfinite(metal.amplitude).all()
