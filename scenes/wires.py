"""Make the polylines of ``railing`` and ``crane`` again: rows ``x y z radius``, a blank row between curves.

python scenes/wires.py            write scenes/meshes/*.txt
python scenes/wires.py --check    compare with the files that are there, write nothing
"""

import sys
from pathlib import Path

import numpy as np

MESHES = Path(__file__).parent / "meshes"
Curve = list[tuple[float, float, float, float]]


def railing(length: float = 48.0, spacing: float = 3.0) -> list[Curve]:
    """Posts 1.1 m high from the ground on, along y about the origin, a hand rail and one at half height."""
    half = 0.5 * length
    curves: list[Curve] = [
        [(0.0, float(y), 0.0, 0.03), (0.0, float(y), 1.1, 0.03)]
        for y in np.arange(-half, half + 0.5 * spacing, spacing)
    ]
    return curves + [[(0.0, -half, z, 0.02), (0.0, half, z, 0.02)] for z in (0.55, 1.1)]


def lamp_post() -> list[Curve]:
    """8 m of tube with an arm of 1.5 m along x."""
    return [[(0.0, 0.0, 0.0, 0.06), (0.0, 0.0, 8.0, 0.06)], [(0.0, 0.0, 8.0, 0.03), (1.5, 0.0, 8.2, 0.03)]]


def lattice_mast(height: float = 18.0, foot: float = 2.4, top: float = 0.8, storeys: int = 6) -> list[Curve]:
    """Four legs, rings and one diagonal a face and storey, and a cross-arm of 8 m along x."""

    def corner(i: int, level: float) -> tuple[float, float, float]:
        half = 0.5 * (foot + (top - foot) * level / storeys)
        x, y = ((-1, -1), (1, -1), (1, 1), (-1, 1))[i % 4]
        return (x * half, y * half, height * level / storeys)

    curves: list[Curve] = [[(*corner(i, 0), 0.05), (*corner(i, storeys), 0.05)] for i in range(4)]
    for level in range(storeys):
        for i in range(4):
            first, second = (i, i + 1) if (level + i) % 2 else (i + 1, i)
            curves.append([(*corner(first, level), 0.02), (*corner(second, level + 1), 0.02)])
            curves.append([(*corner(i, level + 1), 0.025), (*corner(i + 1, level + 1), 0.025)])
    return [*curves, [(-4.0, 0.0, height, 0.04), (4.0, 0.0, height, 0.04)]]


def power_line(span: float = 60.0, sag: float = 1.2, height: float = 18.0, pieces: int = 24) -> list[Curve]:
    """Three cables along y that hang in parabolas between the cross-arms of two masts."""
    y = np.linspace(-0.5 * span, 0.5 * span, pieces + 1)
    z = height - sag * (1.0 - (2.0 * y / span) ** 2)
    return [[(x, float(b), float(c), 0.012) for b, c in zip(y, z, strict=True)] for x in (-3.8, 0.0, 3.8)]


def tower_crane(height: float = 36.0, jib: float = 33.0, counter: float = 11.0) -> list[Curve]:
    """Mast of 2 m x 2 m, jibs of triangular section along +x and, short, -x, tie bars from the apex, a hook's rope."""
    curves: list[Curve] = [
        [(x, y, 0.0, 0.09), (x, y, height, 0.09)] for x in (-1.0, 1.0) for y in (-1.0, 1.0)
    ]
    ring = ((-1.0, -1.0), (1.0, -1.0), (1.0, 1.0), (-1.0, 1.0))
    for storey in range(round(height / 3.0)):
        for side in range(4):
            (ax, ay), (bx, by) = ring[side], ring[(side + 1) % 4]
            low, high = (3.0 * storey, 3.0 * storey + 3.0)[:: 1 if storey % 2 else -1]
            curves.append([(ax, ay, low, 0.04), (bx, by, high, 0.04)])
            curves.append([(ax, ay, 3.0 * storey + 3.0, 0.04), (bx, by, 3.0 * storey + 3.0, 0.04)])
    curves += [[(-counter, y, height, 0.06), (jib, y, height, 0.06)] for y in (-0.7, 0.7)]
    curves.append([(-1.0, 0.0, height + 1.5, 0.06), (jib, 0.0, height + 1.5, 0.06)])
    for x in np.arange(1.0, jib, 2.0).tolist():  # from the chords below to the one above and back
        for y in (-0.7, 0.7):
            curves.append([(x, y, height, 0.03), (x + 1.0, 0.0, height + 1.5, 0.03)])
            curves.append([(x + 1.0, 0.0, height + 1.5, 0.03), (x + 2.0, y, height, 0.03)])
    curves += [[(x, 0.0, height, 0.09), (0.0, 0.0, height + 7.0, 0.09)] for x in (-1.0, 1.0)]
    curves += [
        [(0.0, 0.0, height + 7.0, 0.03), (x, 0.0, z, 0.03)]
        for x, z in ((-10.0, height), (24.0, height + 1.5))
    ]
    return [*curves, [(20.0, 0.0, height, 0.015), (20.0, 0.0, height - 16.0, 0.015)]]


FILES = {
    "railing": railing,
    "lamp_post": lamp_post,
    "lattice_mast": lattice_mast,
    "power_line": power_line,
    "tower_crane": tower_crane,
}


def text(curves: list[Curve]) -> str:
    """Rows of the file."""
    return (
        "\n\n".join("\n".join(" ".join(f"{v:.6g}" for v in row) for row in curve) for curve in curves) + "\n"
    )


def main() -> int:
    """Write or compare."""
    wrong = 0
    for name, make in FILES.items():
        path = MESHES / f"{name}.txt"
        if "--check" in sys.argv:
            if not path.is_file() or path.read_text(encoding="utf-8") != text(make()):
                print(f"{path.name} differs")
                wrong += 1
        else:
            path.write_text(text(make()), encoding="utf-8")
    return wrong


if __name__ == "__main__":
    raise SystemExit(main())
