"""Targets seen from far away: aspects, the middle and outline of a target, and what makers of sources are told."""

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from sarmitsuba.effects.flags import KernelFlags
from sarmitsuba.mesh.sharp_edges import SharpEdges
from sarmitsuba.scene.scene import Scene
from sarmitsuba.simulation.sampling.density_plan import CELLS_PER_RESOLUTION
from sarmitsuba.simulation.sources.kind import passages_of
from sarmitsuba.simulation.sources.site import VIEW_TURN, Site
from sarmitsuba.trace.edges import edges_of
from sarmitsuba.trace.scene_tables import TraceScene, build_trace_scene

F64 = NDArray[np.float64]

# slant range over the radius of the target: curvature of the wave is then focused away and hardly turns aspects
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
        """(n, 3) unit vectors."""
        c = np.cos(self.elevation)
        return np.stack([c * np.cos(self.azimuth), c * np.sin(self.azimuth), np.sin(self.elevation)], axis=1)

    @property
    def by_azimuth(self) -> bool:
        """True when the azimuth is what changes."""
        return bool(np.ptp(self.azimuth) > 0.0)

    @property
    def whole_circle(self) -> bool:
        """True when the azimuths, evenly spaced, go all the way round."""
        n, turn = self.azimuth.size, float(np.ptp(self.azimuth))
        return n > 2 and turn * n / (n - 1) >= 2.0 * np.pi * (1.0 - 1e-9)


def target_middle(scene: Scene) -> tuple[F64, float]:
    """Middle of everything that there is to see, (3,) m, scene frame, and the radius of what surrounds it, m."""
    around = scene.geometry.bounds if scene.geometry.n_faces else scene.places
    center = 0.5 * (around.min(axis=0) + around.max(axis=0))
    outline = np.concatenate([scene.geometry.vertices, scene.places])
    return center, float(np.linalg.norm(outline - center, axis=1).max())


def outline_of(scene: Scene) -> F64:
    """(n, 3) everything that there is to see, m, scene frame."""
    return np.concatenate([scene.geometry.vertices, scene.places])


class FarSite(Site):
    """The site of a turntable: everything is lit and resolved by nothing, from as far as the aspects are.

    Parameters
    ----------
    scene, flags : see :class:`Site`
    aspects : directions to the radar
    """

    def __init__(self, scene: Scene, flags: KernelFlags, aspects: Aspects) -> None:
        # pairs alone ask for it
        super().__init__(scene, flags, geometry_of(scene) if flags.diffuse_pairs else None)
        self.aspects = aspects

    @property
    def wire_step(self) -> float:
        """See :class:`Site`: a wire is one node."""
        return float("inf")

    @property
    def cell_area(self) -> float:
        """See :class:`Site`: ten thousand scatterers in a body as large as the target."""
        return (self.resolution / BODY_CELLS) ** 2

    @cached_property
    def edges(self) -> SharpEdges:
        """See :class:`Site`: whole."""
        return edges_of(self.scene.geometry, self.scene.materials, self.wavelength)

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

    def shares(self, points: F64) -> F64:
        """See :class:`Site`."""
        return np.ones(len(points))

    def light(self, points: F64) -> F64:
        """See :class:`Site`."""
        return np.ones(len(points))


def geometry_of(scene: Scene) -> TraceScene | None:
    """Mesh of a scene on the device, with what lets a part of the waves pass; None where there is neither."""
    if not scene.geometry.n_faces and not scene.volumes:
        return None
    made = build_trace_scene(
        scene.geometry, scene.materials, scene.radar.waveform.wavelength, places=scene.places
    )
    return replace(made, passages=passages_of(scene))


__all__ = ["FAR", "Aspects", "FarSite", "geometry_of", "outline_of", "target_middle"]
