"""Facade relief: recessed windows and balconies, which form small corner reflectors; options of the pavement."""

from dataclasses import dataclass, fields

import numpy as np
from numpy.typing import NDArray

from sarmitsuba.core.arrays import F64, I32
from sarmitsuba.core.errors import SceneError
from sarmitsuba.core.parameters import did_you_mean, one_line
from sarmitsuba.loading.importing.parts import Parts

KINDS = ("windows", "balconies", "kerb")
NONE = "none"
WINDOW_TRIANGLES, BALCONY_TRIANGLES = 18, 22
# least margin between a window and its bay or storey at each side, and height of walls too low for windows, m
_RIM, _LOWEST = 0.15, 2.0
# thickness of a balcony's slab and of its parapets, and height of its lower side above the storey's floor, m
_SLAB, _PARAPET, _RAISED = 0.18, 0.12, 0.02
# corners: bay, opening, pane, each counter-clockwise from outside
_QUAD = np.array([[0, 1, 2], [0, 2, 3]])
_RING = np.array(
    [[i, (i + 1) % 4, 4 + (i + 1) % 4] for i in range(4)] + [[i, 4 + (i + 1) % 4, 4 + i] for i in range(4)]
)
_WINDOW = np.concatenate([_RING, _RING + 4])
_PANE = _QUAD + 8


@dataclass(frozen=True)
class FacadeOptions:
    """Statistics of facade relief, and of the pavement before the walls.

    Parameters
    ----------
    windows, balconies, pavements : whether they are made
    seed : random seed; the same seed gives the same walls
    limit : most triangles of all walls together; buildings beyond it, the furthest from the origin, have plain walls
    bay : mean width of a bay, one window each, m
    window_width, window_height : mean, m
    recess : mean depth of the panes behind the wall, m
    spread : relative standard deviation of these five, drawn once per building
    share : share of bays with a window
    balcony_share : share of columns of bays with balconies, from the second storey on
    balcony_depth, parapet : depth of balconies, and height of their parapets over their floor, m
    kerb, pavement : height of the pavement around buildings over the plane z = 0, and its width, m
    demanded : whether a source without footprints, whose walls cannot have relief, is refused
    """

    windows: bool = True
    balconies: bool = True
    pavements: bool = True
    seed: int = 1
    limit: int = 400_000
    bay: float = 3.2
    window_width: float = 1.3
    window_height: float = 1.5
    recess: float = 0.2
    spread: float = 0.12
    share: float = 0.92
    balcony_share: float = 0.15
    balcony_depth: float = 1.2
    parapet: float = 1.0
    kerb: float = 0.12
    pavement: float = 2.0
    demanded: bool = False

    @property
    def relief(self) -> bool:
        """Whether anything is made beside plain walls."""
        return self.windows or self.balconies or self.pavements

    def __post_init__(self) -> None:
        """Check the numbers.

        Raises
        ------
        SceneError : one of them is out of bounds
        """
        for name, (low, high) in _BOUNDS.items():
            value = getattr(self, name)
            if not low <= value <= high:
                raise SceneError(
                    f"facades: {name} = {value:g} is outside {low:g} to {high:g}; choose a value within"
                )

    @staticmethod
    def read(kinds: str, seed: int, statistics: dict[str, str]) -> "FacadeOptions":
        """Options of the command line: kinds such as ``windows,balconies``, ``none``, or empty for all where possible.

        Statistics are given by name.

        Raises
        ------
        SceneError : a name is unknown, or a value is no number or out of bounds
        """
        asked = [kind for kind in kinds.split(",") if kind]
        for kind in asked:
            if kind not in KINDS and asked != [NONE]:
                known = (*KINDS, NONE)
                near = did_you_mean(kind, known)
                raise SceneError(
                    f'facades: "{one_line(kind)}" is unknown{near}; choose from {", ".join(KINDS)}, or {NONE} alone'
                )
        if statistics and asked == [NONE]:
            raise SceneError(
                f"facades: --facade {next(iter(statistics))} is of walls with relief, not of {NONE}"
            )
        numbers = {}
        for name, text in statistics.items():
            if name not in _BOUNDS:
                near = did_you_mean(name, _BOUNDS)
                raise SceneError(
                    f'facades: "{one_line(name)}" is unknown{near}; choose from {", ".join(_BOUNDS)}'
                )
            try:
                numbers[name] = float(text)
            except ValueError:
                raise SceneError(
                    f'facades: {name} = "{one_line(text)}" is no number; give a number'
                ) from None
        limit = numbers.pop("limit", FacadeOptions.limit)
        windows, balconies, pavements = (kind in asked or not asked for kind in KINDS)
        return FacadeOptions(
            windows,
            balconies,
            pavements,
            seed,
            limit=int(limit),
            demanded=bool(asked or statistics) and asked != [NONE],
            **numbers,
        )


_BOUNDS: dict[str, tuple[float, float]] = {
    "limit": (1000.0, 1e8),
    "bay": (1.0, 50.0),
    "window_width": (0.2, 20.0),
    "window_height": (0.2, 10.0),
    "recess": (0.0, 1.0),
    "spread": (0.0, 0.5),
    "share": (0.0, 1.0),
    "balcony_share": (0.0, 1.0),
    "balcony_depth": (0.3, 5.0),
    "parapet": (0.1, 2.0),
    "kerb": (0.02, 0.5),
    "pavement": (0.2, 20.0),
}
assert set(_BOUNDS) < {field.name for field in fields(FacadeOptions)}


@dataclass(frozen=True, eq=False)
class Walls:
    """Walls of a building.

    Parameters
    ----------
    number : of the building, which with the seed determines its relief
    segments : (n, 2, 2) float64, m, start and end, the outside to the right
    foot, ground, eaves : heights of the walls' lower end, of the ground and of the upper end, m
    storey : height of a storey, m
    material : of the walls
    """

    number: int
    segments: F64
    foot: float
    ground: float
    eaves: float
    storey: float
    material: str


class FacadeBuilder:
    """Builds walls, plain or with relief, and counts windows, balconies and triangles.

    Parameters
    ----------
    options : statistics of the relief
    glass, balcony : materials of panes and balconies
    """

    def __init__(self, options: FacadeOptions, glass: str = "glass", balcony: str = "concrete") -> None:
        self.options, self.glass, self.balcony = options, glass, balcony
        self.n_windows = self.n_balconies = self.n_triangles = self.n_plain = 0
        self.full = False

    def add_walls(self, parts: Parts, walls: Walls) -> None:
        """Add the walls of a building; plain ones when earlier buildings have used up the limit of triangles."""
        before = self.n_windows, self.n_balconies, self.n_triangles
        own = Parts()
        if self.options.relief and not self.full and not self._walls(own, walls):
            self.full = True
            self.n_windows, self.n_balconies, self.n_triangles = before
        if self.full or not self.options.relief:
            own = Parts()
            self.n_plain += 1
            for start, end in walls.segments:
                self._plain(own, start, end, walls)
            self.n_triangles = before[2]
        for mesh in own:
            parts.add(*mesh)

    def _walls(self, parts: Parts, walls: Walls) -> bool:
        """Add walls with relief; False, with some of them missing, where the limit of triangles is exceeded."""
        o, foot, ground, eaves, storey = self.options, walls.foot, walls.ground, walls.eaves, walls.storey
        rng = np.random.default_rng([o.seed, walls.number])
        means = np.array([o.bay, o.window_width, o.window_height, o.recess, o.balcony_depth])
        bay, width, height, recess, depth = means * np.clip(rng.normal(1.0, o.spread, 5), 0.5, 1.5)
        n_storeys = round((eaves - ground) / storey)
        relief = (o.windows or o.balconies) and eaves - ground >= _LOWEST and n_storeys >= 1
        for start, end in walls.segments:
            length = float(np.hypot(*(end - start)))
            n_bays = round(length / bay) if relief else 0
            if not n_bays:
                self._plain(parts, start, end, walls)
                continue
            rows = np.linspace(ground, eaves, n_storeys + 1)
            rows = np.concatenate([[foot], rows]) if foot < ground else rows
            wall = _Wall(start, end, np.linspace(0.0, length, n_bays + 1), rows)
            upper = wall.middle[:, 1] > ground
            some = rng.random(upper.size) < o.share
            size = (
                min(width, length / n_bays - 2 * _RIM),
                min(height, (eaves - ground) / n_storeys - 2 * _RIM),
            )
            glazed = upper & some if o.windows and min(size) > 0.0 else np.zeros_like(upper)
            columns = rng.random(n_bays) < o.balcony_share
            behind = np.broadcast_to(columns, (rows.size - 1, n_bays)).ravel()
            second = wall.low[:, 1] > ground + 0.5 * storey
            hung = behind & second if o.balconies else np.zeros_like(upper)
            self._windows(parts, wall, glazed, size, recess, walls.material)
            self._balconies(parts, wall, hung, depth)
            if self.n_triangles > o.limit:
                return False
        return True

    def _plain(self, parts: Parts, start: F64, end: F64, walls: Walls) -> None:
        parts.add("walls", walls.material, *wall_quads(start, end, walls.foot, walls.eaves))
        self.n_triangles += 2

    def _windows(
        self,
        parts: Parts,
        wall: "_Wall",
        glazed: NDArray[np.bool_],
        size: tuple[float, float],
        recess: float,
        material: str,
    ) -> None:
        """Add bays with and without a window."""
        blind = ~glazed
        parts.add(
            "walls",
            material,
            wall.quads(wall.low[blind], wall.high[blind], 0.0),
            _many(_QUAD, 4, int(blind.sum())),
        )
        n = int(glazed.sum())
        low, high = wall.middle[glazed] - 0.5 * np.array(size), wall.middle[glazed] + 0.5 * np.array(size)
        rings = [
            wall.quads(wall.low[glazed], wall.high[glazed], 0.0),
            wall.quads(low, high, 0.0),
            wall.quads(low, high, -recess),
        ]
        corners = np.stack([ring.reshape(-1, 4, 3) for ring in rings], axis=1).reshape(-1, 3)
        parts.add("walls", material, corners, _many(_WINDOW, 12, n))
        parts.add("windows", self.glass, corners, _many(_PANE, 12, n))
        self.n_windows += n
        self.n_triangles += WINDOW_TRIANGLES * n + 2 * int(blind.sum())

    def _balconies(self, parts: Parts, wall: "_Wall", hung: NDArray[np.bool_], depth: float) -> None:
        """Add balconies: troughs open to the sky and to the wall."""
        n = int(hung.sum())
        low, high = wall.low[hung], wall.high[hung]
        bottom = low[:, 1] + _RAISED
        top = bottom + _SLAB + np.minimum(self.options.parapet, 0.8 * (high[:, 1] - low[:, 1]) - _SLAB)
        left, right = low[:, 0] + _RIM, high[:, 0] - _RIM

        def ring(z: F64, inset: float) -> F64:
            """Corners (n, 4, 3): left wall, left front, right front, right wall."""
            u = np.stack([left + inset, left + inset, right - inset, right - inset], axis=1)
            out = np.broadcast_to([0.0, depth - inset, depth - inset, 0.0], u.shape)
            return wall.place(u, np.broadcast_to(z[:, None], u.shape), out)

        rings = [ring(bottom, 0.0), ring(top, 0.0), ring(top, _PARAPET), ring(bottom + _SLAB, _PARAPET)]
        corners = np.stack(rings, axis=1).reshape(-1, 3)
        parts.add("balconies", self.balcony, corners, _many(_BALCONY, 16, n))
        self.n_balconies += n
        self.n_triangles += BALCONY_TRIANGLES * n


class _Wall:
    """Upright rectangle cut into bays and storeys; u along it, z up, w outwards."""

    def __init__(self, start: F64, end: F64, columns: F64, rows: F64) -> None:
        along = (end - start) / np.hypot(*(end - start))
        self._start, self._along, self._out = start, along, np.array([along[1], -along[0]])
        self.low = np.stack(np.meshgrid(columns[:-1], rows[:-1]), axis=-1).reshape(-1, 2)
        self.high = np.stack(np.meshgrid(columns[1:], rows[1:]), axis=-1).reshape(-1, 2)
        self.middle = 0.5 * (self.low + self.high)

    def place(self, u: F64, z: F64, w: F64 | float) -> F64:
        """Points (..., 3) in the scene's frame, m."""
        w = np.broadcast_to(w, u.shape)
        flat = self._start + u[..., None] * self._along + w[..., None] * self._out
        return np.concatenate([flat, z[..., None]], axis=-1)

    def quads(self, low: F64, high: F64, w: float) -> F64:
        """Corners (4 n, 3) of n upright rectangles, counter-clockwise from outside."""
        u = np.stack([low[:, 0], high[:, 0], high[:, 0], low[:, 0]], axis=1)
        z = np.stack([low[:, 1], low[:, 1], high[:, 1], high[:, 1]], axis=1)
        return self.place(u, z, w).reshape(-1, 3)


def wall_quads(start: F64, end: F64, foot: float, top: float) -> tuple[F64, I32]:
    """Corners (4, 3) and faces (2, 3) of one upright rectangle, the outside to the right of start to end."""
    wall = _Wall(start, end, np.array([0.0, float(np.hypot(*(end - start)))]), np.array([foot, top]))
    return wall.quads(wall.low, wall.high, 0.0), _QUAD.astype(np.int32)


def _strip(lower: int, upper: int) -> list[list[int]]:
    """Triangles of the three sides between two rings of four corners; outside is where the lower ring runs right."""
    return [
        t
        for i in range(3)
        for t in ([lower + i, lower + i + 1, upper + i + 1], [lower + i, upper + i + 1, upper + i])
    ]


# outer sides, rims, inner sides, floor, underside
_BALCONY = np.array(
    [*_strip(0, 4), *_strip(4, 8), *_strip(8, 12), [12, 13, 14], [12, 14, 15], [0, 2, 1], [0, 3, 2]]
)


def _many(faces: NDArray[np.int_], corners: int, n: int) -> I32:
    """Faces of n equal bodies with ``corners`` corners each."""
    return (faces[None] + corners * np.arange(n)[:, None, None]).reshape(-1, 3).astype(np.int32)
