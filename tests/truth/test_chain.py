"""The whole chain on shipped scenes: XML -> raw -> image -> figure. `pytest -s` prints every measured value."""

from dataclasses import replace

import numpy as np
import pytest

import sarmitsuba
from sarmitsuba.core.constants import SPEED_OF_LIGHT
from sarmitsuba.signal.chirp import to_chirped
from sarmitsuba.signal.image import SarImage
from sarmitsuba.signal.metrics import coherence, point_target_in
from sarmitsuba.simulation.execution.tracing import MAX_GRID_BYTES
from tests.support.unweighted import focus

WAVELENGTH = SPEED_OF_LIGHT / 9.65e9


def chain(scene: str, **parameters: str) -> SarImage:
    """Simulate, turn into LFM echoes, compress them again, focus."""
    loaded = sarmitsuba.load_scene(scene, parameters=parameters)
    raw = sarmitsuba.simulate(loaded)
    return focus(to_chirped(raw), request=loaded.image)


def peak_dbsm(image: SarImage, channel: str | None = None) -> float:
    return 10.0 * np.log10(point_target_in(image, channel).rcs)


@pytest.mark.parametrize(
    ("scene", "expected"),
    [
        # plate and triangular trihedral are the validation case traced_rcs
        ("trihedral_square", 10 * np.log10(12 * np.pi / WAVELENGTH**2)),
        # PO of ka = 60: pi a^2 |(1 - 1 / 2jka) exp(2jka) ... |, -0.042 dB from pi a^2
        ("sphere", -5.625),
    ],
)
def test_rcs_through_raw_echo_compression_and_focus(scene: str, expected: float) -> None:
    """A target's calibrated peak is its physical-optics RCS."""
    measured = peak_dbsm(chain(scene))
    print(f"\n{scene}: {measured:.3f} dBsm, theory {expected:.3f}, deviation {measured - expected:+.3f} dB")
    assert (
        abs(measured - expected) < 0.2
    )  # tol: 4.5 rays per wavelength, and the lobe's fall over the aperture


def test_dihedral_hh_vv_and_their_phase() -> None:
    """Equal levels, opposite phase."""
    expected = 10 * np.log10(8 * np.pi / WAVELENGTH**2)
    image = chain("dihedral", polarisation="HH,VV")
    hh, vv = peak_dbsm(image, "HH"), peak_dbsm(image, "VV")
    i = np.unravel_index(np.argmax(image.rcs("HH")), image.grid.shape)
    phase = np.degrees(np.angle(image.total("HH")[i] / image.total("VV")[i]))
    print(f"\ndihedral: HH {hh:.3f}, VV {vv:.3f} dBsm, theory {expected:.3f}; phase HH - VV {phase:.2f} deg")
    assert abs(hh - expected) < 0.2 and abs(vv - expected) < 0.2  # tol: as above
    assert abs(abs(phase) - 180.0) < 1.0  # tol: single bounces of the plates, -40 dB


@pytest.mark.parametrize("focuser", ["backprojection", "omega_k"])
@pytest.mark.parametrize(
    "where",
    [
        {"slant_range": "10000"},
        # coarser in azimuth: as many pulses
        {"slant_range": "700000", "speed": "7600", "azimuth_resolution": "2"},
    ],
    ids=["10 km", "700 km"],
)
def test_point_target_response(where: dict[str, str], focuser: str) -> None:
    """Width, sidelobes, place and level of an ideal point."""
    scene = sarmitsuba.load_scene("point", parameters=where)
    image = focus(sarmitsuba.simulate(scene), request=scene.image, focuser=focuser)
    m = point_target_in(image)
    cell = scene.radar.waveform.range_cell
    track = scene.radar.track
    spread = (
        float(np.linalg.norm(track.position[-1] - track.position[0])) * track.n_pulses / (track.n_pulses - 1)
    )
    azimuth_cell = WAVELENGTH * float(where["slant_range"]) / (2.0 * spread)
    point = scene.points[0].position
    row = (point - image.grid.origin) @ image.grid.along
    ground = image.grid.kind == "ground"
    column = (
        (point - image.grid.origin) @ image.grid.across
        if ground
        else np.linalg.norm(point - track.center_position - row * image.grid.along)
    )
    in_slant = np.sin(image.incidence_angle.mean()) if ground else 1.0
    print(
        f"\n{focuser} {where['slant_range']} m: IRW azimuth {m.azimuth.irw / azimuth_cell:.4f}, range "
        f"{m.range.irw * in_slant / cell:.4f} cells; PSLR {m.azimuth.pslr_db:.2f}, {m.range.pslr_db:.2f} dB; "
        f"place {(m.azimuth_position - row) / azimuth_cell:+.4f}, "
        f"{(m.range_position - column) * in_slant / cell:+.4f} cells; {10 * np.log10(m.rcs):+.4f} dBsm"
    )
    assert abs(m.azimuth.irw / azimuth_cell / 0.886 - 1) < 0.02
    assert abs(m.range.irw * in_slant / cell / 0.886 - 1) < 0.02
    assert abs(m.azimuth.pslr_db + 13.3) < 0.3 and abs(m.range.pslr_db + 13.3) < 0.3
    assert abs(m.azimuth_position - row) < azimuth_cell / 20
    assert abs(m.range_position - column) * in_slant < cell / 20
    assert abs(10 * np.log10(m.rcs)) < 0.1  # tol: interpolation of the peak


def edges(profile: np.ndarray, axis: np.ndarray, level: float) -> np.ndarray:
    """Positions where a profile crosses a level, linear between samples."""
    above = profile > level
    i = np.flatnonzero(above[1:] != above[:-1])
    t = (level - profile[i]) / (profile[i + 1] - profile[i])
    return axis[i] + t * (axis[i + 1] - axis[i])


def test_tower_layover_dihedral_and_shadow() -> None:
    """Roof edge h cos(t) ahead of the foot, shadow h / cos(t) long from there on, dihedral line at the foot."""
    # as long as what is looked at
    scene = sarmitsuba.load_scene("tower", parameters={"range_film.image_extent_azimuth": "20"})
    # four surfaces: the speckle of a single one moves an edge by 0.1 m
    images = [
        focus(
            sarmitsuba.simulate(scene, seed=seed),
            request=scene.image,
            range_window="taylor",
            azimuth_window="taylor",
        )
        for seed in range(4)
    ]
    image = images[0]
    height = scene.geometry.bounds[1, 2]
    angle = np.radians(35.0)
    grid = image.grid
    assert grid.kind == "slant"
    power = np.mean([np.abs(i.total()) ** 2 for i in images], axis=0)
    middle = np.abs(grid.azimuth) < 8.0
    profile = power[middle].mean(axis=0)
    antenna = scene.radar.track.center_position
    half = 0.5 * scene.radar.waveform.range_cell
    # the near wall's foot and the far roof edge, in the vertical plane of the antenna
    boxes = scene.geometry.vertices[scene.geometry.vertices[:, 2] > 1.0]
    near_x, far_x = boxes[:, 0].min(), boxes[:, 0].max()
    foot = np.hypot(near_x - antenna[0], antenna[2])
    roof = np.hypot(near_x - antenna[0], antenna[2] - height)
    line = grid.range[np.argmax(profile)]
    clutter = profile[grid.range > foot + 20].mean()
    smooth = np.convolve(profile, np.ones(5) / 5, mode="same")
    front = grid.range < foot - 3
    wall = smooth[(grid.range > roof + 3) & (grid.range < foot - 3)].mean()
    layover = edges(smooth[front], grid.range[front], 0.5 * (wall + clutter))
    start = layover[np.argmin(np.abs(layover - roof))]
    shadow_end_true = np.hypot(far_x + height * np.tan(angle) - antenna[0], antenna[2])
    back = grid.range > foot + 5
    dark = smooth[(grid.range > shadow_end_true - 4) & (grid.range < shadow_end_true - 1)].mean()
    ends = edges(smooth[back], grid.range[back], 0.5 * (clutter + dark))
    end = ends[np.argmin(np.abs(ends - shadow_end_true))]
    roof_far = np.hypot(far_x - antenna[0], antenna[2] - height)
    print(
        f"\ntower: line {line - foot:+.3f} m, layover {foot - start:.3f} m (h cos t = {foot - roof:.3f}), shadow ends "
        f"{end - shadow_end_true:+.3f} m off; shadow {end - roof_far:.3f} m from the far roof edge "
        f"(h / cos t = {height / np.cos(angle):.3f}); half a cell {half:.3f} m"
    )
    assert abs(line - foot) < half
    assert abs(start - roof) < half
    assert abs(end - shadow_end_true) < half


def test_bridge_three_returns() -> None:
    """Single, double and triple returns of the deck's near face: -h cos(t), 0, h cos(t) from the water below."""
    scene = sarmitsuba.load_scene("bridge")
    request = replace(scene.image, spacing_range=0.1)
    image = focus(sarmitsuba.simulate(scene), request=request, range_window="taylor", azimuth_window="taylor")
    grid = image.grid
    assert grid.kind == "slant"
    antenna = scene.radar.track.center_position
    cell = scene.radar.waveform.range_cell
    # between the piers
    profile = (np.abs(image.total()[np.abs(grid.azimuth) < 22.0]) ** 2).mean(axis=0)
    i = scene.geometry.mesh_names.index("fascia")
    first, last = scene.geometry.mesh_face_offset[i : i + 2]
    face = scene.geometry.vertices[scene.geometry.faces[first:last]].reshape(-1, 3)
    x, height = face[:, 0].min(), 0.5 * (face[:, 2].min() + face[:, 2].max())
    face_length = np.ptp(face[:, 2]) * np.cos(np.radians(35.0))
    # matched to the face's own length in slant range, so that its middle is found
    box = np.ones(max(1, round(face_length / grid.range_spacing)))
    smooth = np.convolve(profile, box / box.size, mode="same")
    found, true = [], []
    for z in (height, 0.0, -height):
        true.append(float(np.hypot(x - antenna[0], antenna[2] - z)))
        near = np.flatnonzero(np.abs(grid.range - true[-1]) < 3.0)
        found.append(float(grid.range[near[np.argmax(smooth[near])]]))
    off = np.subtract(found, true)
    spacing, expected = found[2] - found[0], true[2] - true[0]
    print(f"\nbridge: off {off.round(3)} m; single to triple {spacing:.3f} m, 2 h cos t = {expected:.3f} m")
    assert abs(spacing - expected) < 0.5 * cell
    assert np.abs(off).max() < 0.5 * cell


def test_flat_ground_level_and_speckle() -> None:
    """sigma0 = -10 dB comes out at -10 dB, with the speckle of one look."""
    scene = sarmitsuba.load_scene("flat_ground")
    image = focus(sarmitsuba.simulate(scene), request=scene.image)
    sigma0 = image.sigma0()
    n_a, n_r = sigma0.shape
    inner = sigma0[n_a // 8 : -(n_a // 8), n_r // 8 : -(n_r // 8)]
    level = 10 * np.log10(inner.mean())
    ratio = inner.mean() / inner.std()
    extent = inner.size * image.grid.azimuth_spacing * image.grid.range_spacing
    in_slant = np.sin(image.incidence_angle.mean()) if image.grid.kind == "ground" else 1.0
    looks = extent * in_slant / (image.azimuth_resolution_cell * image.range_resolution_cell)
    sigma = np.sqrt(2.0 / looks)  # of mean / std of an exponential variable, delta method
    print(
        f"\nflat ground: {level:.3f} dB; intensity mean / std {ratio:.4f}, 3 sigma {3 * sigma:.4f} ({looks:.0f} cells)"
    )
    assert abs(level + 10.0) < 0.3
    assert abs(ratio - 1.0) < 3 * sigma


def test_speckle_persists_with_denser_rays() -> None:
    """The image at 4 rays a scatterer cell has coherence 0.99 with one at 16."""
    small = {"sar_path.scatterer_cell": "0.8"}
    scene = sarmitsuba.load_scene("flat_ground", parameters=small)
    cosine = np.cos(np.radians(35.0))
    images = []
    for rays in (4.0, 16.0):
        spacing = 0.8 * np.sqrt(cosine / rays)
        scene = sarmitsuba.load_scene(
            "flat_ground", parameters={**small, "sar_path.ray_spacing": f"{spacing}"}
        )
        images.append(focus(sarmitsuba.simulate(scene, pass_index=int(rays)), request=scene.image))
    inner = tuple(slice(n // 8, -(n // 8)) for n in images[0].grid.shape)
    value = coherence(images[0].total()[inner], images[1].total()[inner])
    print(f"\nspeckle: coherence of 4 with 16 rays per cell {value:.4f}")
    assert value >= 0.99


@pytest.mark.slow
def test_same_seed_same_result() -> None:
    """Two runs differ only by the rounding of sums that threads form in any order."""
    scene = sarmitsuba.load_scene(
        "tower", parameters={"sar_path.max_depth": "2", "sar_antenna.azimuth_resolution": "2"}
    )
    a, b = (sarmitsuba.simulate(scene, seed=3).data for _ in range(2))
    other = sarmitsuba.simulate(scene, seed=4).data
    assert np.linalg.norm(a - b) < 1e-5 * np.linalg.norm(a)  # tol: float32 sums in another order
    assert np.linalg.norm(a - other) > 0.1 * np.linalg.norm(a)


def test_memory_does_not_grow_with_pulses() -> None:
    """A block's grid, the largest buffer beside the result, is bounded whatever the number of pulses."""
    largest = []
    for cell in ("4", "0.8"):
        scene = sarmitsuba.load_scene("tower", parameters={"sar_antenna.azimuth_resolution": cell})
        raw = sarmitsuba.simulate(scene)
        largest.append(raw.metadata["sampling"]["grid_bytes"])
        print(f"\nmemory: {raw.data.shape[1]} pulses, largest grid {largest[-1] / 1e6:.1f} MB")
    assert max(largest) <= MAX_GRID_BYTES
    assert largest[1] < 2.5 * largest[0]
