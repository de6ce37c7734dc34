r"""Offsets of shapes between measured and modelled raw data, from the correlation of their echoes.

With the spectra :math:`D` of the data and :math:`M_b` of the echoes of a part b of a shape, a displacement that puts
the part :math:`r` farther along the line of sight and :math:`s` along the track's direction gives the pulse p at the
frequency f the phase :math:`-k (r + s\, a_p)`, with :math:`k = 4 \pi (f_c + f) / c` and the component :math:`a_p` of
the direction to the antenna. The modulus of

.. math:: C(r, s) = \sum_{p, f} D \, M_b^* \, e^{j k (r + s a_p)}

has its peak there, however many cycles the phase is off: its width is the range cell and the azimuth cell. The phase
at the peak tells the offset to a part of a wavelength, once the peak does to less than a quarter of one.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from sarmitsuba.apps.fit.parameter import Derivatives, Parameter
from sarmitsuba.core.arrays import C64, C128, F64, I64, sum_energy, unit_rows
from sarmitsuba.core.constants import SPEED_OF_LIGHT
from sarmitsuba.tracing.derivatives.tangents import Displacement

if TYPE_CHECKING:
    from collections.abc import Sequence

    from sarmitsuba.apps.fit.forward_model import ForwardModel
    from sarmitsuba.radar.radar import Radar
    from sarmitsuba.scene.scene import Scene

# share of the greatest speed from which all corners of a face count as moving with the fastest part of a shape
FASTEST = 0.75
# share of the rms velocity of its points that the mean must have for a part to move together
TOGETHER = 0.5
# share of a velocity that must lie along the track for offsets along it to be looked for
ALONG = 0.05
# cells around a peak in which the correlation of what is left is its noise
AROUND = 6.0
# steps of the peak's refinement
NEWTON = 4
# farthest offsets looked for, in cells of range and azimuth
REACH = 12.0
# positions looked at in a cell, along the range and the track
FINE_RANGE, FINE_AZIMUTH = 16, 3


@dataclass(frozen=True, eq=False)
class MovingPart(Parameter):
    """Faces of a shape that values of parameters move alike; differentiates by a displacement along the line of sight.

    Parameters
    ----------
    mesh : number
    faces : (n_faces,) bool, of the traced scene
    center : (3,) m, middle of the faces
    towards : (3,) unit vector to the antenna at the middle of the track
    velocity : (n_values, 3) of the part, m per unit of each value of the model; 0 where its points move apart
    uneven : (n_values,) rms deviation of its points' change of slant range from that, m per unit
    moves : (n_values,) whether a value moves any point of the part
    alike : whether its points move nearly alike
    """

    mesh: int
    faces: NDArray[np.bool_]
    center: F64
    towards: F64
    velocity: F64
    uneven: F64
    moves: NDArray[np.bool_]
    alike: bool
    label: str = "part"

    @property
    def factor(self) -> F64:
        """(n_values,) change of the slant range by each value, m per unit."""
        return np.asarray(-self.velocity @ self.towards)

    def names(self, scene: Scene) -> tuple[str, ...]:
        """See the base class."""
        return ("part [m]",)

    def values(self, scene: Scene) -> F64:
        """See the base class."""
        return np.zeros(1)

    def changed(self, scene: Scene, values: F64) -> Scene:
        """See the base class."""
        return scene

    def displacements(self, scene: Scene, face_mesh: I64) -> Sequence[Displacement]:
        """See the base class."""
        return [Displacement(np.zeros(3), self.faces, -self.towards)]

    def derivative(self, found: Derivatives) -> Sequence[C64]:
        """See the base class."""
        return found.displaced


@dataclass(frozen=True, eq=False)
class Offset:
    """Offset of a part in one look.

    Parameters
    ----------
    range, azimuth : m, along the line of sight (farther) and along the track; azimuth is NaN where not looked for
    sigma : (2,) standard deviations of both, m
    peak : power of the correlation's peak over the mean power elsewhere
    carrier : m, the range that the phase of the carrier says, nearest to ``range``
    unmoved : m, the range that it says nearest to 0
    energy : of the part's echoes in the model
    share : of it that the data hold without an offset, in phase
    """

    range: float
    azimuth: float
    sigma: tuple[float, float]
    peak: float
    carrier: float
    unmoved: float
    energy: float
    share: float


def moving_parts(model: ForwardModel, values: F64, *, whole: bool = False) -> list[MovingPart]:
    """Parts of the shapes that values of the model displace.

    A translated shape is one part. A deformed one is the part that moves fastest and, if other values displace it too,
    the rest. ``whole``: every shape is one part.
    """
    split = zip(model.parameters, model.split(values), strict=True)
    if all(parameter.moved(model.scene, own) is None for parameter, own in split):
        return []
    corners, mesh = model.traced_faces(values)
    velocity, deformed = velocities(model, values, corners, mesh)
    speed = np.linalg.norm(velocity, axis=-1)  # values, faces, corners
    antenna = model.scene.radar.track.position
    middle = antenna[len(antenna) // 2]
    parts = []
    for number in np.unique(mesh[speed.max(axis=(0, 2)) > 0.0]):
        own = mesh == number
        groups = [(own, True)]
        if deformed[own].any() and not whole:
            varies = int(np.argmax([np.ptp(one[own]) for one in speed]))
            fast = own & (speed[varies].min(axis=1) >= FASTEST * speed[varies, own].max())
            alone = int((speed[:, own].max(axis=(1, 2)) > 0.0).sum()) == 1
            groups = [(fast, True)] if alone and fast.any() else [(fast, True), (own & ~fast, False)]
        for faces, alike in groups:
            if faces.any():
                parts.append(_part(int(number), faces, corners[faces], velocity[:, faces], middle, alike))
    return parts


def velocities(model: ForwardModel, values: F64, corners: F64, mesh: I64) -> tuple[F64, NDArray[np.bool_]]:
    """(n_values, n_faces, 3, 3) m per unit, velocities of the faces' corners; (n_faces,) whether values deform them."""
    scene, moves = model.at(values), model.moves(values)
    velocity, deformed = np.zeros((len(model.names), *corners.shape)), np.zeros(len(mesh), dtype=np.bool_)
    row = 0
    for parameter in model.parameters:
        for k, move in enumerate(moves.of(parameter, scene, mesh)):
            if move.faces is None or move.offset is None:
                continue
            field = move.offset + (0.0 if move.gradient is None else corners @ move.gradient.T)
            velocity[row + k] = np.where(move.faces[:, None, None], field, 0.0)
            if move.gradient is not None:
                deformed |= move.faces
        row += len(parameter.names(scene))
    return velocity, deformed


def _part(
    mesh: int, faces: NDArray[np.bool_], corners: F64, velocity: F64, antenna: F64, alike: bool
) -> MovingPart:
    """MovingPart of some faces: corners (n, 3, 3) m and their velocities (n_values, n, 3, 3)."""
    normal = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    area = np.linalg.norm(normal, axis=1)
    center = np.average(corners.mean(axis=1), axis=0, weights=area)
    towards = antenna - center
    towards /= np.linalg.norm(towards)
    mean = np.average(velocity.mean(axis=2), axis=1, weights=area)
    square = np.average((velocity**2).sum(axis=3).mean(axis=2), axis=1, weights=area)
    together = np.linalg.norm(mean, axis=1) >= TOGETHER * np.sqrt(square)
    mean = mean * together[:, None]
    apart = (((velocity - mean[:, None, None]) @ towards) ** 2).mean(axis=2)
    uneven = np.sqrt(np.average(apart, axis=1, weights=area))
    return MovingPart(mesh, faces, center, towards, mean, uneven, square > 0.0, alike)


def echoes(model: ForwardModel, values: F64, parts: Sequence[MovingPart]) -> tuple[C64, C128]:
    """Raw data (channels, pulses, samples) at some values, and spectra of the echoes of each part."""
    # echoes of the parts themselves, not of what they hide and show as they move
    data, derivative = model.derivative(values, by=parts, edges=False)
    radar = model.scene.radar
    frequency = frequencies(radar.window.n_samples, radar.window.sample_spacing)
    factor = -4j * np.pi / SPEED_OF_LIGHT * (radar.waveform.center_frequency + frequency)
    return data, np.fft.fft(derivative, axis=-1) / factor


def frequencies(samples: int, spacing: float) -> F64:
    """Frequencies of the spectrum of range profiles, Hz, from the spacing of samples in slant range, m."""
    return np.asarray(np.fft.fftfreq(samples, d=2.0 * spacing / SPEED_OF_LIGHT), dtype=np.float64)


def offset(
    model: ForwardModel, part: MovingPart, data: C128, own: C128, reach: float = REACH
) -> Offset | None:
    """Offset of a part from the spectra of the data and of its echoes (channels, pulses, frequencies); None: no echo.

    ``reach`` : cells of range and azimuth that are looked at, in azimuth at most half as many as there are pulses
    """
    energy = sum_energy(own)
    if not energy > 0.0:
        return None
    radar = model.scene.radar
    frequency = frequencies(radar.window.n_samples, radar.window.sample_spacing)
    k = 4.0 * np.pi * (radar.waveform.center_frequency + frequency) / SPEED_OF_LIGHT
    cross = (data * own.conj()).sum(axis=0)
    along, azimuths = _azimuths(radar, part, reach)
    lags, cell = _Lags.of(radar), radar.waveform.range_cell
    best, place = -1.0, (0.0, 0.0)
    for s in azimuths:
        power = lags.power((cross * np.exp(1j * np.outer(along, k) * s)).sum(axis=0))
        power = np.where(np.abs(lags.range) <= reach * cell, power, 0.0)
        at = int(np.argmax(power))
        if power[at] > best:
            best, place = float(power[at]), (float(lags.range[at]), float(s))
    r, s = _refine_peak(cross, k, along, place, cell, len(azimuths) > 1)
    turn = np.exp(1j * k * (r + s * along[:, None]))
    c = complex((cross * turn).sum())
    # what the part's own echoes, so moved, leave nearby: the correlation's noise
    left = ((data * turn - c / energy * own) * own.conj()).sum(axis=0)
    power = np.concatenate(
        [
            lags.power((left * np.exp(1j * np.outer(along, k) * t)).sum(axis=0))
            for t in (azimuths[0], 0.0, azimuths[-1])
        ]
    )
    noise = float(np.mean(power[np.tile(np.abs(lags.range) <= AROUND * cell, 3)]))
    weight = (np.abs(own) ** 2).sum(axis=0)
    mean_k = float(np.sum(weight * k) / energy)
    peak = abs(c) ** 2 / max(noise, np.finfo(np.float64).tiny)
    rms = [float(np.sqrt(np.sum(weight * x**2) / energy)) for x in (k - mean_k, k * along[:, None])]
    sigma = [1.0 / (x * np.sqrt(2.0 * peak)) if x > 0.0 else float("inf") for x in rms]
    return Offset(
        r,
        s if len(azimuths) > 1 else float("nan"),
        (float(sigma[0]), float(sigma[1])),
        peak,
        r - float(np.angle(c)) / mean_k,
        -float(np.angle(cross.sum())) / mean_k,
        energy,
        float(cross.sum().real) / energy,
    )


@dataclass(frozen=True, eq=False)
class _Lags:
    """Lags of correlations in range, finer than the samples; ``range``: (n,) m."""

    range: F64
    samples: int

    @staticmethod
    def of(radar: Radar) -> _Lags:
        samples, spacing = radar.window.n_samples, radar.window.sample_spacing
        fine = max(1, round(FINE_RANGE * spacing / radar.waveform.range_cell))
        n = samples * fine
        return _Lags(np.asarray(np.fft.fftfreq(n) * samples * spacing), samples)

    def power(self, spectrum: C128) -> F64:
        """(n,) squared modulus of the correlation with a cross spectrum (samples,)."""
        half = self.samples // 2
        padded = np.zeros(len(self.range), dtype=np.complex128)
        padded[: self.samples - half] = spectrum[: self.samples - half]
        padded[len(padded) - half :] = spectrum[self.samples - half :]
        return np.asarray(np.abs(np.fft.ifft(padded) * len(padded)) ** 2)


def _refine_peak(
    cross: C128, k: F64, along: F64, place: tuple[float, float], cell: float, both: bool
) -> tuple[float, float]:
    """Range and azimuth of a correlation's peak, by Newton steps on its squared modulus."""
    at = np.array(place if both else place[:1])
    rows = [np.broadcast_to(k - k.mean(), cross.shape), k * along[:, None]][: len(at)]
    for _ in range(NEWTON):
        turned = cross * np.exp(1j * k * (at[0] + (at[1] * along[:, None] if both else 0.0)))
        c = turned.sum()
        first = np.array([(1j * x * turned).sum() for x in rows])
        second = np.array([[-(x * y * turned).sum() for y in rows] for x in rows])
        slope = 2.0 * (c.conjugate() * first).real
        curvature = 2.0 * (c.conjugate() * second + np.outer(first.conj(), first)).real
        if np.any(np.linalg.eigvalsh(curvature) >= 0.0):
            break
        step = -np.linalg.solve(curvature, slope)
        if np.abs(step[0]) > 0.5 * cell:
            break
        at = at + step
    return float(at[0]), float(at[1]) if both else place[1]


def _azimuths(radar: Radar, part: MovingPart, reach: float) -> tuple[F64, F64]:
    """(n_pulses,) component of the directions to the antenna along the track, and the offsets to look at, m."""
    away = radar.track.position - part.center
    away = unit_rows(away)
    direction = track_direction(radar, part)
    along = (away - part.towards) @ direction
    moves = np.abs(part.velocity @ direction) > ALONG * np.linalg.norm(part.velocity, axis=1)
    wide = float(np.ptp(along))
    if not (moves.any() and wide > 0.0):
        return along, np.zeros(1)
    cell = radar.waveform.wavelength / (2.0 * wide)
    # pulses repeat the peak beyond half of their number of cells
    steps = int(min(np.ceil(reach * FINE_AZIMUTH), 0.5 * (len(along) - 1) * FINE_AZIMUTH))
    return along, np.arange(-steps, steps + 1) * cell / FINE_AZIMUTH


def track_direction(radar: Radar, part: MovingPart) -> F64:
    """Unit vector along which the antenna flies, across the line of sight to a part."""
    flown = radar.track.position[-1] - radar.track.position[0]
    across = flown - (flown @ part.towards) * part.towards
    length = np.linalg.norm(across)
    return across / length if length > 0.0 else np.zeros(3)
