r"""Polarimetric calibration: imbalance and cross-talk of a radar from trihedrals and dihedrals in its image.

.. math:: M_i = a_i R S_i T

with the measured and the true scattering matrix of target i, received polarisation first, and an unknown complex factor
of each target, since positions are not known to a fraction of the wavelength.

References
----------
Whitt, Ulaby, Polatin, Liepa, IEEE Trans. Antennas Propag. 39 (1) 1991, 62-67 (three targets); van Zyl, IEEE TGRS 28 (3)
1990, eq. 1.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Literal

import numpy as np
import scipy

from sarmitsuba.analysis.carrier import Carrier
from sarmitsuba.core.arrays import C128, F64
from sarmitsuba.core.errors import DataError
from sarmitsuba.core.parameters import one_line
from sarmitsuba.core.units import db_from_power
from sarmitsuba.machine.regular_files import read_rows
from sarmitsuba.signal.image import SarImage

_CHANNELS = ("HH", "HV", "VH", "VV")
# singular values of the derivative below this over the largest: the targets leave a parameter open
_OPEN = 1e-6
_REACH = 1.5  # cells about its position in which a target's peak lies


@dataclass(frozen=True)
class CalibrationTarget:
    """Corner reflector of a known scattering matrix.

    Parameters
    ----------
    kind : ``trihedral`` or ``dihedral``
    position : x, y, z in m, frame of the scene's file
    rotation : rad, of a dihedral about the line of sight, from h towards v; 0 has its fold along h
    """

    kind: Literal["trihedral", "dihedral"]
    position: tuple[float, float, float] = (0.0, 0.0, 0.0)
    rotation: float = 0.0

    @property
    def matrix(self) -> F64:
        r"""Scattering matrix (2, 2) of unit RCS, backscatter alignment.

        The unit matrix, and of a dihedral :math:`\begin{pmatrix} \cos 2\psi & \sin 2\psi \\ \sin 2\psi & -\cos 2\psi
        \end{pmatrix}`.
        """
        if self.kind == "trihedral":
            return np.eye(2)
        c, s = np.cos(2.0 * self.rotation), np.sin(2.0 * self.rotation)
        return np.array([[c, s], [s, -c]])


def read_targets(path: Path | str) -> tuple[CalibrationTarget, ...]:
    """Targets of a CSV file with the columns kind, x_m, y_m, z_m, and rotation_deg where a dihedral is rotated.

    Raises
    ------
    DataError
        The file cannot be read, or a kind is unknown.
    """
    numbers = {"x_m": None, "y_m": None, "z_m": None, "rotation_deg": 0.0}
    targets = []
    for row in read_rows(path, "calibration targets", ("kind",), numbers, DataError):
        kind, place = row["kind"], tuple(float(row[name]) for name in ("x_m", "y_m", "z_m"))
        if kind not in ("trihedral", "dihedral"):
            raise DataError(f'{path}: kind "{one_line(kind)}" is neither trihedral nor dihedral')
        targets.append(CalibrationTarget(kind, place, float(np.radians(float(row["rotation_deg"])))))  # type: ignore[arg-type]
    return tuple(targets)


@dataclass(frozen=True, eq=False)
class PolarimetricCalibration:
    """Distortion of a radar.

    Parameters
    ----------
    receive, transmit : (2, 2) complex128, order H, V; the HH element of each is 1
    factors : (n,) complex128, of the targets
    residual_db : energy of the measurements that the model leaves, over theirs
    """

    receive: C128
    transmit: C128
    factors: C128
    residual_db: float

    def as_dict(self) -> dict[str, object]:
        """Values for JSON: complex numbers as real and imaginary part, order HH, HV, VH, VV."""

        def pairs(matrix: C128) -> list[list[float]]:
            return [[float(z.real), float(z.imag)] for z in matrix.ravel()]

        return {
            "receive": pairs(self.receive),
            "transmit": pairs(self.transmit),
            "target_factors": pairs(self.factors),
            "residual_db": self.residual_db,
        }

    def __str__(self) -> str:
        """Two lines: imbalance and cross-talk of both sides."""

        def line(name: str, m: C128) -> str:
            db = db_from_power(np.abs(np.array([m[1, 1], m[0, 1], m[1, 0]])) ** 2 + 1e-30)
            return (
                f"{name}: V over H {db[0]:.2f} dB, {np.degrees(np.angle(m[1, 1])):.1f} deg; cross-talk HV {db[1]:.1f} "
                f"dB, VH {db[2]:.1f} dB"
            )

        return f"{line('receiver', self.receive)}\n{line('transmitter', self.transmit)}"

    def correct(self, image: SarImage) -> SarImage:
        """Image without the distortion; layers of one order and subset are corrected together."""
        index = {layer: i for i, layer in enumerate(image.layers)}
        undo = np.linalg.inv(self.receive), np.linalg.inv(self.transmit)
        data = image.data.copy()
        for layer in image.layers:
            if layer.channel != _CHANNELS[0]:
                continue
            rows = [index[replace(layer, channel=channel)] for channel in _CHANNELS]
            measured = image.data[rows].reshape(2, 2, *image.data.shape[1:])  # transmitted, received
            data[rows] = np.einsum("ij,kj...,kl->li...", undo[0], measured, undo[1]).reshape(
                4, *data.shape[1:]
            )
        return replace(image, data=data)


def measure_targets(image: SarImage, targets: Sequence[CalibrationTarget]) -> C128:
    """Measured matrices (n, 2, 2), received polarisation first, at the strongest pixel beside every target.

    Raises
    ------
    DataError
        The image has not all four channels, or a target lies outside it.
    """
    if not set(_CHANNELS) <= set(image.channels):
        raise DataError(
            f"polarimetric calibration: the image has the channels {', '.join(image.channels)}; "
            f"{', '.join(_CHANNELS)} are needed"
        )
    planes = np.stack([image.total(channel) for channel in _CHANNELS])
    power = np.square(np.abs(planes)).sum(axis=0)
    carrier, grid, found = Carrier.of(image), image.grid, []
    cells = image.azimuth_resolution_cell, image.range_resolution_cell / np.sin(image.incidence_angle.mean())
    reach = [
        int(np.ceil(_REACH * cell / step))
        for cell, step in zip(cells, (grid.azimuth_spacing, grid.range_spacing), strict=True)
    ]
    for target in targets:
        place = carrier.place(np.asarray(target.position, dtype=np.float64) - grid.offset)
        row = round((place[0] - grid.azimuth[0]) / grid.azimuth_spacing)
        column = round((place[1] - grid.range[0]) / grid.range_spacing)
        if not (0 <= row < grid.shape[0] and 0 <= column < grid.shape[1]):
            raise DataError(
                f"polarimetric calibration: the {target.kind} at {target.position} m is outside the image"
            )
        rows = slice(max(0, row - reach[0]), row + reach[0] + 1)
        columns = slice(max(0, column - reach[1]), column + reach[1] + 1)
        peak = np.unravel_index(np.argmax(power[rows, columns]), power[rows, columns].shape)
        pixel = planes[:, rows.start + peak[0], columns.start + peak[1]]
        found.append(pixel.reshape(2, 2).T)
    return np.array(found, dtype=np.complex128)


def solve_distortion(measured: C128, ideal: F64) -> PolarimetricCalibration:
    """Distortion that fits measured scattering matrices with least squares.

    Parameters
    ----------
    measured, ideal : (n, 2, 2), received polarisation first; ideal ones up to a factor of each

    Raises
    ------
    DataError
        The targets leave a parameter open: a trihedral, a dihedral, and one rotated otherwise are needed.

    Notes
    -----
    Both matrices times a factor and its inverse are the same radar, so that the HH elements are 1. A radar whose V
    channels are all reversed fits as well; the solution is the one nearer to an ideal radar.
    """
    if not len(measured):
        raise DataError("polarimetric calibration: no target; give a trihedral and two dihedrals")
    scale = np.linalg.norm(measured, axis=(1, 2), keepdims=True)
    if not (scale > 0.0).all():
        raise DataError("polarimetric calibration: a target has no echo; check its position")
    wanted = measured / scale

    def model(x: F64) -> C128:
        receive, transmit = _matrices(x)
        shape = receive @ ideal @ transmit
        factor = np.einsum("nij,nij->n", shape.conj(), wanted) / np.einsum("nij,nij->n", shape.conj(), shape)
        return np.asarray(factor[:, None, None] * shape)

    def residual(x: F64) -> F64:
        rest = (model(x) - wanted).ravel()
        return np.concatenate([rest.real, rest.imag])

    found = scipy.optimize.least_squares(
        residual, np.array([0.0, 0.0, 1.0] * 2 + [0.0] * 6), xtol=1e-14, ftol=1e-14, gtol=1e-14
    )
    singular = np.linalg.svd(found.jac, compute_uv=False)
    if singular.size < found.x.size or singular[-1] < _OPEN * singular[0]:
        raise DataError(
            f"polarimetric calibration: {len(measured)} targets leave parameters of the radar open; give a trihedral, "
            "a dihedral, and a dihedral rotated by 22.5 to 45 deg against it"
        )
    receive, transmit = _matrices(found.x)
    shape = receive @ ideal @ transmit
    factors = np.einsum("nij,nij->n", shape.conj(), measured) / np.einsum("nij,nij->n", shape.conj(), shape)
    rest = float(np.sum(found.fun**2)) / len(measured)
    return PolarimetricCalibration(receive, transmit, factors, float(db_from_power(max(rest, 1e-300))))


def calibrate_polarimetry(image: SarImage, targets: Sequence[CalibrationTarget]) -> PolarimetricCalibration:
    """Distortion of the radar of an image with corner reflectors at known positions.

    Raises
    ------
    DataError
        As for :func:`measure_targets` and :func:`solve_distortion`.
    """
    return solve_distortion(measure_targets(image, targets), np.array([target.matrix for target in targets]))


def _matrices(x: F64) -> tuple[C128, C128]:
    """Reception and transmission of 12 numbers: HV, VH, VV of both, real parts before imaginary ones."""
    z = x[:6] + 1j * x[6:]
    return np.array([[1.0, z[0]], [z[1], z[2]]]), np.array([[1.0, z[3]], [z[4], z[5]]])
