r"""Reflection and transmission of plane waves by slabs, from the transmission-line matrix, in float32.

With the wave admittances c and q (TE) or 1/c and eps/q (TM) outside and inside, electrical thickness
:math:`\delta = k d q` and the admittance y of a conducting sheet on one face, both in units of that of free space, the
line's matrix gives reflection and transmission as quotients in which :math:`\cos\delta` and :math:`j \sin\delta / q`
stand; both are scaled by :math:`e^{-j \delta}`, so that nothing overflows in a thick lossy wall, and nothing cancels
in a thin one.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from sarmitsuba.core.arrays import F32, F64, U32, unit_rows
from sarmitsuba.core.constants import VACUUM_IMPEDANCE
from sarmitsuba.machine.backend import dr, mi
from sarmitsuba.scene.materials.slab import lets_through
from sarmitsuba.tracing.kernel.device_arrays import device_array
from sarmitsuba.tracing.kernel.intersector import intersector, query_ray

if TYPE_CHECKING:
    from sarmitsuba.effects.flags import KernelFlags
    from sarmitsuba.scene.materials.material import Material

# opposite faces of one material at most this many thicknesses apart are the two faces of one slab
SAME_SLAB = 1.5


@dataclass(frozen=True, eq=False)
class SlabTables:
    """Slab materials of a scene, and the faces that transmit.

    Parameters
    ----------
    table : (4 n_materials,) float32: wavenumber times thickness (0: a half space), impedance of free space over the
        sheet's resistance, 1 where it transmits, 0
    thickness : (n_faces,) m, of the slab that a face represents; 0 for opaque faces
    facet_depth : (n_faces,) share of the thickness in front of the facet, on its normal's side
    material : (n_faces,) material number of each face
    triangles : (n_faces, 3, 3) float64, m
    """

    table: mi.Float
    thickness: F64
    facet_depth: F64
    material: U32
    triangles: F64

    @staticmethod
    def of(
        materials: tuple[Material, ...],
        wavelength: float,
        material: U32,
        triangles: F64,
    ) -> SlabTables | None:
        """Slabs among the materials of a scene's faces; None where there is none."""
        if not np.array([_is_slab(m) for m in materials])[material].any():
            return None
        passes = np.array([_is_slab(m) and lets_through(m, wavelength) for m in materials])
        open_ = np.where(passes, [m.thickness for m in materials], 0.0)
        table = _rows(materials, passes, wavelength)
        depth = np.array([m.facet_depth for m in materials])[material]
        return SlabTables(device_array(mi.Float, table), open_[material], depth, material, triangles)

    def at_frequency(self, materials: tuple[Material, ...], wavelength: float) -> SlabTables:
        """The same faces at another wavelength, m; the set of faces that transmit stays the same."""
        passes = np.array(self.table).reshape(-1, 4)[:, 2] > 0.0
        return replace(self, table=device_array(mi.Float, _rows(materials, passes, wavelength)))

    def at(self, triangles: F64) -> SlabTables:
        """The same slabs with their faces at other positions."""
        return replace(self, triangles=triangles)

    @property
    def passes(self) -> bool:
        """Whether any face transmits."""
        return bool(self.thickness.any())

    def prepare(self) -> None:
        """Build the tables used by kernels; must not be done while a kernel is recorded."""
        if self.passes:
            _ = self.transmitting, self.transmitting_face, self.walls, self.gap
        _ = self.depths, self.sheets

    @cached_property
    def sheets(self) -> bool:
        """Whether a single facet represents a slab, so that a face of the slab lies off the facet."""
        return bool(np.asarray(self.depths).any())

    @cached_property
    def depths(self) -> mi.Float:
        """Distances (2 n_faces,) float32, m, from a facet to the slab's face on its normal's side and to the other one.

        0 and 0 for opaque faces, which are half spaces from either side, and where a slab is modelled as a box.
        """
        rows = np.zeros((len(self.thickness), 2), dtype=np.float32)
        if self.passes:
            sheet = np.asarray(self.gap) == 0.0
            rows[:, 0] = sheet * self.facet_depth * self.thickness
            rows[:, 1] = sheet * (1.0 - self.facet_depth) * self.thickness
        return device_array(mi.Float, rows)

    def before(self, face: mi.UInt32, behind: mi.Bool, active: mi.Bool) -> mi.Float:
        """Distance along the normal from the slab's face that a wave meets to the facet, m; in a kernel.

        Parameters
        ----------
        behind : whether the wave comes from the side that the facet's normal points away from
        """
        return dr.gather(mi.Float, self.depths, 2 * face + dr.select(behind, mi.UInt32(1), 0), active)

    @cached_property
    def transmitting_rows(self) -> NDArray[np.intp]:
        """Rows of the faces that transmit."""
        return np.flatnonzero(self.thickness)

    @cached_property
    def transmitting(self) -> mi.Scene:
        """Ray-tracing structure of the faces that transmit."""
        return intersector(self.triangles[self.transmitting_rows].astype(np.float32))

    @cached_property
    def transmitting_face(self) -> mi.UInt32:
        """Row of the scene's tables of each face of ``transmitting``."""
        return device_array(mi.UInt32, self.transmitting_rows.astype(np.uint32))

    @cached_property
    def walls(self) -> mi.Scene | None:
        """Ray-tracing structure of the opaque faces; None where there is none."""
        walls = self.triangles[self.thickness == 0.0]
        return intersector(walls.astype(np.float32)) if len(walls) else None

    @cached_property
    def gap(self) -> mi.Float:
        """Distance (n_faces,) float32, m, from a face to the opposite face of a slab that is modelled as a box.

        Positive along the face's normal; 0 where one face represents the whole slab.
        """
        rows = self.transmitting_rows
        corner = self.triangles[rows]
        normal = np.cross(corner[:, 1] - corner[:, 0], corner[:, 2] - corner[:, 0])
        normal = unit_rows(normal)
        thickness = self.thickness[rows]
        gap = np.zeros(len(self.thickness), dtype=np.float32)
        for side in (1.0, -1.0):
            away = side * normal
            start = corner.mean(axis=1) + away * (0.1 * thickness[:, None])
            origin, direction = (
                [device_array(mi.Float, row.astype(np.float32)) for row in x.T] for x in (start, away)
            )
            far = device_array(mi.Float, (SAME_SLAB * thickness).astype(np.float32))
            ray = query_ray(mi.Point3f(*origin), mi.Vector3f(*direction), far)
            met = self.transmitting.ray_intersect_preliminary(ray, coherent=False)
            found, other, t = (np.asarray(x) for x in (met.is_valid(), met.prim_index, met.t))
            other = np.where(found, other, 0)
            parallel = np.abs(np.einsum("ij,ij->i", normal, normal[other])) > 0.999
            pair = found & parallel & (self.material[rows[other]] == self.material[rows])
            gap[rows[pair]] = (side * (0.1 * thickness + t))[pair]
        return device_array(mi.Float, gap)


def lets_waves_through(slabs: SlabTables | None, flags: KernelFlags) -> bool:
    """Whether any face of a scene with these slabs transmits."""
    return flags.transmission and flags.slabs and slabs is not None and slabs.passes


def _is_slab(material: Material) -> bool:
    return material.thickness > 0.0 and not material.pec


def _rows(materials: tuple[Material, ...], passes: NDArray[np.bool_], wavelength: float) -> F32:
    """Rows of the table of :class:`SlabTables`; ``passes`` (n_materials,): materials that transmit."""
    rows = np.zeros((len(materials), 4), dtype=np.float32)
    for i, m in enumerate(materials):
        if _is_slab(m):
            sheet = VACUUM_IMPEDANCE / m.sheet_resistance if m.sheet_resistance > 0.0 else 0.0
            rows[i, :3] = 2.0 * np.pi * m.thickness / wavelength, sheet, passes[i]
    return rows


@dataclass(frozen=True, eq=False)
class SlabFactors:
    """Reflection and transmission factors of a plane wave at a slab.

    Parameters
    ----------
    r_te, r_tm : reflection, as :func:`sarmitsuba.tracing.kernel.field.fresnel`
    t_te, t_tm : transmission, field behind the slab over that without it, without the phase of ``extra``
    extra : rad, wavenumber times the excess path of the group delay over air; mean of TE and TM weighted by
        transmitted power
    aside : rad, derivative of the phase of T by the cosine of incidence (lateral shift); weighted likewise
    """

    r_te: mi.Complex2f
    r_tm: mi.Complex2f
    t_te: mi.Complex2f
    t_tm: mi.Complex2f
    extra: mi.Float
    aside: mi.Float


def slab(
    cos_theta: mi.Float, chi: mi.Complex2f, thickness: mi.Float, sheet: mi.Float, sheet_first: mi.Bool
) -> SlabFactors:
    r"""Reflection and transmission of a slab, see :class:`SlabFactors`.

    .. math::
        T_{TE} &= 2 c / D, & D &= 2 c \cos\delta + \tfrac{j \sin\delta}{q} (c^2 + q^2)
                  + y (\cos\delta + \tfrac{j \sin\delta}{q} c) \\
        R_{TE} D &= -\chi \tfrac{j \sin\delta}{q} - y (\cos\delta \mp \tfrac{j \sin\delta}{q} c)

    and TM alike with :math:`c^2 + q^2 \to q^2 / \varepsilon + \varepsilon c^2`. The upper sign has the sheet on the
    far face. The delay is the derivative of the phase of T by the wavenumber, at a fixed permittivity; the lateral
    shift is :math:`\partial P / \partial \theta` of the phase path P.

    Parameters
    ----------
    cos_theta : float32, cosine of the incidence angle, > 0
    chi : complex float32, ``eps - 1``
    thickness : rad, wavenumber times thickness
    sheet : impedance of free space over the sheet's resistance per square, 0 without one
    sheet_first : whether the wave meets the sheet before the slab

    Notes
    -----
    Ignores dispersion within the band (internal reflections that a short pulse would resolve), rough faces, magnetic
    materials, and the difference of TE and TM in delay and shift.
    """
    c, y = cos_theta, sheet
    eps = chi + 1.0
    q = dr.sqrt(chi + c * c)
    q = dr.select(q.imag > 0, -q, q)  # as in `field.fresnel`
    delta = q * thickness
    # 1 - exp(-2j delta) without a difference of nearly equal numbers
    kept, s = dr.exp(2.0 * delta.imag), dr.sin(delta.real)
    tangent = dr.tanh(-delta.imag)
    lost = 2.0 * tangent / (1.0 + tangent)
    twice = mi.Complex2f(lost + kept * (2.0 * s * s), kept * dr.sin(2.0 * delta.real))
    once = 1.0 - twice  # exp(-2j delta)
    cosine, sine_q = (
        1.0 - 0.5 * twice,
        twice / (2.0 * q),
    )  # cos(delta), j sin(delta) / q, both times exp(-j delta)

    inner, outer = q * q / eps, eps * (c * c)
    one, cos = mi.Complex2f(1.0), mi.Complex2f(c)
    slope = 2.0 * cosine + 4.0 * c * sine_q + y * sine_q
    te = _SlabQuotients(c * c + q * q, -chi, mi.Complex2f(y), one, cos, slope)
    contrast = chi * ((1.0 - (eps + 1.0) * (c * c)) / eps)
    slope = 2.0 * cosine + 2.0 * c * (1.0 / eps + eps) * sine_q
    slope += y * (2.0 * c * cosine + (inner + 2.0 * c * c / eps) * sine_q)
    tm = _SlabQuotients(inner + outer, contrast, mi.Complex2f(y * c), cos, inner, slope)
    # derivatives by the cosine; `slope` is the derivative with these two held constant
    turn = c / q * thickness
    twice_c = mi.Complex2f(0.0, 2.0) * once * turn
    cosine_c, sine_q_c = -0.5 * twice_c, (twice_c - twice * c / (q * q)) / (2.0 * q)
    side = dr.select(sheet_first, 1.0, -1.0)
    r, t, rates, asides = [], [], [], []
    for line in (te, tm):
        total = line.total(c, cosine, sine_q)
        r.append(
            (line.contrast * sine_q - line.sheet * (line.direct * cosine + line.across * sine_q * side))
            / total
        )
        t.append(2.0 * c / total)
        # derivative by the wavenumber: d ln T = -j dk d q (1 + 2 exp(-2j delta) D' / D), D' by 1 - exp(-2j delta)
        rates.append((delta * (1.0 + 2.0 * once * (line.total(c, mi.Complex2f(-0.5), 0.5 / q) / total))).real)
        change = (line.slope + line.total(c, cosine_c, sine_q_c)) / total
        asides.append(thickness - turn.real - change.imag)
    power = [dr.maximum(dr.squared_norm(x), 1e-30) for x in t]
    share = power[0] / (power[0] + power[1])
    extra = dr.lerp(rates[1], rates[0], share) - thickness * c
    aside = dr.lerp(asides[1], asides[0], share)
    # relative to the same thickness of air; the phase of the delay is part of the path length and left out here
    s, c = dr.sincos(thickness * c + extra - delta.real)
    phase = mi.Complex2f(c, s) * dr.exp(delta.imag)
    return SlabFactors(r[0], -r[1], t[0] * phase, t[1] * phase, extra, aside)


@dataclass(frozen=True, eq=False)
class _SlabQuotients:
    """One polarisation of :func:`slab`: the factors of its quotients, and the explicit derivative of D by c."""

    both: mi.Complex2f
    contrast: mi.Complex2f
    sheet: mi.Complex2f
    direct: mi.Complex2f
    across: mi.Complex2f
    slope: mi.Complex2f

    def total(self, c: mi.Float, cosine: mi.Complex2f, sine_q: mi.Complex2f) -> mi.Complex2f:
        """Denominator D, linear in the cosine and in the sine over q."""
        return (
            2.0 * c * cosine + self.both * sine_q + self.sheet * (self.direct * cosine + self.across * sine_q)
        )
