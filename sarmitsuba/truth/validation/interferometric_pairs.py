"""Interferometric pairs of small scenes at drawn headings, sides and look angles, with automatic settings."""

from dataclasses import dataclass, replace
from typing import Literal

import numpy as np

from sarmitsuba.analysis.baseline import second_pass
from sarmitsuba.analysis.interferometry import Interferogram, interferogram
from sarmitsuba.core.arrays import F64
from sarmitsuba.core.constants import SPEED_OF_LIGHT
from sarmitsuba.radar.radar import Radar
from sarmitsuba.scene.materials.material import Material
from sarmitsuba.scene.scene import Scene
from sarmitsuba.signal.focusing import default_grid, focus
from sarmitsuba.signal.image import SarImage
from sarmitsuba.signal.noise import add_noise
from sarmitsuba.signal.raw_data import RawData
from sarmitsuba.simulation.execution.render import simulate
from sarmitsuba.truth import theory
from sarmitsuba.truth.validation import targets
from sarmitsuba.truth.validation.chain import Parameter, make_scene, suppress_warnings
from sarmitsuba.truth.validation.comparison import CRITICAL_DISTANCE, Comparison

ROUGH = Material(
    "rough", permittivity=5.0 - 0.5j, diffuse_law="constant", diffuse_level_db=-8.0, rms_height=0.05
)
FREQUENCY = 9.65e9
WAVELENGTH = SPEED_OF_LIGHT / FREQUENCY


@dataclass(frozen=True)
class RadarSetting:
    """Geometry of a radar that images the origin.

    Parameters
    ----------
    heading, look : deg
    side : ``left`` or ``right``
    slant_range, cell : m; ``cell`` in slant range
    azimuth_cell : m
    """

    heading: float
    look: float
    side: str
    slant_range: float
    cell: float
    azimuth_cell: float

    @staticmethod
    def drawn(seed: int, cell: float, look: tuple[float, float] = (28.0, 50.0)) -> "RadarSetting":
        """Random setting from a seed."""
        rng = np.random.default_rng([seed, 1998])
        return RadarSetting(
            heading=float(rng.uniform(0.0, 360.0)),
            look=float(rng.uniform(*look)),
            side=("left", "right")[rng.integers(2)],
            slant_range=float(np.exp(rng.uniform(np.log(5e3), np.log(50e3)))),
            cell=cell,
            azimuth_cell=float(cell * rng.uniform(0.8, 1.6)),
        )

    @property
    def incidence(self) -> float:
        """Incidence angle on level ground, rad."""
        return float(np.radians(self.look))

    @property
    def axes(self) -> F64:
        """Local axes in the scene frame, (3, 3): rows away from the radar, to the left of that, up."""
        heading = np.radians(self.heading)
        away = np.array([np.cos(heading), -np.sin(heading), 0.0]) * (1.0 if self.side == "right" else -1.0)
        return np.stack([away, [-away[1], away[0], 0.0], [0.0, 0.0, 1.0]])

    def parallelogram(
        self, corner: tuple[float, ...], a: tuple[float, ...], b: tuple[float, ...]
    ) -> targets.Mesh:
        """Parallelogram given away from the radar, to the left of that, and up."""
        corners = [np.asarray(v, dtype=np.float64) @ self.axes for v in (corner, a, b)]
        return targets.parallelogram(corners[0], corners[1], corners[2])

    def local(self, points: F64) -> F64:
        """Scene points (..., 3) away from the radar, to the left of that, and up."""
        return np.asarray(points @ self.axes.T)

    def scene(
        self, meshes: list[targets.Mesh], materials: tuple[Material, ...], extent: float, **more: Parameter
    ) -> Scene:
        """Scene of meshes in this setting; ``more`` are parameters of sensor and film."""
        parameters: dict[str, Parameter] = {
            "mode": "spotlight",
            "slant_range": self.slant_range,
            "look_angle_deg": self.look,
            "heading_deg": self.heading,
            "look_side": self.side,
            "aim_x": 0.0,
            "aim_y": 0.0,
            "aim_z": 0.0,
            "center_frequency": FREQUENCY,
            "bandwidth": SPEED_OF_LIGHT / 2.0 / self.cell,
            "azimuth_resolution": self.azimuth_cell,
            "image_grid": "ground",
            "image_center_x": 0.0,
            "image_center_y": 0.0,
            "image_height": 0.0,
            "image_extent_azimuth": extent,
            "image_extent_range": extent,
            **more,
        }
        kinds = [i % len(materials) for i in range(len(meshes))] if len(materials) > 1 else None
        return make_scene(targets.geometry(meshes, kinds), materials, parameters)


@dataclass(frozen=True, eq=False)
class Pair:
    """Both passes over a scene.

    Parameters
    ----------
    raws, images : first and second, without receiver noise unless `with_noise` made them
    setting : geometry of the radar
    """

    raws: tuple[RawData, RawData]
    images: tuple[SarImage, SarImage]
    setting: RadarSetting

    @property
    def radars(self) -> tuple[Radar, Radar]:
        """Radars of both passes."""
        return self.raws[0].radar, self.raws[1].radar

    def with_noise(self, ratio: float) -> "Pair":
        """Pair with noise of ``ratio`` times the image's mean sigma0 in each receiver."""
        warm = focus(
            _noisy(self.raws[0], 1.0),
            self.images[0].grid,
            range_window="rectangular",
            azimuth_window="rectangular",
        )
        temperature = ratio * float(self.images[0].sigma0().mean()) / warm.metadata["focus"]["nesz"]
        one, two = (_noisy(raw, temperature) for raw in self.raws)
        grid = self.images[0].grid
        images = tuple(
            focus(raw, grid, range_window="rectangular", azimuth_window="rectangular") for raw in (one, two)
        )
        return Pair((one, two), (images[0], images[1]), self.setting)

    @property
    def perpendicular(self) -> float:
        """Perpendicular baseline of broadside passes, m, from the tracks alone, positive upwards; of the receivers."""
        second = self.radars[1].receiver or self.radars[1].track
        moved = second.center_position - self.radars[0].track.center_position
        away, _, up = self.setting.axes
        theta = self.setting.incidence
        return float(moved @ (np.cos(theta) * away + np.sin(theta) * up))

    def interferogram(self, looks: tuple[int, int] | None = None) -> Interferogram:
        """Their interferogram."""
        return interferogram(*self.images, looks)


def pair_of(
    setting: RadarSetting,
    meshes: list[targets.Mesh],
    extent: float,
    *,
    materials: tuple[Material, ...] = (ROUGH,),
    relief: float = 0.0,
    baseline: float | None = None,
    window: str = "rectangular",
    passes: Literal[1, 2] = 2,
    days: float = 0.0,
) -> Pair:
    """Simulate both passes over a scene with automatic settings and focus them on the first's grid.

    Parameters
    ----------
    setting : geometry of the radar
    meshes : see `RadarSetting.parallelogram`; materials are taken in turn where there are several
    extent : of the image, m
    materials : of the meshes
    relief, baseline, passes : as for `sarmitsuba.analysis.baseline.second_pass`
    window : in azimuth and range
    days : from the first pass to the second
    """
    first = setting.scene(meshes, materials, extent)
    offset = second_pass(first.radar, relief, baseline, passes)
    second = setting.scene(meshes, materials, extent, **offset.parameters)
    second = replace(second, settings=replace(second.settings, pass_days=days))
    with suppress_warnings():
        raws = simulate(first), simulate(second)
    grid = default_grid(first.radar, first.image)
    one, two = (focus(raw, grid, range_window=window, azimuth_window=window) for raw in raws)
    return Pair(raws, (one, two), setting)


def _noisy(raw: RawData, temperature: float) -> RawData:
    """Raw data with the noise of a receiver of that temperature, K."""
    return add_noise(replace(raw, radar=replace(raw.radar, noise_temperature=temperature)))


def phase_law(label: str, away: F64, gamma: float, looks: float) -> Comparison:
    """Phases less their mean (rad), of blocks of so many independent looks, against their distribution.

    Parameters
    ----------
    label : of the comparison, which tells coherence or noise
    away : any shape, rad
    gamma, looks : coherence and independent looks of each
    """
    sample = np.sort(away.ravel())
    level = np.linspace(-2.0, 2.0, 81)
    return Comparison(
        label,
        level,
        theory.interferometric_phase_cdf(level, gamma, looks),
        np.searchsorted(sample, level) / sample.size,
        tolerance=float(CRITICAL_DISTANCE / np.sqrt(sample.size)),
        reason="Kolmogorov's critical distance at 99.9 %",
        unit="",
        shown=45,
    )
