"""Vehicle-like and boat-like bodies for data sets: closed solids, x forward, y to the left, metres.

They are no models of any make: boxes, wedges and hulls of the sizes of their kinds, so that shapes differ in length,
height, cabin and freeboard.
"""

import numpy as np
import trimesh
from solids import box, check_closed, merged, prism, revolve

Bodies = dict[str, trimesh.Trimesh]


def targets() -> Bodies:
    """Build ten bodies by file name, in folders of their classes."""
    bodies = {
        "vehicle/sedan": _car(4.6, 1.8, (0.9, 1.45), (-1.5, -0.9, 0.5, 1.2)),
        "vehicle/estate": _car(4.8, 1.85, (0.95, 1.5), (-2.3, -2.0, 0.5, 1.3)),
        "vehicle/van": _car(5.4, 2.0, (1.1, 2.4), (-2.6, -2.6, 1.6, 2.3)),
        "vehicle/pickup": _joined(_car(5.3, 1.9, (0.9, 1.75), (-0.5, -0.3, 0.9, 1.5))),
        "vehicle/lorry": _joined(
            box((-4.0, 1.6), (-1.2, 1.2), (1.0, 3.6)),
            box((1.8, 3.8), (-1.15, 1.15), (0.5, 2.8)),
            box((-3.9, 1.79), (-0.5, 0.5), (0.6, 0.99)),
            *(box((x, x + 0.9), (y, y + 0.3), (0.0, 0.59)) for x in (-3.4, -2.3, 0.4) for y in (-1.1, 0.8)),
            *(box((2.3, 3.2), (y, y + 0.3), (0.0, 0.49)) for y in (-1.1, 0.8)),
        ),
        "boat/launch": _boat(7.0, 2.4, 0.9, [((-1.5, 1.0), 0.8, 1.2)]),
        "boat/cutter": _boat(11.0, 3.4, 1.2, [((-2.5, 1.5), 1.1, 1.5)], mast=(0.5, 6.0)),
        "boat/trawler": _boat(16.0, 5.0, 2.0, [((1.0, 4.0), 1.8, 2.8)], mast=(-3.0, 6.0)),
        "boat/barge": _boat(22.0, 5.2, 1.4, [((-10.0, -7.0), 2.0, 2.2)], blunt=True),
        "boat/ferry": _boat(20.0, 6.0, 1.8, [((-8.0, 5.0), 2.4, 2.2), ((1.0, 4.0), 1.8, 4.4)]),
    }
    return {f"targets/{name}": check_closed(name, mesh) for name, mesh in bodies.items()}


def _car(
    length: float, width: float, height: tuple[float, float], cabin: tuple[float, float, float, float]
) -> trimesh.Trimesh:
    """Body on four wheels; ``height`` of bonnet and roof, ``cabin`` the x of its foot, roof, roof and foot."""
    half, clear = 0.5 * length, 0.3
    profile = [(-half, clear), (half, clear), (half, height[0] - 0.15), (half - 0.3, height[0])]
    profile += [(cabin[3], height[0]), (cabin[2], height[1]), (cabin[1], height[1])]
    if cabin[0] > -half + 0.05:
        profile += [(cabin[0], height[0]), (-half, height[0])]
    else:
        profile += [(-half, height[0])]
    body = prism(profile, (-0.5 * width, 0.5 * width))
    radius, tread = 0.29, 0.2
    at = [(x, y) for x in (-0.3 * length, 0.3 * length) for y in (-0.45 * width, 0.45 * width)]
    wheels = [
        prism(
            [
                (x + radius * np.cos(a), radius + radius * np.sin(a))
                for x, a in ((x, np.pi * (k + 0.5) / 6) for k in range(12))
            ],
            (y - 0.5 * tread, y + 0.5 * tread),
        )
        for x, y in at
    ]
    return _joined(body, *wheels)


def _boat(
    length: float,
    beam: float,
    freeboard: float,
    houses: list[tuple[tuple[float, float], float, float]],
    *,
    mast: tuple[float, float] | None = None,
    blunt: bool = False,
) -> trimesh.Trimesh:
    """Hull with vertical sides and a pointed or blunt bow; houses (span in x, half width, height) on its deck."""
    half, side = 0.5 * length, 0.5 * beam
    bow = [(half, -0.6 * side), (half, 0.6 * side)] if blunt else [(half, 0.0)]
    plan = [(-half, -side), (0.55 * half, -side), *bow, (0.55 * half, side), (-half, side)]
    hull = prism(plan, (0.0, freeboard))
    # a prism is extruded along y: turn it so that its plan is level and it stands upright
    hull.vertices = np.round(hull.vertices[:, [0, 2, 1]], 6)
    hull.faces = hull.faces[:, ::-1]
    parts = [hull]
    deck = freeboard + 0.01
    for span, wide, high in houses:
        parts.append(box(span, (-wide, wide), (deck, deck + high)))
        deck = deck if high > 4.0 else freeboard + 0.01
    if mast is not None:
        x, top = mast
        parts.append(revolve([(0.0, deck), (0.08, deck), (0.08, deck + top), (0.0, deck + top)], (x, 0.0), 8))
    return _joined(*parts)


def _joined(*solids: trimesh.Trimesh) -> trimesh.Trimesh:
    return merged(np.concatenate([solid.triangles for solid in solids]))
