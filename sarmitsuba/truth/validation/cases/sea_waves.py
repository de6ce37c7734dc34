"""Long waves, drawn one by one: the displacement of the sea in an image by their orbits."""

from dataclasses import replace

import numpy as np

from sarmitsuba.core.arrays import F64, unit_rows
from sarmitsuba.scene.materials.diffuse_law import LAWS
from sarmitsuba.scene.scene import Scene
from sarmitsuba.truth.theory import sea as theory
from sarmitsuba.truth.validation.cases import CASES, CaseEntry
from sarmitsuba.truth.validation.cases.sea_motion import COARSE, LOOK, RANGE, SPEED, WAVELENGTH, WIDTH, Drawn
from sarmitsuba.truth.validation.chain import chain
from sarmitsuba.truth.validation.comparison import Case, Comparison

# m: waves longer than this are drawn; of ground range that one centroid is taken over; of the image along the track
LONG, WINDOW, IMAGE = 15.0, 6.0, 160.0
# nodes over a window
_NODES = 13


def centroids(scene: Scene, middle: F64) -> F64:
    """Mean place along the track of the image's power at ground ranges from the aim point, m."""
    image = chain(scene, window="taylor:4:-35")
    grid, positions = image.grid, image.grid.positions()
    along = scene.radar.track.along
    place = positions[:, grid.shape[1] // 2] @ along
    ground = positions[grid.shape[0] // 2] @ _away(scene)
    power = np.abs(image.total()) ** 2
    rows = [power[:, np.abs(ground - at) < 0.5 * WINDOW].sum(axis=1) for at in middle]
    return np.array([place @ row / row.sum() for row in rows])


def _away(scene: Scene) -> F64:
    """Horizontal unit vector from the radar to the aim point."""
    flat = -scene.radar.track.center_position * np.array([1.0, 1.0, 0.0])
    return np.asarray(flat / np.linalg.norm(flat))


def waves(quick: bool = False) -> Case:
    """Where the image shows a strip of sea that long waves carry along, range by range."""
    rng = np.random.default_rng(31)
    length = 120.0 if quick else 480.0
    middle = np.arange(-0.5 * length + 2.0 * WINDOW, 0.5 * length - 1.9 * WINDOW, WINDOW)
    comparisons = []
    for number in range(1 if quick else 3):
        drawn = replace(Drawn.by(rng, (1e6, 1e6)), wind=float(rng.uniform(8.0, 10.0)), drawn=LONG)
        scene = drawn.scene(length, (COARSE, COARSE), IMAGE)
        sea = LAWS["sea"].wind_waves(drawn.material, WAVELENGTH, np.zeros(1), scene.settings.seed)
        assert sea is not None
        # mean over the window and the width of the strip
        antenna, along = scene.radar.track.center_position, scene.radar.track.along
        deep, wide = np.meshgrid(
            np.linspace(-0.5, 0.5, _NODES) * WINDOW, np.linspace(-0.5, 0.5, 5) * WIDTH, indexing="ij"
        )
        patch = deep.reshape(-1, 1) * _away(scene) + wide.reshape(-1, 1) * along
        places = (middle[:, None, None] * _away(scene) + patch).reshape(-1, 3)
        sight = places - antenna
        sight = unit_rows(sight)
        speed = np.sum(theory.orbital_velocity(sea.waves, places, 0.0) * sight, axis=1)
        _, bragg, share = drawn.expected()
        mean = (2.0 * share - 1.0) * bragg * WAVELENGTH / (4.0 * np.pi)
        want = -RANGE / SPEED * (speed.reshape(middle.size, -1).mean(axis=1) - mean)
        # what is left of the short waves' smear in one centroid
        smear = RANGE / SPEED * float(np.hypot(sea.speeds[2], mean))
        looks = WINDOW * np.sin(np.radians(LOOK)) / COARSE * smear / COARSE
        sigma = smear / np.sqrt(looks)
        comparisons.append(
            Comparison(
                f"flight {number + 1}, wind {drawn.wind:.1f} m/s",
                middle,
                want,
                centroids(scene, middle),
                tolerance=4.0 * sigma,
                reason=f"4 standard errors of a centroid, {sigma:.1f} m: a smear of {smear:.1f} m in {looks:.0f} looks",
                unit="m",
                shown=int(np.argmax(np.abs(want))),
            )
        )
    return Case(
        name="sea_waves",
        topic="rough",
        title="Long waves displace what the image shows of the sea",
        formula="-R v_r / V, v_r of the orbits of all drawn waves and of the Bragg waves",
        source="Alpers and Rufenach, IEEE Trans. AP 27 (1979); linear waves on deep water",
        x_label="ground range from the middle (m)",
        y_label="along the track (m)",
        comparisons=tuple(comparisons),
        note=f"A strip of fully developed sea, {WIDTH:g} m x {length:g} m, waves longer than {LONG:g} m drawn; "
        f"centroids over {WINDOW:g} m of ground range; headings, sides and winds drawn.",
    )


CASES.register(CaseEntry("sea_waves", "rough", waves))
