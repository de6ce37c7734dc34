"""CPU seconds of an image's azimuth cells along a stripmap, by the number of pulses on its track.

``python -m benchmarks.studies.azimuth_cells --pulses 950 1900 3800`` prints one line each.
Every pixel's own aperture is 450 pulses long; the cells are those of 594 places.
"""

import argparse
import time
from dataclasses import replace

import numpy as np

from sarmitsuba.radar.antenna import Antenna
from sarmitsuba.radar.image_request import ImageRequest
from sarmitsuba.radar.radar import Radar
from sarmitsuba.radar.track import Track
from sarmitsuba.signal.focusing import default_grid
from sarmitsuba.signal.focusing.aperture_weights import matched_weights
from sarmitsuba.signal.focusing.cells import azimuth_cells
from sarmitsuba.signal.focusing.ideal import ideal_radar
from sarmitsuba.signal.image import ImageGrid

ROUNDS = 3
# sine of half of a pixel's aperture, two-way width of the beam, and share of the track that the image covers, so that
# its ends lack pulses
HALF_APERTURE, BEAM, COVERED = 0.018, 0.03, 0.95


def strip(n: int) -> tuple[Radar, ImageGrid]:
    """Radar of ``n`` pulses along a straight line at 3 km, beams abeam, and an image along it."""
    radar = ideal_radar(
        slant_range=3e3,
        resolution=0.3,
        bandwidth=300e6,
        n_samples=500,
        mode="stripmap",
        antenna=Antenna("gaussian", 1e3, BEAM, 0.5),
    )
    track, middle = radar.track, radar.track.n_pulses // 2
    prf = 1.0 / float(np.diff(track.time).mean())
    pointing = replace(
        radar.pointing,
        **{
            name: np.repeat(getattr(radar.pointing, name)[middle][None], n, axis=0)
            for name in ("boresight", "azimuth_axis", "elevation_axis")
        },
    )
    radar = replace(
        radar,
        track=Track.straight(track.center_position, track.velocity[0], prf, n),
        pointing=pointing,
        window=replace(radar.window, start_range=np.full(n, float(radar.window.start_range[middle]))),
        half_aperture=HALF_APERTURE,
    )
    length = float(np.linalg.norm(radar.track.position[-1] - radar.track.position[0]))
    request = ImageRequest(grid="ground", extent_azimuth=COVERED * length, extent_range=25.0)
    return radar, default_grid(radar, request)


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--pulses", nargs="+", type=int, default=[950, 1900, 3800])
    for n in parser.parse_args().pulses:
        radar, grid = strip(n)
        seconds = []
        for _ in range(ROUNDS):
            start = time.process_time()
            cells = azimuth_cells(
                radar, grid, lambda place, r=radar: matched_weights(r, place, "taylor"), "taylor"
            )
            seconds.append(time.process_time() - start)
        rows = 1 if cells.rows is None else len(cells.rows["azimuth"])
        print(f"{n:6d} pulses: {min(seconds):.2f} CPU s, {rows} rows, {cells.center:.4f} m in the middle")


if __name__ == "__main__":
    main()
