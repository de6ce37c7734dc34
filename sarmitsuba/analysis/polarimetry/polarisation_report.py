"""Report of an image's polarimetry."""

from dataclasses import dataclass

import numpy as np

from sarmitsuba.analysis.polarimetry.cloude_pottier import ZONES, CloudePottier, cloude_pottier
from sarmitsuba.analysis.polarimetry.coherency import coherency, span
from sarmitsuba.analysis.polarimetry.compact import Stokes, m_chi, stokes
from sarmitsuba.analysis.polarimetry.multilook import check_looks
from sarmitsuba.analysis.polarimetry.quad import quad_pol
from sarmitsuba.core.arrays import C128, F64
from sarmitsuba.core.errors import DataError
from sarmitsuba.signal.image.sar_image import SarImage

# resolution cells along the side of an automatic block: 25 looks give H to about 0.05
CELLS = 5.0


@dataclass(frozen=True, eq=False)
class PolarimetryReport:
    """Results of the decompositions; None for those whose channels are missing.

    Parameters
    ----------
    looks : pixels (azimuth, range) averaged into one
    cells : resolution cells in a block, the number of independent looks
    coherency : (rows, columns, 3, 3) complex128, T3, m^2
    decomposition : of the coherency matrix
    asymmetry_db : energy of HV - VH over that of both, dB; NaN without both
    stokes : of the compact channels
    """

    looks: tuple[int, int]
    cells: float
    coherency: C128 | None
    decomposition: CloudePottier | None
    asymmetry_db: float
    stokes: Stokes | None

    def as_dict(self) -> dict[str, object]:
        """Values for JSON; None for those not measured, powers as shares."""
        return {
            "looks": list(self.looks),
            "cells_per_block": self.cells,
            "quad": None if self.coherency is None else self._quad(self.coherency),
            "compact": None if self.stokes is None else self._compact(self.stokes),
        }

    def as_table(self) -> str:
        """Table of the values for a terminal."""
        lines = [
            f"blocks of {self.looks[0]} x {self.looks[1]} pixels, {self.cells:.3g} resolution cells each"
        ]
        if self.coherency is not None and self.decomposition is not None:
            odd, even, cross = pauli_shares(self.coherency)
            d = self.decomposition
            lines += [
                f"Pauli shares of power: odd bounces {odd:.1%}, even bounces {even:.1%}, cross-polar {cross:.1%}",
                f"median entropy {_median(d.entropy):.3f}, anisotropy {_median(d.anisotropy):.3f}, "
                f"alpha {np.degrees(_median(d.alpha)):.1f} deg",
                f"HV - VH: {self.asymmetry_db:.1f} dB of both",
                "zones of entropy and alpha, share of area and of power:",
            ]
            lines += [
                f"  {number}  {name:<42}{area:7.1%}{power:8.1%}"
                for number, (name, area, power) in zone_shares(d, span(self.coherency)).items()
            ]
        if self.stokes is not None:
            lines += [
                "m-chi shares of power: "
                + ", ".join(f"{name} {share:.1%}" for name, share in m_chi_shares(self.stokes).items()),
                f"median degree of polarisation {_median(self.stokes.polarised):.3f}",
            ]
        return "\n".join(lines)

    def _quad(self, matrices: C128) -> dict[str, object]:
        assert self.decomposition is not None
        d = self.decomposition
        shares = dict(zip(("odd_bounce", "even_bounce", "cross_polar"), pauli_shares(matrices), strict=True))
        zones = zone_shares(d, span(matrices))
        return {
            "pauli_shares": {name: _or_none(share) for name, share in shares.items()},
            "entropy": _or_none(_median(d.entropy)),
            "anisotropy": _or_none(_median(d.anisotropy)),
            "alpha_deg": _or_none(float(np.degrees(_median(d.alpha)))),
            "hv_minus_vh_db": _or_none(self.asymmetry_db),
            "zones": {
                number: {"name": name, "area": area, "power": power}
                for number, (name, area, power) in zones.items()
            },
        }

    @staticmethod
    def _compact(vector: Stokes) -> dict[str, object]:
        return {
            "m_chi_shares": {name: _or_none(share) for name, share in m_chi_shares(vector).items()},
            "degree_of_polarisation": _or_none(_median(vector.polarised)),
            "chi_deg": _or_none(float(np.degrees(_median(vector.chi)))),
        }


def polarimetry_report(image: SarImage, looks: tuple[int, int] | None = None) -> PolarimetryReport:
    """Decompose an image: T3, H, A and alpha of quad-pol channels, the Stokes vector of compact ones.

    Parameters
    ----------
    image : with HH, HV (VH), VV, or RH and RV (LH and LV), or both
    looks : pixels (azimuth, range) of a block; None takes :func:`automatic_looks`

    Raises
    ------
    DataError
        The image has neither set of channels, or ``looks`` do not fit.
    """
    there = set(image.channels)
    has_quad = {"HH", "VV"} <= there and bool(there & {"HV", "VH"})
    has_compact = {"RH", "RV"} <= there or {"LH", "LV"} <= there
    if not has_quad and not has_compact:
        raise DataError(
            f"polarimetry: the image has the channels {', '.join(image.channels)}; HH, HV, VH, VV or RH, RV are "
            'needed: set polarisation to "HH,HV,VH,VV"'
        )
    block = looks or automatic_looks(image)
    check_looks(image.grid.shape, block)
    matrices = decomposition = None
    asymmetry = float("nan")
    if has_quad:
        quad = quad_pol(image)
        matrices = coherency(quad, block)
        decomposition = cloude_pottier(matrices)
        asymmetry = quad.asymmetry_db if {"HV", "VH"} <= there else asymmetry
    pixels = np.array(cell_pixels(image))
    return PolarimetryReport(
        looks=block,
        cells=float(np.prod(np.maximum(np.array(block) / pixels, 1.0))),
        coherency=matrices,
        decomposition=decomposition,
        asymmetry_db=asymmetry,
        stokes=stokes(image, block) if has_compact else None,
    )


def cell_pixels(image: SarImage) -> tuple[float, float]:
    """Pixels (azimuth, range) of a resolution cell in the middle of the image."""
    grid = image.grid
    cell = image.range_resolution_cell
    if grid.kind == "ground":
        cell /= float(np.sin(image.incidence_angle[image.incidence_angle.size // 2]))
    return image.azimuth_resolution_cell / grid.azimuth_spacing, cell / grid.range_spacing


def automatic_looks(image: SarImage, cells: float = CELLS) -> tuple[int, int]:
    """Pixels (azimuth, range) of ``cells`` resolution cells each way, at most those of the image."""
    rows, columns = (
        min(max(1, round(cells * pixels)), size)
        for pixels, size in zip(cell_pixels(image), image.grid.shape, strict=True)
    )
    return rows, columns


def pauli_shares(matrices: C128) -> tuple[float, float, float]:
    """Pauli shares of the power: ``|HH + VV|^2 / 2``, ``|HH - VV|^2 / 2``, ``2 |X|^2``; NaN without power."""
    powers = [float(matrices[..., i, i].real.sum()) for i in range(3)]
    total = sum(powers)
    odd, even, cross = (p / total if total > 0.0 else float("nan") for p in powers)
    return odd, even, cross


def zone_shares(decomposition: CloudePottier, power: F64) -> dict[int, tuple[str, float, float]]:
    """Name, share of the area and share of the power of each zone of :data:`ZONES`."""
    number = decomposition.zone.ravel()
    counts = np.bincount(number, minlength=10)[1:].astype(np.float64)
    powers = np.bincount(number, weights=power.ravel(), minlength=10)[1:]
    area, share = (x / x.sum() if x.sum() > 0.0 else np.zeros(9) for x in (counts, powers))
    return {n: (name, float(area[n - 1]), float(share[n - 1])) for n, name in ZONES.items()}


def m_chi_shares(vector: Stokes) -> dict[str, float]:
    """Shares of the power in the three parts of :func:`sarmitsuba.analysis.polarimetry.m_chi`; NaN without power."""
    powers = m_chi(vector).sum(axis=(0, 1))
    total = float(powers.sum())
    names = ("even_bounce", "unpolarised", "odd_bounce")
    return {n: float(p) / total if total > 0.0 else float("nan") for n, p in zip(names, powers, strict=True)}


def _median(values: F64) -> float:
    finite = values[np.isfinite(values)]
    return float(np.median(finite)) if finite.size else float("nan")


def _or_none(value: float) -> float | None:
    return value if np.isfinite(value) else None
