"""Measured and full-wave radar cross sections of the Austin RCS Benchmark Suite.

Monostatic, over azimuth in the horizontal plane. The tables and their notice lie beside this module; copyright
2023 The University of Texas at Austin.
"""

import csv
import gzip
from dataclasses import dataclass
from functools import cache
from pathlib import Path

import numpy as np

from sarmitsuba.core.arrays import F64
from sarmitsuba.core.errors import DataError

FOLDER = Path(__file__).parent
# letters of the polarisation in the tables, by channel: E along phi and along theta
LETTERS = {"HH": "H", "VV": "V"}
SOLVER, CHAMBER = "integral_equation", "measured"


@dataclass(frozen=True, eq=False)
class AzimuthTable:
    """Radar cross section over azimuth.

    Parameters
    ----------
    azimuth : (n,) float64, deg, ascending
    solver : (n,) float64, dB above 1 m^2, of a converged surface-integral solver
    chamber : (n,) float64, dB above 1 m^2, measured in an anechoic chamber; NaN where it was not
    """

    azimuth: F64
    solver: F64
    chamber: F64


def azimuth_table(name: str, frequency: float, channel: str) -> AzimuthTable:
    """One curve of a table, at the angles of its solver.

    Parameters
    ----------
    name : of the file, such as ``III_A_s1``
    frequency : Hz
    channel : HH or VV

    Raises
    ------
    DataError
        The table has no such curve of the solver.
    """
    curves = _curves(name)
    solver = curves.get((SOLVER, LETTERS[channel], frequency))
    if solver is None:
        raise DataError(f"{name}: no {SOLVER} curve of {channel} at {frequency:g} Hz")
    azimuth, values = solver
    chamber = np.full(azimuth.size, np.nan)
    measured = curves.get((CHAMBER, LETTERS[channel], frequency))
    if measured is not None:
        chamber = np.interp(azimuth, *measured)
    return AzimuthTable(azimuth, values, chamber)


@cache
def _curves(name: str) -> dict[tuple[str, str, float], tuple[F64, F64]]:
    """Azimuth (deg) and dB by source, letter of the polarisation and frequency (Hz)."""
    rows: dict[tuple[str, str, float], list[tuple[float, float]]] = {}
    with gzip.open(FOLDER / f"{name}.csv.gz", "rt", encoding="utf-8", newline="") as file:
        for row in csv.DictReader(file):
            key = (row["source"], row["polarisation"], float(row["frequency_hz"]))
            rows.setdefault(key, []).append((float(row["phi_deg"]), float(row["rcs_dbsm"])))
    curves = {}
    for key, pairs in rows.items():
        azimuth, values = np.array(sorted(pairs)).T
        curves[key] = (azimuth, values)
    return curves
