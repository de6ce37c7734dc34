"""Which coherent tubes return anything, and how many a quadtree of larger tubes with equal paths would need.

``python -m benchmarks.studies.tubes urban_block`` (or the file of a scene, with ``--radar airborne_x`` where it has
none) prints for the key pulse in the middle of the track:

- rays, hits, and hits that return anything to the antenna (the others are left out before their fields are computed);
- CPU seconds of the kernel, and of its rays alone: the first hits, the rays to further ones, and the shadow rays;
- leaves of quadtrees whose squares of 2, 4 and 8 rays to a side have one chain of planes and visibilities, those of
  the ring of rays around them included. In the second row only tubes that return nothing are joined: those that do
  are kept as small as the block of pulses allows (`sampling.density_plan.TUBE_PHASE_CHANGE`).

A quadtree has to know the paths of all its rays, which costs the CPU seconds of the rays alone.
"""

import argparse
import time
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from sarmitsuba.loading.library import resolve, resolve_radar
from sarmitsuba.loading.load import load_scene
from sarmitsuba.machine.backend import dr, mi
from sarmitsuba.simulation.execution.run import Run
from sarmitsuba.simulation.execution.tracing import KeyPulse, Tracer
from sarmitsuba.tracing.kernel.launch import LaunchGrid
from sarmitsuba.tracing.kernel.propagation import arrive, launch, next_facet
from sarmitsuba.tracing.kernel.state import NO_HIT, Contribution, Hit, Kernel, RayState

# bounces whose planes are compared
DEPTH = 6
LEVELS = 3
# two triangles are in one plane where normal and distance agree to these
NORMAL, DISTANCE = 1e-3, 0.02


class Paths:
    """Accumulator of the chains of faces: for each bounce and ray the face, whether it is seen, whether it returns."""

    def __init__(self, n_rays: int) -> None:
        self.n_rays = n_rays
        self.face = dr.full(mi.UInt32, NO_HIT, DEPTH * n_rays)
        self.seen = dr.zeros(mi.UInt32, DEPTH * n_rays)
        self.returns = dr.zeros(mi.UInt32, DEPTH * n_rays)

    def begin(self) -> tuple[mi.UInt32]:
        """Number of the ray."""
        return (dr.arange(mi.UInt32, self.n_rays),)

    def visit(
        self, state: tuple[mi.UInt32], ray: RayState, hit: Hit
    ) -> tuple[tuple[mi.UInt32], mi.UInt32 | None]:
        """Record the face."""
        at, active = self._place(state, hit.order), hit.active & (hit.order <= DEPTH)
        dr.scatter(self.face, hit.face, at, active)
        dr.scatter(self.seen, dr.select(hit.sees, mi.UInt32(1), 0), at, active)
        return state, ray.trail

    def add(self, state: tuple[mi.UInt32], echo: Contribution) -> tuple[mi.UInt32]:
        """Record that the hit returns something."""
        active = echo.active & (echo.order <= DEPTH)
        dr.scatter(self.returns, mi.UInt32(1), self._place(state, echo.order), active)
        return state

    def _place(self, state: tuple[mi.UInt32], order: mi.UInt32) -> mi.UInt32:
        return (dr.maximum(order, 1) - 1) * self.n_rays + state[0]

    def arrays(self) -> tuple[NDArray[np.uint32], ...]:
        """Faces, seen and returns, each (DEPTH, n_rays)."""
        return tuple(x.numpy().reshape(DEPTH, self.n_rays) for x in (self.face, self.seen, self.returns))


def rays_alone(kernel: Kernel, tracer: Tracer) -> None:
    """Trace the rays of a kernel with their shadow rays, without tubes, fields and echoes."""
    lane, ray = launch(kernel, tracer.sampling.scene.radar.antenna)

    def bounce(ray: RayState, seen: mi.UInt32) -> tuple[RayState, mi.UInt32]:
        hit = arrive(kernel, lane, ray, next_facet(kernel.scene, lane, ray))
        n, d, antenna = hit.normal64, hit.direction64, ray.virtual_antenna
        seen = seen + dr.select(hit.sees, mi.UInt32(1), 0)
        ray = replace(
            ray,
            active=hit.active & (hit.order < kernel.constants.max_depth),
            hits=hit.order,
            origin=hit.departure,
            direction=d - n * (2.0 * dr.dot(d, n)),
            virtual_antenna=antenna - n * (2.0 * dr.dot(antenna - hit.p, n)),
        )
        return ray, seen

    ray, seen = dr.while_loop(
        (ray, mi.UInt32(0)), lambda ray, seen: ray.active, bounce, labels=("ray", "seen"), mode="symbolic"
    )
    dr.eval(ray.hits, seen)
    dr.sync_thread()


def signatures(tracer: Tracer, face: NDArray[np.uint32], seen: NDArray[np.uint32]) -> NDArray[np.uint64]:
    """(n_rays,) number of the chain of planes and visibilities of each ray."""
    corners = tracer.trace_scene.triangles
    normal = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    normal /= np.maximum(np.linalg.norm(normal, axis=1, keepdims=True), 1e-300)
    key = np.column_stack([normal / NORMAL, (normal * corners[:, 0]).sum(axis=1) / DISTANCE])
    plane = np.unique(np.round(key).astype(np.int64), axis=0, return_inverse=True)[1].reshape(-1)
    chain = np.zeros(face.shape[1], dtype=np.uint64)
    for hit, visible in zip(face, seen, strict=True):
        there = hit != NO_HIT
        number = np.where(there, 2 * (plane[np.where(there, hit, 0)] + 1) + visible, 0)
        chain = chain * np.uint64(1_000_003) ^ number.astype(np.uint64)
    return chain


def leaves(grid: LaunchGrid, chain: NDArray[np.uint64], joined: NDArray[np.bool_]) -> tuple[int, list[int]]:
    """Number of rays of the plain lattice, and of leaves of quadtrees with 1 to ``LEVELS`` levels."""
    n = grid.levels[1].first if len(grid.levels) > 1 else grid.n_rays
    c, s = np.cos(grid.turn), np.sin(grid.turn)
    x, y = grid.x[:n].astype(float), grid.y[:n].astype(float)
    places = np.stack([x * c + y * s, y * c - x * s]) / grid.every_level[0].spacing
    i, j = np.rint(places - places[:, :1]).astype(int)
    i, j = i - i.min() + 1, j - j.min() + 1
    shape = tuple(-(-(k.max() + 2) // 2**LEVELS) * 2**LEVELS for k in (i, j))
    number, alike, count = np.zeros(shape, np.uint64), np.zeros(shape, bool), np.zeros(shape, int)
    number[i, j], count[i, j] = chain[:n], 1
    ring = np.ones(n, dtype=bool)
    for a in (-1, 0, 1):
        for b in (-1, 0, 1):
            ring &= number[i + a, j + b] == chain[:n]
    alike[i, j] = ring & joined[:n]
    out = []
    for _ in range(LEVELS):
        quarters = [(slice(a, None, 2), slice(b, None, 2)) for a in (0, 1) for b in (0, 1)]
        first = number[quarters[0]]
        alike = np.logical_and.reduce([alike[q] & (number[q] == first) for q in quarters])
        count = np.where(alike, 1, np.sum([count[q] for q in quarters], axis=0))
        number = first
        out.append(int(count.sum()))
    return n, out


def main() -> None:
    """Print the table of one scene."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
    parser.add_argument("scene")
    parser.add_argument("--radar", help="description of a radar, for a scene without one")
    parser.add_argument("--rounds", type=int, default=4)
    args = parser.parse_args()
    radar = None if args.radar is None else resolve_radar(args.radar)
    run = Run(load_scene(resolve(args.scene), radar=radar))
    assert run.sampling is not None
    tracer = run.tracer(run.sampling)
    track, length = run.scene.radar.track, run.sampling.key_pulse_interval
    start = max(0, track.center_index - length // 2)
    block = KeyPulse(run.sampling, start, min(start + length, track.n_pulses))
    grids = run.lattices(run.sampling, 0)[0]
    launches = [x for x in tracer.launches(grids, 1) if x.part.rays and x.part.grid.purpose != "diffuse"]
    for one in launches:
        grid = one.part.grid
        channels, wavelength = len(run.scene.radar.channels), run.scene.radar.waveform.wavelength
        whole, alone = [], []
        for _ in range(args.rounds + 1):
            accumulator = block.accumulator(1, channels, 0, wavelength, 0)
            kernel = tracer.kernel_of(grid, block.states, accumulator)
            begin = time.process_time()
            found = tracer.launch(one, block.states, accumulator, block.each)
            middle = time.process_time()
            rays_alone(kernel, tracer)
            whole.append(middle - begin)
            alone.append(time.process_time() - middle)
        paths = Paths(grid.n_rays)
        _, state = one.record(kernel, run.scene.radar.antenna, paths)
        dr.eval(state, paths.face, paths.seen, paths.returns)
        face, seen, returns = paths.arrays()
        some = (returns > 0).any(axis=0)
        print(
            f"{run.scene.name}, {grid.purpose}: {found.rays} rays, {found.hits} hits, {found.contributions} echoes; "
            f"{int(seen.sum())} hits seen up to bounce {DEPTH}, {int(returns.sum())} with a return, "
            f"from {int(some.sum())} rays"
        )
        print(
            f"CPU s, median of {args.rounds}: {np.median(whole[1:]):.2f}, rays alone {np.median(alone[1:]):.2f}"
        )
        chain = signatures(tracer, face, seen)
        for label, joined in (("all tubes", np.ones_like(some)), ("tubes without a return", ~some)):
            n, counts = leaves(grid, chain, joined)
            shares = ", ".join(f"{n / count:.2f}" for count in counts)
            print(f"rays over leaves, {label}, up to 2, 4, 8 to a side: {shares}")


if __name__ == "__main__":
    main()
