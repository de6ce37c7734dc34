"""Slabs: coefficients in the kernel, and level and position of targets behind them."""

from collections.abc import Mapping

import numpy as np

from sarmitsuba.core.arrays import C128, F64
from sarmitsuba.core.constants import VACUUM_IMPEDANCE
from sarmitsuba.core.units import db_from_power
from sarmitsuba.machine.backend import dr, ensure_backend, mi
from sarmitsuba.scene.materials.material import Material
from sarmitsuba.simulation.execution.rcs import monostatic_rcs
from sarmitsuba.tracing.scatterers.slabs.slab_coefficients import slab
from sarmitsuba.truth import theory
from sarmitsuba.truth.validation import targets
from sarmitsuba.truth.validation.band_sampling import X_BAND, X_WAVELENGTH
from sarmitsuba.truth.validation.cases import CASES, CaseEntry
from sarmitsuba.truth.validation.comparison import Case, Comparison

SOURCE = "ITU-R P.2040-3 (single-layer slab); Born and Wolf, section 7.6"
ROUNDING = "float32 arithmetic: 6e-8 of the electrical thickness, up to 160 rad"
GLASS, BRICK, BOARD = 6.31 - 0.19j, 3.91 - 0.06j, 2.73 - 0.13j
# permittivity, thickness (m), sheet (ohm per square)
WALLS = {
    "window glass 6 mm": (GLASS, 0.006, 0.0),
    "coated glass 6 mm, 4 ohm": (GLASS, 0.006, 4.0),
    "lossless 4, 0.3 m": (4.0 - 0.0j, 0.3, 0.0),
    "brick 0.12 m": (BRICK, 0.12, 0.0),
    "concrete 0.2 m": (5.24 - 0.507j, 0.2, 0.0),
}
THICKNESSES = (1e-6, 1e-4, 0.003, 0.0078, 0.05, 0.3)


def kernel_slab(
    cosine: F64, permittivity: complex, thickness: float, sheet_resistance: float = 0.0
) -> Mapping[str, C128]:
    """Return the coefficients as the compiled kernel computes them: R and T, TE and TM, the sheet behind."""
    ensure_backend()
    chi = mi.Complex2f(dr.opaque(mi.Float, permittivity.real - 1.0), dr.opaque(mi.Float, permittivity.imag))
    sheet = VACUUM_IMPEDANCE / sheet_resistance if sheet_resistance else 0.0
    thick = 2.0 * np.pi / X_WAVELENGTH * thickness
    found = slab(
        mi.Float(cosine.astype(np.float32)),
        chi,
        dr.opaque(mi.Float, thick),
        dr.opaque(mi.Float, sheet),
        mi.Bool(False),
    )
    dr.eval(found.r_te, found.r_tm, found.t_te, found.t_tm, found.extra)
    turn = np.exp(-1j * np.asarray(found.extra, np.float64))  # the phase of the delay, which is the length's
    values = {"R TE": found.r_te, "R TM": found.r_tm, "T TE": found.t_te, "T TM": found.t_tm}
    out: dict[str, C128] = {}
    for name, z in values.items():
        value = np.asarray(z.real, np.float64) + 1j * np.asarray(z.imag, np.float64)
        out[name] = np.asarray(value * turn if name[0] == "T" else value)
    return out


def slab_kernel(quick: bool = False) -> Case:
    """Reflection and transmission of slabs over angle through Dr.Jit, and the energy of lossless ones."""
    angle = np.concatenate([np.linspace(0.0, 89.0, 90), [89.5, 89.9]])
    cosine = np.cos(np.radians(angle))
    comparisons = []
    for name, (eps, thickness, sheet) in WALLS.items():
        got = kernel_slab(cosine, eps, thickness, sheet)
        # of the cosine that the kernel has
        exact = cosine.astype(np.float32).astype(np.float64)
        waves = theory.slab(exact, eps, thickness, X_WAVELENGTH, sheet)
        t_te, t_tm = theory.slab_insertion(exact, eps, thickness, X_WAVELENGTH, sheet)
        want = {"R TE": waves.r_te, "R TM": waves.r_tm, "T TE": t_te, "T TM": t_tm}
        for label, value in want.items():
            comparisons.append(
                Comparison(
                    f"{name}, {label}",
                    angle,
                    np.abs(value),
                    np.abs(value) + np.abs(got[label] - value),
                    tolerance=1e-4,
                    reason=ROUNDING,
                    unit="",
                    shown=60,
                )
            )
    energy = []
    for thickness in THICKNESSES:
        got = kernel_slab(cosine, 6.31 + 0.0j, thickness)
        energy += [np.abs(got[f"R {p}"]) ** 2 + np.abs(got[f"T {p}"]) ** 2 for p in ("TE", "TM")]
    worst = np.asarray(energy)[np.argmax(np.abs(np.asarray(energy) - 1.0).max(axis=1))]
    comparisons.append(
        Comparison(
            "lossless glass, 1 um to 0.3 m: |R|^2 + |T|^2 of the worst",
            angle,
            np.ones_like(angle),
            worst,
            tolerance=1e-4,
            reason="float32 arithmetic; 1e-4 asked for",
            unit="",
        )
    )
    return Case(
        name="slab_kernel",
        topic="materials",
        title="Slabs through the compiled kernel",
        formula="R = r (1 - e^-2jd) / (1 - r^2 e^-2jd), T = (1 - r^2) e^-jd / (1 - r^2 e^-2jd), d = k t q",
        source=SOURCE,
        x_label="incidence angle (deg)",
        y_label="modulus",
        comparisons=tuple(comparisons),
        note="The simulated modulus is drawn with the modulus of the complex error added. X band.",
    )


def dyad(
    normal: F64, direction: F64, wall: tuple[complex, float, float], wavelength: float = X_WAVELENGTH
) -> C128:
    """Return the (3, 3) matrix from a plane wave to the wave behind a slab, fields in scene axes."""
    n, d = normal / np.linalg.norm(normal), direction / np.linalg.norm(direction)
    te, tm = theory.slab_insertion(abs(float(n @ d)), wall[0], wall[1], wavelength, wall[2])
    h = np.cross(d, n)
    h /= np.linalg.norm(h)
    v = np.cross(h, d)
    return np.asarray(te * np.outer(h, h) + tm * np.outer(v, v))


def pane_before_plate(quick: bool = False) -> Case:
    """A metal plate behind panes of drawn orientations, in all four channels."""
    rng = np.random.default_rng(17)
    channels = ("HH", "HV", "VH", "VV")
    look = np.array([1.0, 0.0, 0.0])
    basis = {"H": np.array([0.0, 1.0, 0.0]), "V": np.array([0.0, 0.0, 1.0])}
    plate = targets.parallelogram([0, -0.25, -0.25], [0, 0.5, 0], [0, 0, 0.5])

    def seen(meshes: list[targets.Mesh], material: Material) -> C128:
        result = monostatic_rcs(
            targets.geometry(meshes, [0, 1][: len(meshes)]),
            (*targets.PEC, material),
            look[None],
            X_BAND,
            channels=channels,
            max_depth=1,
            ray_spacing=0.02,
        )
        return np.asarray(result.amplitude[0, 0])

    comparisons = []
    for name in ("window glass 6 mm", "brick 0.12 m"):
        wall = WALLS[name]
        material = Material("pane", permittivity=wall[0], thickness=wall[1], sheet_resistance=wall[2])
        bare = seen([plate], material)[0]
        want, got, angles = [], [], []
        for _ in range(4 if quick else 16):
            # off the line of sight, so that the pane's own mirror image is elsewhere
            tilt, roll = np.radians(rng.uniform(12.0, 70.0)), rng.uniform(0.0, 2.0 * np.pi)
            normal = np.array([np.cos(tilt), np.sin(tilt) * np.cos(roll), np.sin(tilt) * np.sin(roll)])
            a = np.cross(normal, basis["V"])
            a /= np.linalg.norm(a)
            b = np.cross(a, normal)
            middle = rng.uniform(1.5, 4.0) * look
            pane = targets.parallelogram(middle - 2.0 * (a + b), 4.0 * a, 4.0 * b)
            through = dyad(normal, -look, wall)
            want.append([basis[c[1]] @ through @ through @ basis[c[0]] for c in channels])
            got.append(seen([plate, pane], material) / bare)
            angles.append(np.degrees(tilt))
        order = np.argsort(angles)
        a, b = np.abs(np.asarray(want))[order], np.abs(np.asarray(got))[order]
        x = np.asarray(angles)[order]
        for i, channel in enumerate(channels):
            co = channel[0] == channel[1]
            comparisons.append(
                Comparison(
                    f"{name}, {channel}",
                    x,
                    np.asarray(db_from_power(a[:, i] ** 2)) if co else a[:, i],
                    np.asarray(db_from_power(b[:, i] ** 2)) if co else b[:, i],
                    tolerance=0.1 if co else 0.01,
                    reason="side lobes of the pane's own return; 0.1 dB asked for"
                    if co
                    else "side lobes of the pane's own return, share of the amplitude",
                    unit="dB" if co else "",
                )
            )
    return Case(
        name="pane_before_plate",
        topic="materials",
        title="A metal plate behind a pane",
        formula="q . D D e over that without it; D = T_TE h h + T_TM v v about the pane's plane of incidence",
        source=SOURCE,
        x_label="tilt of the pane (deg)",
        y_label="level over that without the pane (dB, cross-polar: share of the amplitude)",
        comparisons=tuple(comparisons),
        note="Panes of 4 m, drawn tilts, rolls and distances, seed 17; a plate of 0.5 m square on. X band.",
    )


def cavity_amplitude(pane: tuple[complex, complex], phase: F64, thick: float, orders: int) -> C128:
    r"""Return the reflection of a pane before a metal plate, relative to the plate alone, with ``orders`` bounces.

    .. math:: R - T^2 e^{-2 j \phi} \sum_m (-R e^{-2 j (\phi - \phi_d)})^m

    Parameters
    ----------
    pane : R and T (insertion) at normal incidence
    phase : wavenumber times the distance of the pane's front
    thick : wavenumber times the pane's thickness: its rear is so much nearer to the plate
    orders : bounces; path m has 2 m + 1
    """
    r, t = pane
    between = np.exp(-2j * (phase - thick))
    total = sum(((-r * between) ** m for m in range((orders + 1) // 2)), np.zeros_like(between))
    return np.asarray(-(r - t * t * np.exp(-2j * phase) * total))


def pane_cavity(quick: bool = False) -> Case:
    """A pane parallel to a metal plate: every path between both is counted exactly once."""
    rng = np.random.default_rng(18)
    side, orders = 0.5, 7
    comparisons = []
    for name in ("window glass 6 mm", "lossless 4, 0.3 m"):
        eps, thickness, _ = WALLS[name]
        glass = Material("pane", permittivity=eps, thickness=thickness)
        distance = np.sort(rng.uniform(1.0, 1.0 + X_WAVELENGTH, 5 if quick else 15))

        def square_on(materials: tuple[Material, ...], places: list[float]) -> complex:
            meshes = [
                targets.parallelogram([x, -side / 2, -side / 2], [0, side, 0], [0, 0, side]) for x in places
            ]
            result = monostatic_rcs(
                targets.geometry(meshes, list(range(len(places)))),
                materials,
                [[1.0, 0.0, 0.0]],
                X_BAND,
                channels=("HH",),
                max_depth=orders,
                ray_spacing=0.02,
                distance=1e7,
            )
            return complex(result.amplitude[0, 0, 0])

        bare = square_on(targets.PEC, [0.0])
        got = np.array([abs(square_on((*targets.PEC, glass), [0.0, x]) / bare) for x in distance])
        waves = theory.slab(1.0, eps, thickness, X_WAVELENGTH)
        through = theory.slab_insertion(1.0, eps, thickness, X_WAVELENGTH)[0]
        pair = complex(waves.r_te), complex(through)
        wavenumber = 2.0 * np.pi / X_WAVELENGTH
        want = np.abs(cavity_amplitude(pair, wavenumber * distance, wavenumber * thickness, orders))
        comparisons.append(
            Comparison(
                name,
                (distance - 1.0) / X_WAVELENGTH,
                np.asarray(db_from_power(want**2)),
                np.asarray(db_from_power(got**2)),
                tolerance=0.05,
                reason="waves spread by 1e-7 on the way between the two; float32 fields",
                unit="dB",
                floor=25.0,
            )
        )
    return Case(
        name="pane_cavity",
        topic="materials",
        title="A pane before a metal plate, square on",
        formula="|R - T^2 e^-2jkD sum_m (-R e^-2jk(D-d))^m|, m up to 3",
        source=SOURCE,
        x_label="distance over 1 m, in wavelengths",
        y_label="level over the plate alone (dB)",
        comparisons=tuple(comparisons),
        note=f"Pane and plate {side:g} m wide; paths of up to {orders} bounces, drawn distances, seed 18.",
    )


def pane_between(front: F64, back: F64, normal: F64, side: float, place: float, turned: bool) -> targets.Mesh:
    """Return a square facet within the slab between two points, ``place`` of the way from its drawn front.

    Parameters
    ----------
    front, back : (3,) points of the slab's faces, m
    normal : from back to front
    side : m
    place : share of the thickness before the facet, as seen from where its normal points
    turned : the facet's normal points from front to back
    """
    a = np.cross([0.0, 0.0, 1.0], normal)
    a, b = side * a / np.linalg.norm(a), np.array([0.0, 0.0, side])
    middle = front + place * (back - front) if not turned else back + place * (front - back)
    corner = middle - 0.5 * (a + b)
    return targets.parallelogram(corner, b, a) if turned else targets.parallelogram(corner, a, b)


def double_glazing(quick: bool = False) -> Case:
    """A metal plate behind two panes with air between, facets drawn anywhere within them."""
    rng = np.random.default_rng(20)
    look, plate = np.array([1.0, 0.0, 0.0]), targets.parallelogram([0, -0.6, -0.6], [0, 1.2, 0], [0, 0, 1.2])

    def seen(
        meshes: list[targets.Mesh], numbers: list[int], materials: tuple[Material, ...], depth: int
    ) -> C128:
        geometry = targets.geometry(meshes, numbers)
        result = monostatic_rcs(
            geometry,
            (*targets.PEC, *materials),
            look[None],
            X_BAND,
            channels=("VV", "HH"),
            max_depth=depth,
            ray_spacing=0.02 if quick else 0.015,
            distance=1e6,
        )
        # phase of the origin, not of the middle of what there is
        middle = float(geometry.bounds.mean(axis=0) @ look)
        return np.asarray(result.amplitude[0, 0] * np.exp(4j * np.pi / X_WAVELENGTH * middle))

    bare = seen([plate], [0], (), 1)
    want, got, angles = [], [], []
    drawn = [np.radians(a) for a in ((20.0, 40.0) if quick else (20.0, 30.0, 40.0))]
    drawn += list(rng.uniform(np.radians(18.0), np.radians(50.0), 0 if quick else 21))
    for i, angle in enumerate(drawn):
        d1, gap, d2 = rng.uniform([3e-3, 11e-3, 3e-3], [1e-2, 18e-3, 1e-2])
        eps = [complex(rng.uniform(3.0, 8.0), -rng.uniform(0.0, 0.4)) for _ in range(2)]
        if i < 3:
            d1, gap, d2, eps = 4e-3, 16e-3, 4e-3, [GLASS, GLASS]
        normal = np.array([np.cos(angle), np.sin(angle), 0.0])
        place, turned = rng.choice([0.0, 0.5, 1.0], 2), rng.random(2) < 0.5
        panes, materials, depth = [], [], 2.0 * look
        for j, (thickness, after) in enumerate(((d1, gap), (d2, 0.0))):
            back = depth - thickness * normal
            panes.append(pane_between(depth, back, normal, 4.5, place[j], bool(turned[j])))
            materials.append(
                Material(f"pane {j}", permittivity=eps[j], thickness=thickness, facet_depth=float(place[j]))
            )
            depth = back - after * normal
        # the panes' own side lobes are not asked for
        behind, alone = (
            seen([plate, *panes], [0, 1, 2], tuple(materials), 0),
            seen(panes, [1, 2], tuple(materials), 0),
        )
        through = theory.layers_insertion(
            float(np.cos(angle)), [(eps[0], d1), (1.0 + 0.0j, gap), (eps[1], d2)], X_WAVELENGTH
        )
        want.append([20.0 * np.log10(abs(t) ** 2) for t in through])
        got.append(20.0 * np.log10(np.abs((behind - alone) / bare)))
        angles.append(np.degrees(angle))
    order = np.argsort(angles)
    a, b, x = np.asarray(want)[order], np.asarray(got)[order], np.asarray(angles)[order]
    return Case(
        name="double_glazing",
        topic="materials",
        title="A metal plate behind double glazing",
        formula="|T|^4 of glass, air and glass, from the product of the layers' matrices",
        source="Born and Wolf, section 1.6.2",
        x_label="incidence angle (deg)",
        y_label="level over that without the panes (dB)",
        comparisons=tuple(
            Comparison(
                f"double glazing, {name}",
                x,
                a[:, i],
                b[:, i],
                tolerance=0.1,
                reason="0.1 dB asked for; waves beside the plate, bounces left out at -40 dB",
                unit="dB",
                floor=15.0,
            )
            for i, name in enumerate(("TE (VV)", "TM (HH)"))
        ),
        note="Upright panes; 4-16-4 mm of glass, then drawn thicknesses, gaps, permittivities and angles; facets at "
        "the front, in the middle or at the rear of their slabs, either way round, seed 20. X band, automatic depth.",
    )


CASES.register(CaseEntry("slab_kernel", "materials", slab_kernel))
CASES.register(CaseEntry("pane_before_plate", "materials", pane_before_plate))
CASES.register(CaseEntry("pane_cavity", "materials", pane_cavity))
CASES.register(CaseEntry("double_glazing", "materials", double_glazing))
