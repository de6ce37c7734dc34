"""Search for the path of an echo that is not a finite number: its pulse, shapes and materials."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np

from sarmitsuba.core.arrays import all_finite
from sarmitsuba.core.errors import ExtensionError, SceneError
from sarmitsuba.scene.materials.map_materials import list_with_parts
from sarmitsuba.simulation.execution.recording import Recording
from sarmitsuba.tracing.kernel.stage import own_stages
from sarmitsuba.tracing.kernel.state import RECIPROCAL

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from sarmitsuba.effects.flags import KernelFlags
    from sarmitsuba.machine.backend import mi
    from sarmitsuba.scene.geometry import Geometry
    from sarmitsuba.scene.materials.material import Material
    from sarmitsuba.tracing.kernel.scene_tables import TraceScene
    from sarmitsuba.tracing.kernel.state import Contribution

# such paths that there is room for; one is named
ROOM = 16
REMEDY = "this is a defect of the program: report the scene; until it is mended leave the shape out or lower max_depth"


class NotFinite:
    """Filter of a recording that keeps contributions with a number that is not finite."""

    def passes(self, contribution: Contribution) -> mi.Bool:
        """Lanes whose amplitudes, slant range, range rate or phase centre are not finite."""
        return ~contribution.finite


def find_blame(
    launch: Callable[[Recording], None],
    n_lanes: int,
    max_depth: int,
    n_channels: int,
    scene: TraceScene,
    geometry: Geometry,
    materials: tuple[Material, ...],
    label: Callable[[int], str],
) -> str:
    """Description of the first path that is not a finite number; empty where none is found again.

    Parameters
    ----------
    launch : runs the launch again into a recording, and evaluates it
    n_lanes : rays of the launch; 1 for a source of scatterers
    max_depth, n_channels : of the launch
    scene : that was traced, of ``geometry``
    materials : of the geometry
    label : gives the text for a pulse of the launch, from its number
    """
    recording = Recording(n_lanes, n_channels, (ROOM, n_lanes * max_depth), NotFinite())
    launch(recording)
    rows = recording.rows()
    if not len(rows.labels):
        return ""
    kind, order, pulse = (int(v) for v in rows.labels[0, 1:4])
    hits = (order + 1) // 2 if kind == RECIPROCAL else order
    faces = rows.chains(np.full(len(rows.labels), hits))[1][0]
    faces = scene.geometry_faces[faces[faces >= 0]]
    echo = f"{label(pulse)}: an echo of {order} bounce{'s' if order > 1 else ''}"
    if not faces.size:
        return f"{echo} from a scatterer other than a surface (wire, edge, volume or pair)"
    face = int(faces[-1])
    shape = geometry.mesh_names[int(np.searchsorted(geometry.mesh_face_offset, face, side="right")) - 1]
    material = list_with_parts(materials)[int(geometry.face_material[face])]
    return f'{echo} that ends on the shape "{shape}", face {face}, material "{material.name}",'


def blame_stages(flags: KernelFlags, where: str, finite: Callable[[KernelFlags], bool]) -> None:
    """Stop a run whose echoes are finite numbers without a stage of an extension.

    Parameters
    ----------
    flags : of the launch whose echoes are not finite
    where : scene and pulse
    finite : whether the launch's echoes are finite with other flags

    Raises
    ------
    ExtensionError
        They are without one of the stages, or without all.
    """
    own = own_stages(flags)
    for names in dict.fromkeys((*((name,) for name in own), own)):
        if names and finite(replace(flags, extra=flags.extra - set(names))):
            raise ExtensionError(
                f"{where}: stage of the trace kernel {', '.join(map(repr, names))}: gives an echo that is not a "
                "finite number"
            )


def check_traced(
    data: NDArray[np.complexfloating], power: float, where: str, culprit: Callable[[], str] = str
) -> None:
    """Stop a run whose echoes are not finite numbers.

    Parameters
    ----------
    data : pulses or rows first; empty where ``power`` is sufficient
    power : of all contributions
    where : scene and pulse
    culprit : function that finds the path and describes it

    Raises
    ------
    SceneError
        They are not finite.
    """
    if np.isfinite(power) and all_finite(data):
        return
    what = culprit() or "the sum of the echoes"
    raise SceneError(f"{where}: {what} is not a finite number; {REMEDY}")
