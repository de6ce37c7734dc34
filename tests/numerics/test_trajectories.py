"""Tracks that are not straight and uniform: curved, circular, jittered, uneven in time, one pulse, standing still."""

import warnings
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import sarmitsuba
from sarmitsuba.core.errors import DataError, RadarError
from sarmitsuba.scene.scene import Scene
from sarmitsuba.signal.metrics import point_target_in
from tests.support.unweighted import focus

SCENE = """<scene version="3.0.0">
  <integrator type="sar_path"><integer name="max_depth" value="2"/><float name="ray_spacing" value="0.04"/></integrator>
  <sensor type="sar_antenna" id="radar">
    <string name="track_file" value="track.csv"/><string name="mode" value="spotlight"/>
    <film type="range_film">
      <float name="image_extent_azimuth" value="24"/><float name="image_extent_range" value="24"/>
    </film>
  </sensor>
  <bsdf type="radar_material" id="metal"><string name="material" value="pec"/></bsdf>
  {shapes}
</scene>
"""
POINT = (
    '<shape type="sphere" id="point"><point name="center" x="2.5" y="-1.5" z="0"/><float name="radius" value="0.1"/>'
    '<bsdf type="point_scatterer"/></shape>'
)
CORNERS = "".join(
    f'<shape type="cube" id="c{i}"><transform name="to_world"><scale value="0.4"/><rotate z="1" angle="{25 * i}"/>'
    f'<translate x="{x}" y="{y}" z="0.4"/></transform><ref id="metal"/></shape>'
    for i, (x, y) in enumerate([(-1.5, 1.0), (2.0, 1.5), (0.5, -2.0)])
)
FLOOR = (
    '<shape type="rectangle" id="floor"><ref id="metal"/>'
    '<transform name="to_world"><scale value="3"/></transform></shape>'
)
HEIGHT, REACH = 3500.0, 3500.0


def track(kind: str) -> np.ndarray:
    """(n, 4) time and position: all about (-REACH, 0, HEIGHT), flying along +y, aperture about 75 m."""
    rng = np.random.default_rng(3)
    n = {"one pulse": 1, "circular": 96}.get(kind, 64)
    t = (np.arange(n) - 0.5 * (n - 1)) / 85.0
    y = 100.0 * t
    x, z = np.full(n, -REACH), np.full(n, HEIGHT)
    if kind == "curved":
        x = x + 0.02 * y**2
        z = z + 5.0 * np.sin(y / 30.0)
    elif kind == "circular":
        a = np.linspace(-0.02, 0.02, n)
        x, y = -REACH * np.cos(a), REACH * np.sin(a)
        t = y / 100.0
    elif kind == "jitter":
        x, y, z = (v + rng.normal(0.0, 0.3, n) for v in (x, y, z))
    elif kind == "uneven times":
        t = np.sort(rng.uniform(t[0], t[-1], n))
        y = 100.0 * t
    elif kind == "standing still":
        y = np.repeat(y[::4], 4)  # four pulses at every place
    return np.column_stack([t, x, y, z])


def load(folder: Path, kind: str, shapes: str) -> Scene:
    rows = track(kind)
    np.savetxt(folder / "track.csv", rows, delimiter=",", header="time_s, x_m, y_m, z_m", fmt="%.9f")
    (folder / "scene.xml").write_text(SCENE.format(shapes=shapes))
    return sarmitsuba.load_scene(folder / "scene.xml")


KINDS = ("straight", "curved", "circular", "jitter", "uneven times", "one pulse", "standing still")


@pytest.mark.filterwarnings("ignore:.*Doppler bandwidth")  # repeated positions undersample on purpose
@pytest.mark.parametrize("kind", [kind for kind in KINDS if kind != "one pulse"])
def test_point_comes_out_in_its_place(row, tmp_path: Path, kind: str) -> None:
    """A point of 0 dBsm at (2.5, -1.5, 0) focuses there at its level from any track.

    Naive way: focusing as if the pulses came from the straight line through the track's ends.
    """
    scene = load(tmp_path, kind, POINT)
    raw = sarmitsuba.simulate(scene)
    image = focus(raw, request=scene.image)
    assert np.isfinite(image.data).all()
    power = np.abs(image.total()) ** 2
    place = image.grid.positions()[np.unravel_index(np.argmax(power), power.shape)]
    level = 10 * np.log10(point_target_in(image).rcs)
    cell = max(
        image.azimuth_resolution_cell, image.range_resolution_cell / np.sin(image.incidence_angle.mean())
    )
    # tol: half a pixel, a quarter of a cell, both ways
    assert np.linalg.norm(place[:2] - np.array([2.5, -1.5])) < 0.5 * cell
    naive = None
    if kind in ("curved", "jitter"):
        track = raw.radar.track
        ends = track.position[[0, -1]]
        line = ends[0] + np.linspace(0.0, 1.0, track.n_pulses)[:, None] * (ends[1] - ends[0])
        flown = replace(track, position=line, velocity=np.gradient(line, track.time, axis=0))
        straight = replace(raw, radar=replace(raw.radar, track=flown))
        naive = abs(10 * np.log10(np.abs(focus(straight, grid=image.grid).total()).max() ** 2))
    row(
        f"{kind} track: level of a point",
        abs(level),
        0.1,
        "dB",
        naive=naive,
        remedy="every pulse's own float64 position, in the echo and in the focuser",
    )


def test_one_pulse(tmp_path: Path) -> None:
    """One pulse is a range profile; there is no image in it, and the focuser says so."""
    raw = sarmitsuba.simulate(load(tmp_path, "one pulse", POINT))
    window = raw.radar.window
    profile = np.abs(raw.data[0, 0])
    distance = np.linalg.norm(np.array([2.5, -1.5, 0.0]) - raw.radar.track.position[0])
    at = window.start_range[0] + window.sample_spacing * np.argmax(profile)
    assert abs(at - distance) <= 0.5 * window.sample_spacing
    with pytest.raises(DataError, match="1 pulse gives no synthetic aperture; at least 2 are needed"):
        focus(raw)


@pytest.mark.filterwarnings("ignore:.*Doppler bandwidth")
@pytest.mark.parametrize("kind", KINDS)
def test_key_pulses_match_every_pulse(row, tmp_path: Path, kind: str) -> None:
    """Blocks of pulses against tracing every pulse: the same data to -40 dB, or to the error that the run states.

    Naive way: blocks of 32 pulses whatever the track: -36 dB of error with a jitter of 0.3 m.
    """
    scene = load(tmp_path, kind, FLOOR + CORNERS)

    def simulated(**settings: object) -> sarmitsuba.RawData:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            return sarmitsuba.simulate(replace(scene, settings=replace(scene.settings, **settings)))

    def run(**settings: object) -> np.ndarray:
        return simulated(**settings).data[0]

    every = run(method="raw")
    hybrid = simulated(method="hybrid")
    blocks, stated = hybrid.data[0], hybrid.metadata["sampling"]["block_error_db"]
    error = 20 * np.log10(np.linalg.norm(blocks - every) / np.linalg.norm(every) + 1e-10)
    naive = None
    if kind == "jitter":
        forced = run(method="hybrid", key_pulse_interval=32)
        naive = 20 * np.log10(np.linalg.norm(forced - every) / np.linalg.norm(every))
    row(
        f"{kind} track: key pulses against every pulse",
        error,
        # tol: the statement is an estimate from one difference per block, good to 3 dB
        -40.0 if stated is None else max(-40.0, stated + 3.0),
        "dB",
        naive=naive,
        remedy="the block's phase error is predicted on the track itself; none fits, every pulse is traced",
    )


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("0,1,2\n", "every line needs four numbers"),
        ("0,0,0,5000\n0,1,0,5000\n", "pulse times must increase strictly"),
        ("0,0,0,nan\n1,1,0,5000\n", "must be finite"),
        ("", "every line needs four numbers"),
        ("a,b,c,d\n0,x,0,0\n", "could not convert string to float"),
    ],
    ids=["columns", "times", "nan", "empty", "words"],
)
def test_bad_tracks_are_refused(tmp_path: Path, text: str, message: str) -> None:
    (tmp_path / "track.csv").write_text(text)
    (tmp_path / "scene.xml").write_text(SCENE.format(shapes=POINT))
    with pytest.raises(RadarError, match=message) as caught:
        sarmitsuba.load_scene(tmp_path / "scene.xml")
    assert "\n" not in str(caught.value)
