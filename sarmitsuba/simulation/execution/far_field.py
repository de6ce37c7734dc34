"""Targets in the far field: aspect angles, centre and outline of a target, and the site from which sources are made."""

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from sarmitsuba.core.arrays import F64
from sarmitsuba.effects.flags import KernelFlags
from sarmitsuba.effects.fold_sections import Folds
from sarmitsuba.scene.mesh.sharp_edges import SharpEdges
from sarmitsuba.scene.scene import Scene
from sarmitsuba.simulation.execution.error_statement import followed_folds
from sarmitsuba.simulation.planning.sampling.density_plan import CELLS_PER_RESOLUTION
from sarmitsuba.simulation.planning.site import VIEW_TURN
from sarmitsuba.tracing.kernel.scene_tables import TraceScene, build_trace_scene
from sarmitsuba.tracing.scatterers.edges.diffraction import edges_of
from sarmitsuba.tracing.scatterers.sources import Site, passages_of

# slant range over the radius of the target: focusing removes the curvature of the wave, which hardly changes aspects
FAR = 1000.0
# cells of a volume's scatterers over the diameter of the target
BODY_CELLS = 32.0


@dataclass(frozen=True, eq=False)
class Aspects:
    """Directions from the target to the radar.

    Parameters
    ----------
    azimuth, elevation : (n,) float64, rad
    """

    azimuth: F64
    elevation: F64

    @property
    def directions(self) -> F64:
        """Unit vectors (n, 3) from the target to the radar, scene frame."""
        c = np.cos(self.elevation)
        return np.stack([c * np.cos(self.azimuth), c * np.sin(self.azimuth), np.sin(self.elevation)], axis=1)

    @property
    def by_azimuth(self) -> bool:
        """Whether only the azimuth changes."""
        return bool(np.ptp(self.azimuth) > 0.0)

    @property
    def whole_circle(self) -> bool:
        """Whether the azimuths, evenly spaced, cover the full circle."""
        n, turn = self.azimuth.size, float(np.ptp(self.azimuth))
        return n > 2 and turn * n / (n - 1) >= 2.0 * np.pi * (1.0 - 1e-9)


def target_middle(scene: Scene) -> tuple[F64, float]:
    """Centre of all visible objects, (3,) m, scene frame, and radius of the sphere about them, m."""
    around = scene.geometry.bounds if scene.geometry.n_faces else scene.places
    center = 0.5 * (around.min(axis=0) + around.max(axis=0))
    outline = np.concatenate([scene.geometry.vertices, scene.places])
    return center, float(np.linalg.norm(outline - center, axis=1).max())


def outline_of(scene: Scene) -> F64:
    """Points (n, 3) that outline all visible objects, m, scene frame."""
    return np.concatenate([scene.geometry.vertices, scene.places])


class FarSite(Site):
    """Site of a turntable target: fully lit, unresolved, and seen from the far field at all aspects.

    Parameters
    ----------
    scene, flags : see :class:`Site`
    aspects : directions to the radar
    """

    def __init__(self, scene: Scene, flags: KernelFlags, aspects: Aspects) -> None:
        # only pairs use it
        super().__init__(scene, flags, geometry_of(scene) if flags.diffuse_pairs else None)
        self.aspects = aspects

    @property
    def cells(self) -> tuple[float, float]:
        """See :class:`Site`: unresolved."""
        return np.inf, np.inf

    @property
    def distance(self) -> float:
        """See :class:`Site`: the far field."""
        return np.inf

    @cached_property
    def folds(self) -> Folds:
        """See :class:`Site`."""
        return followed_folds(self.scene, self.flags, self.wavelength)

    @property
    def cell_area(self) -> float:
        """See :class:`Site`: ten thousand scatterers in a volume as large as the target."""
        return (self.resolution / BODY_CELLS) ** 2

    @cached_property
    def edges(self) -> SharpEdges:
        """See :class:`Site`: not cut into pieces."""
        return edges_of(self.scene.geometry, self.scene.materials, self.wavelength)

    def towards(self, point: F64) -> F64:
        """See :class:`Site`: the aspects."""
        return self.aspects.directions

    @property
    def box(self) -> F64:
        """See :class:`Site`."""
        places = outline_of(self.scene)
        return np.stack([places.min(axis=0), places.max(axis=0)])

    @property
    def center(self) -> F64:
        """See :class:`Site`."""
        return target_middle(self.scene)[0]

    @cached_property
    def views(self) -> F64:
        """See :class:`Site`."""
        center, radius = target_middle(self.scene)
        look = self.aspects.directions
        turn = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(look, axis=0), axis=1))])
        wanted = np.linspace(0.0, turn[-1], max(3, 2 * int(turn[-1] / (2.0 * VIEW_TURN)) + 1))
        pick = np.searchsorted(turn, wanted - 1e-9)
        return np.asarray(center + look[pick] * max(FAR * radius, 1.0))

    @property
    def scatterer_cell(self) -> float:
        """See :class:`Site`."""
        return self.scene.settings.scatterer_cell or 0.5 * self.wavelength / CELLS_PER_RESOLUTION

    @property
    def resolution(self) -> float:
        """See :class:`Site`: as large as the target."""
        return 2.0 * target_middle(self.scene)[1]

    @property
    def block(self) -> int:
        """See :class:`Site`."""
        return 1

    def shares(self, points: F64) -> F64:
        """See :class:`Site`."""
        return np.ones(len(points))

    def light(self, points: F64) -> F64:
        """See :class:`Site`."""
        return np.ones(len(points))


def geometry_of(scene: Scene) -> TraceScene | None:
    """Mesh of a scene on the device, with what attenuates waves; None where there is neither."""
    passages = passages_of(scene)
    if not scene.geometry.n_faces and not passages:
        return None
    made = build_trace_scene(
        scene.geometry, scene.materials, scene.radar.waveform.wavelength, places=scene.places
    )
    return replace(made, passages=passages)
