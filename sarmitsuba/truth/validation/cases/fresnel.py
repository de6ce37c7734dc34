"""Fresnel reflection inside the compiled kernel and through double bounces of real materials."""

import numpy as np

from sarmitsuba.core.arrays import C128, F64
from sarmitsuba.machine.backend import dr, ensure_backend, mi
from sarmitsuba.scene.materials.material import Material
from sarmitsuba.simulation.execution.rcs import monostatic_rcs
from sarmitsuba.tracing.kernel import field
from sarmitsuba.truth import theory
from sarmitsuba.truth.validation import targets
from sarmitsuba.truth.validation.band_sampling import BANDS
from sarmitsuba.truth.validation.cases import CASES, CaseEntry
from sarmitsuba.truth.validation.comparison import Case, Comparison
from sarmitsuba.truth.validation.targets import PERMITTIVITY

ROUNDING = "float32 arithmetic, 6e-8 per operation, and 1e-5 asked for"


def kernel_fresnel(cosine: F64, permittivity: complex) -> tuple[C128, C128]:
    """Return TE and TM coefficients as the compiled kernel computes them, in float32."""
    ensure_backend()
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
            shape, (wall, floor), look, BANDS["X"], max_depth=2, keep_orders=True, ray_spacing=0.0025
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


CASES.register(CaseEntry("fresnel_kernel", "materials", fresnel_kernel))
CASES.register(CaseEntry("fresnel_end_to_end", "materials", fresnel_end_to_end))
