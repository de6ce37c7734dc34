"""Water under wind in the kernel: backscatter by wind direction, and motion of the scatterers with the waves.

Every scatterer of the water has a position at rest on its lattice. Its motion is the sum of the orbital motion of the
long waves, which are drawn individually, a random velocity that represents the orbital motion of all shorter waves,
and the phase velocity of the Bragg wave, towards the radar or away from it.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import TypeAlias

import numpy as np

from sarmitsuba.machine.backend import device_array, dr, mi
from sarmitsuba.scene.materials.diffuse_law import LAWS
from sarmitsuba.scene.materials.material import Material
from sarmitsuba.scene.materials.sea_spectrum import GRAVITY, TENSION
from sarmitsuba.tracing.kernel.movement import Movement
from sarmitsuba.tracing.kernel.speckle import gaussian, mix

# numbers of a material's row: wind east and north, first wave and number of waves, standard deviations of the velocity
# along and across the wind and upwards, and 1 for water
ROW = 8
# terms of a sum over the waves
Sums: TypeAlias = "tuple[mi.Float, ...]"
# streams of a scatterer's hash; 0 to 2 are its speckle
_HORIZONTAL, _VERTICAL, _BRAGG = 3, 4, 0x5EA5


@dataclass(frozen=True, eq=False)
class Drift:
    """Effect of the motion of water on the echo of a scatterer.

    Parameters
    ----------
    movement : of the scatterer from its position at rest: displacement (m) and velocity (m/s), float64
    bragg : short wave that the scatterer represents; None where motion is off
    """

    movement: Movement
    bragg: BraggWave | None


@dataclass(frozen=True, eq=False)
class BraggWave:
    """Bragg wave: the short wave that a scatterer represents.

    Parameters
    ----------
    wavenumber : rad/m, of the radar
    time : s
    wind : (2,) direction that the wind blows to
    sample : random number of the scatterer, uniform from 0 to 1
    water : lanes that are water
    """

    wavenumber: mi.Float
    time: mi.Float64
    wind: mi.Vector2f
    sample: mi.Float
    water: mi.Bool

    def range_rate(self, change: mi.Vector3f) -> mi.Float64:
        r"""Range rate of the Bragg wave, m/s, :math:`\mp \omega(K) / 2k` for approaching and receding waves.

        The wave vector K is k times the change of direction along the surface. Of the waves along it the share
        :math:`\cos^4(\varphi/2) / (\cos^4(\varphi/2) + \sin^4(\varphi/2))` approaches the radar, with the angle
        :math:`\varphi` of K to the wind.
        """
        kx, ky = change.x * self.wavenumber, change.y * self.wavenumber
        wave = dr.sqrt(dr.square(kx) + dr.square(ky))
        cosine = (kx * self.wind.x + ky * self.wind.y) / dr.maximum(wave, 1e-6)
        coming = 0.5 * dr.square(1.0 + cosine) / (1.0 + dr.square(cosine))
        omega = dr.sqrt(GRAVITY * wave + TENSION * wave * dr.square(wave))
        rate = dr.select(self.sample < coming, -0.5, 0.5) * omega / self.wavenumber
        return mi.Float64(dr.select(self.water, rate, 0.0))


@dataclass(frozen=True, eq=False)
class WaterTables:
    """Tables of the materials that are water under wind, on the device.

    Parameters
    ----------
    n_nodes : of the tables over the incidence angle
    contrast : (4 n_nodes n_materials,) float32, see :class:`sarmitsuba.scene.materials.diffuse_law.WindWaves`
    rows : (ROW n_materials,) float32
    waves : (8 n_waves,) float32: wavenumber east and north, angular frequency, phase, amplitude and zeros
    drawn : whether there are any long waves
    """

    n_nodes: int
    contrast: mi.Float
    rows: mi.Float
    waves: mi.Float
    drawn: bool

    @staticmethod
    def of(materials: Sequence[Material], wavelength: float, n_nodes: int, seed: int) -> WaterTables | None:
        """Tables of a scene; None where no material is water under wind.

        Parameters
        ----------
        materials : of the scene
        wavelength : m
        n_nodes : of the diffuse tables
        seed : of the long waves
        """
        theta = np.linspace(0.0, 0.5 * np.pi, n_nodes)
        found = [LAWS[m.diffuse_law].wind_waves(m, wavelength, theta, seed) for m in materials]
        if not any(found):
            return None
        rows, contrast = np.zeros((len(found), ROW)), np.zeros((len(found), n_nodes, 4))
        waves = [np.zeros((0, 5))]
        for row, table, water in zip(rows, contrast, found, strict=True):
            if water is None:
                continue
            first = sum(len(part) for part in waves)
            row[:] = (*water.downwind, first, len(water.waves), *water.speeds, 1.0)
            table[:] = water.contrast
            waves.append(water.waves)
        every = np.concatenate(waves)
        padded = np.zeros((max(len(every), 1), 8))
        padded[: len(every), :5] = every
        contrast32, rows32, waves32 = (
            device_array(mi.Float, np.asarray(a, dtype=np.float32)) for a in (contrast, rows, padded)
        )
        return WaterTables(n_nodes, contrast32, rows32, waves32, len(every) > 0)

    def level(self, material: mi.UInt32, theta: mi.Float, change: mi.Vector3f) -> mi.Vector2f:
        """Amplitude for h and v relative to the table, at an incidence angle and a change ``s - d`` of direction."""
        at = theta * ((self.n_nodes - 1) / (0.5 * np.pi))
        node = dr.minimum(mi.UInt32(at), self.n_nodes - 2)
        row = material * self.n_nodes + node
        low, high = (dr.gather(mi.Vector4f, self.contrast, row + i) for i in (0, 1))
        b = low + (high - low) * (at - mi.Float(node))
        wind = self._wind(material)
        along = change.x * wind.x + change.y * wind.y
        square = dr.square(change.x) + dr.square(change.y)
        twice = 2.0 * dr.square(along) / dr.maximum(square, 1e-12) - 1.0
        twice = dr.select(square > 1e-12, twice, 0.0)
        four = 2.0 * dr.square(twice) - 1.0
        return mi.Vector2f(*(dr.sqrt(dr.maximum(1.0 + b[i] * twice + b[i + 2] * four, 0.0)) for i in (0, 1)))

    def tilt(
        self, normal: mi.Vector3f, point: mi.Vector3f, material: mi.UInt32, time: mi.Float
    ) -> mi.Vector3f:
        """Unit normal of the water surface, tilted by the long waves; the normal itself on other materials.

        Parameters
        ----------
        normal : on the side that is lit
        point : m, at rest
        time : s
        """
        if not self.drawn:
            return normal

        def add(sums: Sums, wave: Wave) -> Sums:
            slope = wave.amplitude * wave.sine
            return sums[0] + wave.kx * slope, sums[1] + wave.ky * slope

        east, north = self._sum(point, material, time, 2, add)
        # of the height a cos: its slope is -a k sin, and the normal leans against the slope
        return dr.normalize(normal + mi.Vector3f(east, north, 0.0) * dr.abs(normal.z))

    def drift(
        self,
        centre: mi.Vector3d,
        key: mi.UInt32,
        material: mi.UInt32,
        wavenumber: mi.Float,
        time: mi.Float64 | None,
    ) -> Drift:
        """Motion of a scatterer; at rest as at time zero where ``time`` (s) is None.

        Parameters
        ----------
        centre : m, its position at rest
        key : its hash
        wavenumber : rad/m, of the radar
        """
        speeds = dr.gather(mi.Vector4f, self.rows, material * 2 + 1)
        shift, velocity = dr.zeros(mi.Vector3d), dr.zeros(mi.Vector3d)
        if self.drawn:
            now = mi.Float(0.0) if time is None else mi.Float(time)
            shift, velocity = self._orbit(mi.Vector3f(centre), material, now)
        if time is None:
            return Drift(Movement(shift, dr.zeros(mi.Vector3d)), None)
        wind, root = self._wind(material), float(np.sqrt(2.0))
        level, upward = gaussian(key, _HORIZONTAL), gaussian(key, _VERTICAL)
        along, across = (mi.Float(x) * s * root for x, s in ((level.real, speeds.x), (level.imag, speeds.y)))
        own = mi.Vector3d(
            mi.Vector3f(
                along * wind.x - across * wind.y,
                along * wind.y + across * wind.x,
                upward.real * speeds.z * root,
            )
        )
        sample = (mi.Float(mix(key ^ _BRAGG) >> 8) + 0.5) * (1.0 / 16777216.0)
        bragg = BraggWave(wavenumber, time, wind, sample, speeds.w > 0.5)
        return Drift(Movement(shift + own * time, velocity + own), bragg)

    def _orbit(
        self, point: mi.Vector3f, material: mi.UInt32, time: mi.Float
    ) -> tuple[mi.Vector3d, mi.Vector3d]:
        """Orbital displacement (m) and velocity (m/s) of the water surface by the long waves."""

        def add(sums: Sums, wave: Wave) -> Sums:
            level = dr.rsqrt(dr.square(wave.kx) + dr.square(wave.ky)) * wave.amplitude
            east, north = wave.kx * level, wave.ky * level
            faster = wave.omega * wave.cosine
            return (
                sums[0] - east * wave.sine,
                sums[1] - north * wave.sine,
                sums[2] + wave.amplitude * wave.cosine,
                sums[3] + east * faster,
                sums[4] + north * faster,
                sums[5] + wave.amplitude * wave.omega * wave.sine,
            )

        x, y, z, u, v, w = self._sum(point, material, time, 6, add)
        return mi.Vector3d(mi.Vector3f(x, y, z)), mi.Vector3d(mi.Vector3f(u, v, w))

    def _sum(
        self,
        point: mi.Vector3f,
        material: mi.UInt32,
        time: mi.Float,
        n: int,
        add: Callable[[Sums, Wave], Sums],
    ) -> Sums:
        """Sums of n terms over the long waves of a material at a position and time."""
        row = dr.gather(mi.Vector4f, self.rows, material * 2)
        first = mi.UInt32(row.z)
        last = first + mi.UInt32(row.w)

        def some_left(index: mi.UInt32, sums: Sums) -> mi.Bool:
            return index < last

        def one(index: mi.UInt32, sums: Sums) -> tuple[mi.UInt32, Sums]:
            a = dr.gather(mi.Vector4f, self.waves, index * 2)
            amplitude = dr.gather(mi.Vector4f, self.waves, index * 2 + 1).x
            sine, cosine = dr.sincos(a.x * point.x + a.y * point.y - a.z * time + a.w)
            return index + 1, add(sums, Wave(a.x, a.y, a.z, amplitude, sine, cosine))

        found: tuple[mi.UInt32, Sums] = dr.while_loop(
            (first, tuple(mi.Float(0.0) for _ in range(n))),
            some_left,
            one,
            labels=("wave", "sums"),
            label="waves",
            mode="symbolic",
        )
        return found[1]

    def _wind(self, material: mi.UInt32) -> mi.Vector2f:
        row = dr.gather(mi.Vector4f, self.rows, material * 2)
        return mi.Vector2f(row.x, row.y)


@dataclass(frozen=True, eq=False)
class Wave:
    """Long wave at a position and time: wavenumber (rad/m), angular frequency (rad/s), amplitude (m), sine, cosine."""

    kx: mi.Float
    ky: mi.Float
    omega: mi.Float
    amplitude: mi.Float
    sine: mi.Float
    cosine: mi.Float
