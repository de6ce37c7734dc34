"""Summary of a scene as loaded: shapes, materials, radar, image and notes, without planning anything."""

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from sarmitsuba.scene.scatterers import SCATTERERS, ScattererKind, kinds_in_order
from sarmitsuba.scene.scene import Scene


@dataclass(frozen=True, eq=False)
class SceneSummary:
    """Content and view of a scene; ``str`` of it is one line per fact.

    Parameters
    ----------
    scene : as loaded
    """

    scene: Scene

    @staticmethod
    def of(scene: Scene) -> "SceneSummary":
        """Summary of a loaded scene."""
        return SceneSummary(scene)

    def as_dict(self) -> Mapping[str, object]:
        """JSON-able form: lengths in m, angles in degrees, frequencies in Hz."""
        scene, radar, image = self.scene, self.scene.radar, self.scene.image
        geometry = scene.geometry
        used = np.unique(geometry.face_material).tolist()
        size = np.ptp(geometry.bounds, axis=0).tolist() if geometry.n_faces else [0.0, 0.0, 0.0]
        look = np.array([image.center_x, image.center_y, image.height]) - radar.track.center_position
        distance = float(np.linalg.norm(look))
        return {
            "scene": scene.name,
            "method": scene.settings.method,
            "faces": geometry.n_faces,
            "meshes": len(geometry.mesh_names),
            "size": size,
            "materials": [scene.materials[i].name for i in used],
            "points": len(scene.points),
            **self._counts(),
            "mode": radar.mode,
            "center_frequency": radar.waveform.center_frequency,
            "bandwidth": radar.waveform.bandwidth,
            "channels": list(radar.channels),
            "pulses": radar.track.n_pulses,
            "slant_range": distance,
            "incidence_deg": float(np.degrees(np.arccos(np.clip(-look[2] / distance, -1.0, 1.0)))),
            "range_cell": radar.waveform.range_cell,
            "grid": image.grid,
            "extent": [image.extent_azimuth, image.extent_range],
            "center": [image.center_x + float(scene.offset[0]), image.center_y + float(scene.offset[1])],
            "notes": list(scene.notes),
        }

    def _counts(self) -> dict[str, int]:
        """Number of scatterers of each kind, by the kind's plural."""
        counts = {kind.plural: 0 for kind in kinds_in_order()} | {ScattererKind.plural: 0}
        for target in self.scene.scatterers:
            counts[SCATTERERS[target.kind].plural] += 1
        return counts

    def __str__(self) -> str:
        """Shapes, materials, radar, image, notes."""
        facts, scene, radar, image = self.as_dict(), self.scene, self.scene.radar, self.scene.image
        x, y, z = np.ptp(scene.geometry.bounds, axis=0)
        counted = ("points", *self._counts())
        parts = [f"{facts['faces']} faces in {facts['meshes']} meshes, {x:.4g} m x {y:.4g} m x {z:.4g} m"]
        parts += [f"{facts[name]} {name}" for name in counted if facts[name]]
        names = [scene.materials[i].name for i in np.unique(scene.geometry.face_material).tolist()]
        rows = [
            ("shapes", ", ".join(parts)),
            ("materials", ", ".join(names) or "none"),
            (
                "radar",
                f"{radar.mode}, {radar.waveform.center_frequency / 1e9:.4g} GHz, {radar.waveform.bandwidth / 1e6:.4g} "
                f"MHz, {'/'.join(radar.channels)}, {radar.track.n_pulses} pulses from {facts['slant_range']:.5g} m at "
                f"an incidence angle of {facts['incidence_deg']:.3g} deg",
            ),
            (
                "image",
                f"{image.grid}, {image.extent_azimuth:.4g} m (azimuth) x {image.extent_range:.4g} m (ground range), "
                f"range cell {radar.waveform.range_cell:.3g} m",
            ),
            ("method", scene.settings.method),
        ]
        lines = [f"{scene.name}:", *(f"  {name.ljust(9)}  {text}" for name, text in rows)]
        return "\n".join([*lines, *(f"note: {' '.join(note.split())}" for note in scene.notes)])
