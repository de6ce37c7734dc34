"""Is flat rough ground level over the whole image: sigma0 in bands of rows, for modes, beams, methods and focusers.

``python -m benchmarks.studies.level --extents 60 120 200 --seeds 6`` prints, for each, the level of every band of
rows over the true sigma0 with its standard error, and the largest of them. ``--against-raw`` also compares ``hybrid``
with ``raw``.
"""

import argparse
import sys
import time
import warnings
from dataclasses import dataclass

import numpy as np

from sarmitsuba.core.arrays import F64

SIGMA0_DB = -10.0
BANDS = 8
MODES = ("stripmap", "spotlight")
# what makes the image; hybrid raw data are focused twice
MAKERS = ("backprojection", "omega_k", "image", "raster")


@dataclass(frozen=True)
class Setup:
    """One radar over flat ground.

    Parameters
    ----------
    mode, pattern : of the radar; beams are those of an antenna of ``antenna_length`` m
    extent_azimuth, extent_range : m, of the image
    resolution : m, both axes
    """

    mode: str = "stripmap"
    pattern: str = "rectangular"
    extent_azimuth: float = 120.0
    extent_range: float = 60.0
    resolution: float = 0.75
    antenna_length: float = 2.0
    slant_range: float = 5e3
    squint_angle_deg: float = 0.0
    n_pulses: int = 0

    def scene(self, seed: int = 0, method: str = "hybrid"):  # type: ignore[no-untyped-def]
        from sarmitsuba.loading.build import SceneMesh, build_scene
        from sarmitsuba.radar.description import RadarDescription
        from sarmitsuba.radar.film import FilmDescription
        from sarmitsuba.scene.settings import TraceSettings

        beam = {"antenna_length": self.antenna_length, "elevation_beamwidth_deg": 20.0}
        aperture = {"n_pulses": self.n_pulses} if self.n_pulses else {"azimuth_resolution": self.resolution}
        radar = RadarDescription(
            mode=self.mode,
            pattern=self.pattern,  # type: ignore[arg-type]
            slant_range=self.slant_range,
            bandwidth=299792458.0 / (2.0 * self.resolution),
            squint_angle_deg=self.squint_angle_deg,
            **aperture,  # type: ignore[arg-type]
            **(beam if self.pattern != "isotropic" else {}),
        )
        film = FilmDescription(image_extent_azimuth=self.extent_azimuth, image_extent_range=self.extent_range)
        x = 0.5 * self.extent_range + 12.0
        y = 0.5 * self.extent_azimuth + 12.0
        corners = np.array([[-x, -y, 0.0], [x, -y, 0.0], [x, y, 0.0], [-x, y, 0.0]])
        soil = {
            "material": "medium_dry_ground",
            "rms_height": 0.05,
            "diffuse_law": "constant",
            "diffuse_level_db": SIGMA0_DB,
        }
        return build_scene(
            [SceneMesh(corners, np.array([[0, 1, 2], [0, 2, 3]]), soil, "ground")],
            radar=radar,
            film=film,
            settings=TraceSettings(method=method, seed=seed),  # type: ignore[arg-type]
        )


def images(setup: Setup, seed: int, makers: tuple[str, ...] = MAKERS):  # type: ignore[no-untyped-def]
    """Images of one seed by maker."""
    from sarmitsuba.simulation.execution.image import Imager
    from sarmitsuba.simulation.execution.render import simulate
    from sarmitsuba.simulation.execution.run import Run
    from tests.support.unweighted import focus

    scene = setup.scene(seed)
    out = {}
    focusers = [m for m in makers if m in ("backprojection", "omega_k")]
    if focusers:
        raw = simulate(scene)
        for name in focusers:
            out[name] = focus(raw, focuser=name)
    for method in ("image", "raster"):
        if method in makers:
            imager = Imager(Run(setup.scene(seed, method)))
            out[method] = getattr(imager, method)()
    return out


def bands(image, n: int = BANDS) -> F64:  # type: ignore[no-untyped-def]
    """Mean sigma0 of bands of rows over the truth, linear, without the last cell at the image's own ends."""
    sigma0 = image.sigma0()[2:-2, 4:-4]
    return np.array([part.mean() for part in np.array_split(sigma0, n, axis=0)]) / 10 ** (0.1 * SIGMA0_DB)


def measure(setup: Setup, seeds: range, makers: tuple[str, ...] = MAKERS) -> dict[str, tuple[F64, F64]]:
    """Level of every band and its standard error, dB, by maker."""
    found: dict[str, list[F64]] = {m: [] for m in makers}
    for seed in seeds:
        for maker, image in images(setup, seed, makers).items():
            found[maker].append(bands(image))
    out = {}
    for maker, values in found.items():
        all_seeds = np.array(values)
        mean = all_seeds.mean(axis=0)
        # one standard error for all bands: their own scatter over seeds, averaged over the bands
        error = np.sqrt((all_seeds.var(axis=0, ddof=1) / len(seeds)).mean()) if len(seeds) > 1 else np.nan
        out[maker] = (10.0 * np.log10(mean), np.full(mean.size, 4.343 * error / mean.mean()))
    return out


def against_raw(setup: Setup) -> float:
    """Error of the hybrid's focused image against the raw one's with the same rays, dB."""
    from dataclasses import replace

    from sarmitsuba.signal.metrics import image_error_db
    from sarmitsuba.simulation.execution.render import simulate
    from tests.support.unweighted import focus

    hybrid = setup.scene(3)
    raw = replace(hybrid, settings=replace(hybrid.settings, method="raw"))
    return image_error_db(focus(simulate(hybrid)).total(), focus(simulate(raw)).total())


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--extents", type=float, nargs="+", default=[60.0, 120.0, 200.0])
    parser.add_argument("--patterns", nargs="+", default=["isotropic", "gaussian", "rectangular"])
    parser.add_argument("--modes", nargs="+", default=list(MODES))
    parser.add_argument("--makers", nargs="+", default=list(MAKERS))
    parser.add_argument("--seeds", type=int, default=6)
    parser.add_argument("--squint", type=float, default=0.0)
    parser.add_argument("--pulses", type=int, default=0)
    parser.add_argument("--against-raw", action="store_true")
    args = parser.parse_args()
    for mode in args.modes:
        for pattern in args.patterns:
            for extent in args.extents:
                setup = Setup(mode, pattern, extent, squint_angle_deg=args.squint, n_pulses=args.pulses)
                start = time.perf_counter()
                with warnings.catch_warnings(record=True) as said:
                    warnings.simplefilter("always")
                    levels = measure(setup, range(args.seeds), tuple(args.makers))
                    error = f", hybrid - raw {against_raw(setup):.1f} dB" if args.against_raw else ""
                for maker, (level, sigma) in levels.items():
                    worst = level[np.abs(level).argmax()]
                    print(
                        f"{mode:9s} {pattern:11s} {extent:4.0f} m {maker:14s} worst {worst:+.2f} "
                        f"+- {sigma[0]:.2f} dB: " + " ".join(f"{v:+.2f}" for v in level) + error,
                        flush=True,
                    )
                n = setup.scene().radar.track.n_pulses
                print(f"    {n} pulses, {time.perf_counter() - start:.1f} s", flush=True)
                for text in sorted({str(w.message) for w in said}):
                    print(f"    said: {text}", flush=True)


if __name__ == "__main__":
    sys.exit(main())
