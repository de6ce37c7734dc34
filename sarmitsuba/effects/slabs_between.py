"""Search for slabs that transmit waves to objects behind them."""

import numpy as np

from sarmitsuba.core.arrays import F64
from sarmitsuba.scene.materials.material import Material
from sarmitsuba.scene.materials.slab import lets_through
from sarmitsuba.scene.scene import Scene

# faces up to this many thicknesses behind one of the same material may be the other face of its slab
SAME_SLAB = 1.5


def seen_through(scene: Scene, antenna: F64) -> tuple[Material, ...]:
    """Slab materials that transmit and have objects of the scene behind one of their faces.

    Parameters
    ----------
    scene : as loaded
    antenna : (n, 3) positions that bound the aperture, m

    Notes
    -----
    An object is behind a face if it lies beyond the plane of the face as seen from the antenna, whether or not rays hit
    it there.
    """
    geometry = scene.geometry
    if not geometry.n_faces:
        return ()
    wavelength = scene.radar.waveform.wavelength
    used = np.unique(geometry.face_material)
    slabs = [i for i in used if lets_through(scene.materials[i], wavelength)]
    if not slabs:
        return ()
    hidden = np.array([m.invisible for m in scene.materials])[geometry.face_material]
    corners = geometry.vertices[np.unique(geometry.faces[~hidden])]
    others = np.concatenate([corners, scene.places])
    return tuple(
        scene.materials[i]
        for i in slabs
        if _something_behind(
            geometry.vertices[geometry.faces[geometry.face_material == i]],
            others,
            antenna,
            SAME_SLAB * scene.materials[i].thickness,
        )
    )


def _something_behind(faces: F64, points: F64, antenna: F64, slack: float) -> bool:
    """Whether any point lies farther than ``slack`` (m) beyond the plane of any face (n, 3, 3)."""
    normal = np.cross(faces[:, 1] - faces[:, 0], faces[:, 2] - faces[:, 0])
    length = np.linalg.norm(normal, axis=1)
    for n, corner in zip(normal[length > 0] / length[length > 0, None], faces[length > 0, 0], strict=True):
        sides = np.sign((antenna - corner) @ n)
        height = (points - corner) @ n
        if any(bool((height * side < -slack).any()) for side in np.unique(sides) if side):
            return True
    return False
