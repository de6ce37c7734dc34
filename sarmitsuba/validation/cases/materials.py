"""Fresnel reflection inside the compiled kernel and through double bounces of real materials."""

import numpy as np
from numpy.typing import NDArray

from sarmitsuba import theory
from sarmitsuba.materials.material import Material
from sarmitsuba.simulation.rcs import monostatic_rcs
from sarmitsuba.validation import targets
from sarmitsuba.validation.comparison import Case, CaseEntry, Comparison, db

C128 = NDArray[np.complex128]

# relative permittivities at X band: ITU-R P.2040-3 concrete (5.24, 0.271 S/m at 9.6 GHz), moist soil, water, a
# metal of 1e7 S/m at 10 GHz, and a lossless one that has an exact Brewster angle
PERMITTIVITY = {
    "lossless 4": 4.0 + 0.0j,
    "concrete": 5.24 - 0.507j,
    "soil": 15.0 - 3.0j,
    "water": 62.0 - 32.0j,
    "metal": 1.0 - 1.7975e7j,
}
ROUNDING = "float32 arithmetic, 6e-8 an operation, and 1e-5 asked for"


def kernel_fresnel(cosine: NDArray[np.float64], permittivity: complex) -> tuple[C128, C128]:
    """Return TE and TM coefficients as the compiled kernel computes them, in float32."""
    from sarmitsuba.backend import ensure_backend

    ensure_backend()
    from sarmitsuba.backend import dr, mi
    from sarmitsuba.trace import field

    chi = mi.Complex2f(dr.opaque(mi.Float, permittivity.real - 1.0), dr.opaque(mi.Float, permittivity.imag))
    te, tm = field.fresnel(mi.Float(cosine.astype(np.float32)), chi)
    dr.eval(te, tm)
    values = [np.asarray(z.real, np.float64) + 1j * np.asarray(z.imag, np.float64) for z in (te, tm)]
    return values[0], values[1]


def fresnel_kernel(quick: bool = False) -> Case:
    """Fresnel TE and TM over angle, the Brewster angle and grazing incidence, through Dr.Jit."""
    theta = np.concatenate([np.linspace(0.0, 89.0, 90), [89.5, 89.9, 89.95, 89.99]])
    comparisons = []
    for name, eps in PERMITTIVITY.items():
        brewster = float(np.degrees(np.arctan(np.sqrt(abs(eps)))))
        angle = np.sort(np.append(theta, brewster))
        cosine = np.cos(np.radians(angle))
        got = kernel_fresnel(cosine, eps)
        want = theory.fresnel(cosine, eps)
        for label, a, b in zip(("TE", "TM"), got, want, strict=True):
            for part in ("real", "imag"):
                comparisons.append(
                    Comparison(
                        f"{name}, {label}, {part} part",
                        angle,
                        np.asarray(getattr(b, part)),
                        np.asarray(getattr(a, part)),
                        tolerance=1e-5,
                        reason=ROUNDING,
                        unit="",
                        shown=int(np.argmin(np.abs(angle - 89.99))),
                    )
                )
    return Case(
        name="fresnel_kernel",
        topic="materials",
        title="Fresnel coefficients through the compiled kernel",
        formula="R_TE = (c - q) / (c + q), R_TM = (eps c - q) / (eps c + q), q = sqrt(eps - sin^2 t)",
        source="Ulaby and Long (2014); ITU-R P.2040-3; complex128 evaluation",
        x_label="incidence angle (deg)",
        y_label="reflection coefficient",
        comparisons=tuple(comparisons),
        note="0 to 89.99 degrees with every material's Brewster angle among the nodes. The table quotes 89.99 degrees.",
    )


def fresnel_end_to_end(quick: bool = False) -> Case:
    """Ratio of a dielectric wall over a metal floor to the same corner all of metal: the wall's coefficients."""
    names = ("concrete",) if quick else ("lossless 4", "concrete", "water")
    angle = np.concatenate([[0.01, 0.1], np.arange(1.0, 90.0, 6.0 if quick else 3.0), [89.9, 89.99]])
    look = targets.from_azimuth(np.zeros_like(angle), np.radians(angle))
    shape = targets.wall_and_ground(0.5, 0.5, 0.5)
    comparisons = []

    def double(wall: Material) -> C128:
        floor = Material("floor", pec=True)
        result = monostatic_rcs(
            shape, (wall, floor), look, targets.BANDS["X"], max_depth=2, keep_orders=True, ray_spacing=0.0025
        )
        return np.asarray(result.amplitude[:, 1, :])

    metal = double(Material("metal", pec=True))
    for name in names:
        ratio = double(Material(name, permittivity=PERMITTIVITY[name])) / metal
        te, tm = theory.fresnel(np.cos(np.radians(angle)), PERMITTIVITY[name])
        for label, i, want in (("TE", 0, -te), ("TM", 1, tm)):
            comparisons.append(
                Comparison(
                    f"{name}, {label}",
                    angle,
                    np.abs(want),
                    np.abs(ratio[:, i]),
                    tolerance=2e-4,
                    reason="float32 directions: cos of the angle to 1e-7, which grazing divides by cos",
                    unit="",
                    shown=int(np.argmin(np.abs(angle - 61.0))),
                )
            )
            comparisons.append(
                Comparison(
                    f"{name}, {label}, error of the complex value",
                    angle,
                    np.zeros_like(angle),
                    np.abs(ratio[:, i] - want),
                    tolerance=2e-4,
                    reason="as above; includes the phase",
                    unit="",
                )
            )
    return Case(
        name="fresnel_end_to_end",
        topic="materials",
        title="Fresnel coefficients out of traced double bounces",
        formula="double bounce of a wall on a metal floor over that of a metal corner = -R_TE (HH), R_TM (VV)",
        source="Ulaby and Long (2014), complex128",
        x_label="incidence angle on the wall (deg)",
        y_label="modulus of the ratio",
        comparisons=tuple(comparisons),
        note="0.5 m faces, X band, 2.5 mm rays, bounce order 2.",
    )


def wall_ground(quick: bool = False) -> Case:
    """Double bounce of a concrete wall on soil, HH and VV: level and loss against metal."""
    lam = targets.wavelength("X")
    height, length, ground = 0.8, 0.6, 2.0
    theta = np.linspace(15.0, 80.0, 14 if quick else 66)
    look = targets.from_azimuth(np.zeros_like(theta), np.radians(90.0 - theta))
    shape = targets.wall_and_ground(height, length, ground)

    def double(wall: Material, floor: Material) -> NDArray[np.float64]:
        result = monostatic_rcs(
            shape,
            (wall, floor),
            look,
            targets.BANDS["X"],
            max_depth=2,
            keep_orders=True,
            ray_spacing=lam / 4.5,
        )
        return np.abs(result.amplitude[:, 1, :]) ** 2

    concrete = Material("concrete", permittivity=PERMITTIVITY["concrete"])
    soil = Material("soil", permittivity=PERMITTIVITY["soil"])
    metal = Material("metal", pec=True)
    power, perfect = double(concrete, soil), double(metal, metal)
    arguments = (height, length, ground, lam, np.radians(theta))
    closed = theory.wall_ground_amplitude(*arguments, concrete.permittivity, soil.permittivity)
    closed_metal = theory.wall_ground_amplitude(*arguments)
    comparisons = []
    for i, channel in enumerate(("HH", "VV")):
        comparisons += [
            Comparison(
                f"{channel}, concrete on soil",
                theta,
                db(np.abs(closed[i]) ** 2),
                db(power[:, i]),
                tolerance=0.3,
                reason="rim of the lit aperture resolved to a fifth of a wavelength",
                canonical=True,
                floor=30.0,
            ),
            Comparison(
                f"{channel}, relative to metal",
                theta,
                db(np.abs(closed[i] / closed_metal[i]) ** 2),
                db(power[:, i] / perfect[:, i]),
                tolerance=0.02,
                reason="the same rays: float32 rounding, a larger share near the Brewster angles of VV",
                unit="dB",
                floor=40.0,
            ),
        ]
    return Case(
        name="wall_ground",
        topic="materials",
        title="Wall-ground double bounce, concrete on soil",
        formula="(2 sqrt(pi) / lambda) 2 b min(h sin t, g cos t) R_wall(90 - t) R_ground(t); HH by TE, VV by TM",
        source="dihedral of unequal faces with both Fresnel coefficients (Ulaby and Long 2014)",
        x_label="incidence angle on the ground (deg)",
        y_label="RCS (dBsm) or ratio (dB)",
        comparisons=tuple(comparisons),
        note=f"Wall {height:g} m x {length:g} m, ground {ground:g} m, X band; eps 5.24 - 0.507j and 15 - 3j.",
    )


CASES = (
    CaseEntry("fresnel_kernel", "materials", fresnel_kernel),
    CaseEntry("fresnel_end_to_end", "materials", fresnel_end_to_end),
    CaseEntry("wall_ground", "materials", wall_ground),
)

__all__ = ["CASES", "PERMITTIVITY", "fresnel_end_to_end", "fresnel_kernel", "kernel_fresnel", "wall_ground"]
