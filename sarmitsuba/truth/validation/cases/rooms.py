"""Rooms behind transparent walls, by the whole chain."""

import numpy as np

from sarmitsuba.core.arrays import F64
from sarmitsuba.core.constants import SPEED_OF_LIGHT
from sarmitsuba.core.units import db_from_power
from sarmitsuba.scene.materials.material import Material
from sarmitsuba.scene.scene import Scene
from sarmitsuba.scene.settings import TraceSettings
from sarmitsuba.signal.metrics import point_target_in
from sarmitsuba.truth.validation import targets
from sarmitsuba.truth.validation.band_sampling import X_BAND
from sarmitsuba.truth.validation.cases import CASES, CaseEntry
from sarmitsuba.truth.validation.cases.slabs import BOARD, SOURCE, WALLS, dyad
from sarmitsuba.truth.validation.chain import chain, make_scene
from sarmitsuba.truth.validation.comparison import Case, Comparison

ROOM_BAND = 600e6  # Hz


def corner_behind_pane(quick: bool = False) -> Case:
    """The corner of a room behind a wall of glass or brick: place in range and level, through the whole chain."""
    rng = np.random.default_rng(19)
    names = ("window glass 6 mm", "brick 0.12 m") if quick else ("window glass 6 mm", "brick 0.12 m", "board")
    walls = WALLS | {"board": (BOARD, 0.1, 0.0)}
    comparisons = []
    for name in names:
        wall = walls[name]
        material = Material("pane", permittivity=wall[0], thickness=wall[1])
        shift: dict[str, list[float]] = {"want": [], "got": []}
        level: dict[str, list[list[float]]] = {"want": [], "got": []}
        for _ in range(1 if quick else 4):
            heading, look = rng.uniform(125.0, 145.0), rng.uniform(48.0, 60.0)
            turn, far = np.radians(rng.uniform(15.0, 45.0)), rng.uniform(1.5, 3.0)
            own, other = (room(heading, look, turn, far, m) for m in (material, None))
            sight = other.radar.track.center_position
            sight = sight / np.linalg.norm(sight)
            along = np.array([sight[0], sight[1], 0.0]) / np.hypot(*sight[:2])
            normal = np.cos(turn) * along + np.sin(turn) * np.cross([0.0, 0.0, 1.0], along)
            h = np.cross(-sight, [0.0, 0.0, 1.0])
            h /= np.linalg.norm(h)
            images = [chain(scene, seed=1) for scene in (own, other)]
            peaks = [[point_target_in(image, c) for c in ("HH", "VV")] for image in images]
            shift["got"].append(peaks[0][1].range_position - peaks[1][1].range_position)
            level["got"].append([float(db_from_power(a.rcs / b.rcs)) for a, b in zip(*peaks, strict=True)])
            seen = [_peak_through(q, normal, sight, wall) for q in (h, np.cross(h, -sight))]
            level["want"].append([each[0] for each in seen])
            shift["want"].append(seen[1][1])
        x = np.arange(float(len(shift["want"])))
        comparisons.append(
            Comparison(
                f"{name}, farther in range",
                x,
                np.asarray(shift["want"]),
                np.asarray(shift["got"]),
                tolerance=5e-3,
                reason="two hundredths of a range cell: the pane's own side lobes under the peak",
                unit="m",
            )
        )
        comparisons += [
            Comparison(
                f"{name}, level, {channel}",
                x,
                np.asarray(level["want"])[:, i],
                np.asarray(level["got"])[:, i],
                tolerance=0.1,
                reason="0.1 dB asked for; the pane's own side lobes",
                unit="dB",
            )
            for i, channel in enumerate(("HH", "VV"))
        ]
    return Case(
        name="corner_behind_pane",
        topic="materials",
        title="The corner of a room behind a wall that lets waves through",
        formula="peak of the sum over the band of q . D D q e^2jkr, D = T e^jkt cos of either polarisation",
        source=SOURCE,
        x_label="draw",
        y_label="m or dB against the same without the pane",
        comparisons=tuple(comparisons),
        note="A metal trihedral of 0.6 m, upright panes of 6 m; drawn headings, look angles, orientations and "
        "distances, seed 19. X band, 600 MHz.",
    )


def _peak_through(q: F64, normal: F64, sight: F64, wall: tuple[complex, float, float]) -> tuple[float, float]:
    """Level (dB) and place (m, farther) of a compressed pulse's peak that came twice through a wall."""
    frequency = X_BAND + ROOM_BAND * (np.arange(-128, 129) / 257.0)
    both_legs = []
    for f in frequency:
        through = dyad(normal, -sight, wall, SPEED_OF_LIGHT / f)
        both_legs.append(f / X_BAND * (q @ through @ through @ q))
    farther = np.linspace(-0.1, 0.4, 5001)
    pulse = np.abs(
        np.exp(4j * np.pi / SPEED_OF_LIGHT * np.outer(farther, frequency)) @ both_legs / len(frequency)
    )
    return float(20.0 * np.log10(pulse.max())), float(farther[np.argmax(pulse)])


def room(heading: float, look: float, turn: float, far: float, pane: Material | None) -> Scene:
    """A trihedral that opens towards the radar, with an upright pane before it or without."""
    corner = targets.trihedral(0.6, "triangular")
    meshes, materials, numbers = [(corner.vertices, corner.faces)], list(targets.PEC), [0]
    if pane is not None:
        psi = np.radians(heading)
        along = np.array([-np.cos(psi), np.sin(psi), 0.0])  # towards the radar on the ground
        across = np.cross([0.0, 0.0, 1.0], along)
        edge = -np.sin(turn) * along + np.cos(turn) * across
        middle = far * along + np.array([0.0, 0.0, far / np.tan(np.radians(look))])
        meshes.append(targets.parallelogram(middle - 3.0 * edge - [0, 0, 3.0], 6.0 * edge, [0.0, 0.0, 6.0]))
        materials.append(pane)
        numbers.append(1)
    return make_scene(
        targets.geometry(meshes, numbers),
        tuple(materials),
        {
            "slant_range": 10e3,
            "heading_deg": heading,
            "look_angle_deg": look,
            "azimuth_resolution": 1.0,
            "bandwidth": ROOM_BAND,
            "center_frequency": X_BAND,
            "polarisation": "HH,VV",
            "speed": 150.0,
            "aim_x": 0.0,
            "aim_y": 0.0,
            "aim_z": 0.0,
            "image_extent_azimuth": 16.0,
            "image_extent_range": 12.0,
        },
        settings=TraceSettings(ray_spacing=0.02, max_depth=3),  # both scenes alike: rims cancel
    )


CASES.register(CaseEntry("corner_behind_pane", "materials", corner_behind_pane))
