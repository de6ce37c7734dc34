"""Facets of round metal bodies: their distance from the smooth surface, and its effect."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from sarmitsuba.core.arrays import F64, I64
from sarmitsuba.core.units import db_from_power
from sarmitsuba.scene.geometry import Geometry
from sarmitsuba.scene.materials.material import Material
from sarmitsuba.scene.mesh.smooth_surface import facet_sagitta, smooth_surface
from sarmitsuba.scene.visible_faces import VisibleFaces

# relative amplitude of the error by facets over their sagitta in wavelengths: balls of 320, 1280 and 5120 facets at 24
# GHz have 15.2, 1.55 and 0.42 dB rms at 0.53, 0.14 and 0.034 wavelengths; and the largest
ERROR_OVER_SAGITTA, LARGEST_ERROR = 1.8, 1.0
# sagitta over the wavelength from which on facets are warned of, and which is recommended: about 0.7 and 0.2 dB
COARSE, FINE = 1.0 / 16.0, 1.0 / 64.0
# share of the area of curved metal that is warned of; most metal faces that are examined
LEAST_SHARE, MOST_FACES = 0.05, 300_000


@dataclass(frozen=True, eq=False)
class RoundFacets:
    """Facets of metal that approximate curved surface.

    Parameters
    ----------
    face : (n,) int64, their numbers in the geometry
    sagitta : (n,) float64, wavelengths between each and the smooth surface
    area : (n,) float64, m^2
    """

    face: I64
    sagitta: F64
    area: F64

    @staticmethod
    def of(geometry: Geometry, materials: Sequence[Material], wavelength: float) -> "RoundFacets":
        """Curved metal facets of a geometry; none are looked for among more than ``MOST_FACES``."""
        none = RoundFacets(np.zeros(0, dtype=np.int64), np.zeros(0), np.zeros(0))
        if not geometry.n_faces:
            return none
        seen = VisibleFaces.of(geometry, materials)
        face, t = seen.face[seen.metal], seen.corners[seen.metal]
        if not 0 < len(face) <= MOST_FACES:
            return none
        sagitta = facet_sagitta(t, geometry.face_group[face]) / wavelength
        area = 0.5 * np.linalg.norm(np.cross(t[:, 1] - t[:, 0], t[:, 2] - t[:, 0]), axis=1)
        curved = sagitta > 0.0
        return RoundFacets(face[curved], sagitta[curved], area[curved])

    @property
    def error_db(self) -> float:
        """Energy of the error of the echoes of curved metal, relative to them, dB, by law; -inf without any."""
        if not self.face.size:
            return -np.inf
        error = np.minimum(ERROR_OVER_SAGITTA * self.sagitta, LARGEST_ERROR)
        return db_from_power(max(float(np.average(np.square(error), weights=self.area)), 1e-300))

    @property
    def needed(self) -> int:
        """Number of facets with which they would lie within ``FINE`` wavelengths of the smooth surface."""
        return int(np.ceil(np.maximum(self.sagitta / FINE, 1.0).sum()))

    @property
    def doubt(self) -> str:
        """Doubt about them with its remedy; empty where they are fine."""
        coarse = self.sagitta > COARSE
        if not self.face.size or self.area[coarse].sum() <= LEAST_SHARE * self.area.sum():
            return ""
        return (
            f"{self.face.size} facets of round metal lie up to {self.sagitta.max():.2g} wavelengths off a smooth "
            f"surface, and echo as facets; about {self.needed} are needed, or --smooth"
        )

    def as_dict(self) -> dict[str, object]:
        """Values for JSON; empty without curved metal."""
        if not self.face.size:
            return {}
        return {
            "count": int(self.face.size),
            "sagitta_wavelengths": round(float(self.sagitta.max()), 5),
            "needed": self.needed,
            "error_db": round(self.error_db, 2),
            "kind": "law",
        }


def smooth_geometry(geometry: Geometry, sagitta: float) -> Geometry:
    """The geometry with finer facets, which lie within ``sagitta`` m of the smooth surface of each group."""
    vertices, faces, parent = smooth_surface(geometry.vertices, geometry.faces, _apart(geometry), sagitta)
    count = np.bincount(geometry.face_mesh[parent], minlength=len(geometry.mesh_names))
    return replace(
        geometry,
        vertices=vertices,
        faces=faces,
        face_material=geometry.face_material[parent],
        face_group=geometry.face_group[parent],
        mesh_face_offset=np.concatenate([[0], np.cumsum(count)]).astype(np.int64),
        mesh_convex=(),
    )


def _apart(geometry: Geometry) -> I64:
    """Group (n_faces,) of each face, those that are no part of a curved surface each with its own normal."""
    group = geometry.face_group.astype(np.int64)
    flat = facet_sagitta(geometry.vertices[geometry.faces], geometry.face_group) == 0.0
    group[flat] = int(group.max()) + 1 + np.arange(int(flat.sum()))
    return np.unique(group, return_inverse=True)[1].reshape(-1)
