"""The pictures of the pages in ``docs`` that are not made by ``render``, ``validate`` or a benchmark.

Run ``python docs/figures.py [NAME ...]``; writes ``docs/images/NAME.png``. Without a name it makes all of them, which
takes a few minutes: ``methods`` traces every pulse once.
"""

import json
import sys
import tempfile
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from matplotlib.image import AxesImage
from matplotlib.patches import Arc, Polygon

from sarmitsuba.analysis.interferometry import height_map, interferogram
from sarmitsuba.analysis.labels import labels
from sarmitsuba.cli import main
from sarmitsuba.core.arrays import F64
from sarmitsuba.files import read_image, read_raw
from sarmitsuba.loading.load import load_scene
from sarmitsuba.radar.geodesy import Anchor
from sarmitsuba.radar.orbit import OrbitRequest, circular_orbit
from sarmitsuba.signal.focusing import default_grid, focus
from sarmitsuba.signal.focusing.comparison import compare_focusers
from sarmitsuba.signal.focusing.ideal import ideal_echoes, ideal_radar
from sarmitsuba.signal.image import SarImage, ShownAxes, sliding_means
from sarmitsuba.view.charts import focusers_figure
from sarmitsuba.view.fringes import interferogram_figure
from sarmitsuba.view.labels_picture import labels_figure
from sarmitsuba.view.notebook import draw_beam

IMAGES = Path(__file__).parent / "images"
DPI = 100
INK, RAY, GHOST, GROUND, MARK = "#202020", "#1f77b4", "#999999", "#d9cfc1", "#d62728"


def geometry() -> Figure:
    """Side view and plan view of the radar with the angles of ``sar_antenna``."""
    figure = Figure(figsize=(10.5, 4.4), layout="constrained")
    side, plan = figure.subplots(1, 2)
    antenna, aim = np.array([0.0, 6.0]), np.array([6.0, 0.0])
    side.fill_between([-1.0, 9.5], -0.5, 0.0, color=GROUND)
    _line(side, antenna, aim, RAY)
    _line(side, antenna, (0.0, 0.0), GHOST, style="--")
    _line(side, aim, (6.0, 3.2), GHOST, style="--")
    _arc(side, antenna, 270.0, 315.0, 1.8)
    _arc(side, aim, 90.0, 135.0, 1.8)
    _arc(side, aim, 135.0, 180.0, 1.3)
    side.plot(*antenna, "s", color=INK, markersize=9)
    side.plot(*aim, "o", color=INK)
    _text(side, 0.25, 6.35, "antenna (flies into the page)")
    _text(side, 6.15, 0.2, "aim point")
    _text(side, 0.2, 3.2, "look_angle_deg")
    _text(side, 3.5, 3.0, "slant_range R,\ndirection u", color=RAY)
    _text(side, 6.15, 1.7, "incidence angle")
    _text(side, 2.6, 0.25, "grazing angle")
    _text(side, -0.8, 0.25, "nadir")
    _text(side, 8.6, 1.4, "z, up", ha="center")
    _arrow(side, (8.6, 0.0), (8.6, 1.3), INK)
    side.set_title("across the track (look_side right)", fontsize=10)
    side.set_xlim(-1.0, 9.5)
    side.set_ylim(-0.5, 7.0)

    heading = np.radians(25.0)
    along = np.array([np.sin(heading), np.cos(heading)])
    right = np.array([along[1], -along[0]])
    middle = np.array([1.5, 2.5])
    squint = np.radians(20.0)
    target = middle + 5.5 * (np.cos(squint) * right + np.sin(squint) * along)
    _arrow(plan, middle - 2.6 * along, middle + 4.2 * along, INK)
    _line(plan, middle, middle + 5.5 * right, GHOST, style="--")
    _line(plan, middle, target, RAY)
    _line(plan, middle, middle + np.array([0.0, 3.2]), GHOST, style="--")
    _arc(plan, middle, 90.0 - 25.0, 90.0, 2.6)
    _arc(plan, middle, -25.0, -5.0, 3.2)
    plan.plot(*middle, "s", color=INK, markersize=9)
    plan.plot(*target, "o", color=INK)
    _text(plan, *(middle + 4.3 * along), "flight direction a")
    _text(plan, middle[0] - 0.1, middle[1] + 2.3, "heading_deg", ha="right")
    _text(plan, middle[0], middle[1] + 3.4, "north, y", ha="center")
    _text(plan, *(middle + 3.5 * right + 0.5 * along), "squint_angle_deg")
    _text(plan, *(middle + 4.6 * right - 0.45 * along), "look side c", ha="center", va="top")
    _text(plan, target[0] + 0.2, target[1] + 0.1, "aim point")
    _text(plan, middle[0] - 0.3, middle[1] - 0.1, "antenna at\nmid-aperture", ha="right", va="center")
    plan.set_title("from above", fontsize=10)
    plan.set_xlim(-2.0, 9.5)
    plan.set_ylim(-0.8, 7.4)
    for axes in (side, plan):
        axes.set_aspect("equal")
        axes.set_axis_off()
    return figure


def paths() -> Figure:
    """Ray tubes at a wall on the ground: where the tubes close, and the virtual antenna of the double bounce."""
    figure = Figure(figsize=(8.0, 4.4), layout="constrained")
    axes = figure.subplots()
    antenna, virtual = np.array([0.0, 6.0]), np.array([0.0, -6.0])
    wall = 12.0
    axes.fill_between([-1.0, wall], -0.35, 0.0, color=GROUND)
    axes.add_patch(
        Polygon([(wall, -0.35), (wall + 0.5, -0.35), (wall + 0.5, 4.6), (wall, 4.6)], color=GROUND)
    )
    hits = []
    for offset in (-0.6, 0.6):  # the two edges of the tube
        ground = np.array([8.0 + offset, 0.0])
        height = 6.0 * (wall - ground[0]) / ground[0]
        hits.append((ground, np.array([wall, height])))
        _line(axes, antenna, ground, RAY, width=0.8)
        _line(axes, ground, hits[-1][1], RAY, width=0.8)
        _line(axes, virtual, ground, GHOST, style=":")
    axes.add_patch(Polygon([antenna, hits[0][0], hits[1][0]], color=RAY, alpha=0.15))
    axes.add_patch(Polygon([hits[0][0], hits[1][0], hits[1][1], hits[0][1]], color=RAY, alpha=0.15))
    axes.add_patch(Polygon([virtual, hits[0][0], hits[1][0]], color=GHOST, alpha=0.12))
    first, second = np.array([8.0, 0.0]), np.array([wall, 3.0])
    _line(axes, hits[0][0], hits[1][0], "#d62728", width=4)
    _line(axes, hits[0][1], hits[1][1], "#d62728", width=4)
    _arrow(axes, second, second + 0.93 * (antenna - second), "#2ca02c", width=1.2)
    _line(axes, first, antenna, "#2ca02c", style="--", width=1.2)
    axes.plot(*antenna, "s", color=INK, markersize=9)
    axes.plot(*virtual, "s", color=GHOST, markersize=9)
    _text(axes, 0.3, 6.35, "antenna A")
    _text(axes, 0.5, -6.1, "virtual antenna A* (A mirrored in the ground)", color="#666666")
    _text(axes, 0.6, -2.6, "unfolded length\nL = |p − A*|", color="#666666")
    _text(axes, 9.0, -0.95, "first hit: footprint dS")
    _text(axes, wall + 0.8, 3.0, "second hit p:\nfootprint dS,\nlater hits alike", va="center")
    _text(axes, 4.6, 5.2, "at every hit the tube closes to A, way back R = |p − A|", color="#2ca02c")
    _text(axes, 2.4, 2.3, "ray tube dΩ", color=RAY, ha="center")
    axes.set_xlim(-1.0, 17.0)
    axes.set_ylim(-6.6, 6.9)
    axes.set_aspect("equal")
    axes.set_axis_off()
    return figure


def methods() -> Figure:
    """The tower by each of the four methods, on one grey scale."""
    names = ("raster", "image", "hybrid", "raw")
    common = ["-D", "sar_antenna.azimuth_resolution=1", "--no-error-bars"]  # fewer pulses, for raw's sake
    return _panels("tower", {name: ["--method", name, *common] for name in names})


def effects() -> Figure:
    """The tower with its effects as planned, and with one of them switched off."""
    return _panels(
        "tower",
        {
            "as planned": [],
            "max_depth 1": ["-D", "sar_path.max_depth=1"],
            "coherent off": ["-D", "sar_path.coherent=off"],
            "diffuse off": ["-D", "sar_path.diffuse=off"],
        },
    )


def plate_edges() -> Figure:
    """The metal sheet above grass: HH and VV, and physical optics alone."""
    common = ["--no-error-bars", "-D", "range_film.image_extent_azimuth=12"]
    return _panels(
        "plate_edges",
        {
            "HH": [*common, "-D", "polarisation=HH"],
            "VV": [*common, "-D", "polarisation=VV"],
            "HH or VV, edge_diffraction off": [
                *common,
                "-D",
                "polarisation=HH",
                "-D",
                "edge_diffraction=off",
            ],
        },
        scale=(-30.0, 10.0),
    )


def azimuth_ambiguities() -> Figure:
    """The tower in stripmap: sampled as it should be, undersampled, and undersampled by a staggered PRF."""
    beam = {"mode": "stripmap", "pattern": "rectangular", "antenna_length": "2", "antenna_height": "0.2"}
    common = [f"sar_antenna.{name}={value}" for name, value in beam.items()]
    common += ["sar_antenna.azimuth_resolution=1.2", "sar_antenna.prf=PRF"]
    common += ["range_film.image_extent_azimuth=300", "range_film.image_extent_range=70"]

    def options(prf: str, *more: str) -> list[str]:
        given = [text.replace("PRF", prf) for text in (*common, *more)]
        return [*(part for text in given for part in ("-D", text)), "--no-error-bars"]

    return _panels(
        "tower",
        {
            "prf 250 Hz": options("250"),
            "prf 70 Hz": options("70"),
            "prf 70 Hz, pri_sequence ramp:12:0.8": options("70", "sar_antenna.pri_sequence=ramp:12:0.8"),
        },
        scale=(-60.0, 5.0),
        lying=True,
    )


def receiver() -> Figure:
    """The tower as recorded ideally, with few bits, and beside emitters without and with a filter."""
    power = ["-D", "sar_antenna.transmit_power=100", "-D", "sar_antenna.gain_db=30", "--no-error-bars"]
    power += ["-D", "sar_antenna.noise_temperature=600"]
    with tempfile.TemporaryDirectory() as folder:
        emitters = Path(folder) / "emitters.csv"
        rows = ("narrow,300,-200,2,20,9.7e9,2e5", "narrow,-80,150,2,20,9.55e9,0")
        emitters.write_text("\n".join(["kind,x_m,y_m,z_m,eirp_w,frequency_hz,bandwidth_hz", *rows]) + "\n")
        beside = [*power, "-D", f"sar_antenna.interference_file={emitters}"]
        coded = ["-D", "sar_antenna.raw_coding=baq", "-D", "sar_antenna.baq_bits=1"]
        return _panels(
            "tower",
            {
                "ideal receiver": power,
                "BAQ of 1 bit": [*power, *coded],
                "two emitters": beside,
                "with --interference-filter notch": [*beside, "--interference-filter", "notch"],
            },
        )


def moving() -> Figure:
    """Cars and a train that drive, with arrows from where they are, and the same at rest."""
    figure = Figure(figsize=(9.6, 5.2), layout="constrained")
    picture = None
    for axes, (title, options) in zip(
        figure.subplots(1, 2, sharey=True),
        {"as they drive": [], "moving_targets off": ["-D", "sar_path.moving_targets=off"]}.items(),
        strict=True,
    ):
        image = _render("moving_cars", [*options, "--no-error-bars", "--window", "taylor"])
        picture, shown = _pixels(axes, image, image.sigma0(), (-33.0, 3.0))
        axes.set_title(title, fontsize=10)
        if not options:
            axes.set_ylabel(shown.azimuth_label, fontsize=9)
            for name, place, ahead in (
                ("train", (25.0, 8.0), -36.2),
                ("car_east", (-6.0, 16.0), -35.4),
                ("car_west", (20.0, 20.0), 26.5),
            ):
                start, end, beside = (
                    tuple(map(float, shown.shown(place[1] + share * ahead, place[0] + right)))
                    for share, right in ((0.0, 0.0), (0.9, 0.0), (0.5, 2.5))
                )
                _arrow(axes, start, end, MARK, 2.0)
                box = {"facecolor": "white", "edgecolor": "none", "pad": 1.5}
                axes.text(*beside, name, fontsize=9, color=MARK, bbox=box)
    figure.colorbar(picture, ax=figure.axes, label="sigma0 (dB)", shrink=0.9)
    return figure


def railing() -> Figure:
    """Railings, lamp posts, masts and cables, with words for what is what, and the scene without them."""
    figure = Figure(figsize=(10.4, 4.6), layout="constrained")
    picture = None
    words = {
        (-42.0, -42.0): "railing along the flight",
        (-26.0, 29.0): "lamp post",
        (-22.0, 19.0): "posts of the bridge by its deck",
        (-4.0, -24.0): "posts by the grass",
        (12.0, 34.0): "lattice mast",
        (8.0, 11.0): "cables, direct",
        (21.0, -12.0): "and by the grass",
    }
    for axes, (title, options) in zip(
        figure.subplots(1, 2, sharey=True),
        {"as planned": [], "line_scatterers off": ["-D", "sar_path.line_scatterers=off"]}.items(),
        strict=True,
    ):
        image = _render("railing", [*options, "--no-error-bars", "--window", "taylor"])
        picture, shown = _pixels(axes, image, image.sigma0(), (-40.0, 5.0))
        axes.set_title(title, fontsize=10)
        if not options:
            axes.set_ylabel(shown.azimuth_label, fontsize=9)
            for place, text in words.items():
                box = {"facecolor": "white", "edgecolor": "none", "pad": 1.0}
                at = tuple(map(float, shown.shown(place[1], place[0])))
                axes.text(*at, text, fontsize=7.5, color=MARK, bbox=box)
    figure.colorbar(picture, ax=figure.axes, label="sigma0 (dB)", shrink=0.9)
    return figure


def courtyard() -> Figure:
    """A court with and without pairs of diffuse scatterers, and what they return."""
    options = ["--window", "taylor", "--no-error-bars"]
    images = {
        "as planned": _render("courtyard", options),
        "diffuse_pairs off": _render("courtyard", [*options, "-D", "diffuse_pairs=off"]),
    }
    with_pairs, without = images.values()
    images["difference"] = replace(with_pairs, data=with_pairs.data - without.data)
    return _shown(images, (-35.0, 5.0))


def sea() -> Figure:
    """The harbour with its sea moving and frozen, some looks averaged, so that waves show through the speckle."""
    figure = Figure(figsize=(9.6, 4.4), layout="constrained")
    picture = None
    for axes, (title, options) in zip(
        figure.subplots(1, 2, sharey=True),
        {"moving": [], "water_motion off": ["-D", "sar_path.water_motion=off"]}.items(),
        strict=True,
    ):
        image = _render("harbour", [*options, "--no-error-bars", "--window", "taylor"])
        means = sliding_means(image.sigma0(), (4, 4), "reflect")
        picture, shown = _pixels(axes, image, means, (-27.0, 4.0))
        axes.set_title(title, fontsize=10)
        if not options:
            axes.set_ylabel(shown.azimuth_label, fontsize=9)
    figure.colorbar(picture, ax=figure.axes, label="sigma0 (dB)", shrink=0.9)
    return figure


def glass() -> Figure:
    """Two rooms behind glass, plain and coated, as planned and with panes that block."""
    options = {"as planned": [], "transmission off": ["-D", "sar_path.transmission=off"]}
    common = ["--no-error-bars", "--window", "taylor", "-D", "range_film.image_grid=ground"]
    return _shown(
        {t: _render("glass_house", [*more, *common]) for t, more in options.items()},
        (-35.0, 5.0),
        size=(9.0, 4.2),
    )


def facades() -> Figure:
    """Six houses, imported with plain walls and with relief."""
    images = {}
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        (folder / "city.geojson").write_text(json.dumps(_footprints()))
        for title, relief in {
            "plain walls": ["--facades", "none"],
            "windows, balconies and kerbs": [],
        }.items():
            scene = str(folder / "city.xml")
            given = ["import", str(folder / "city.geojson"), "-o", scene, "--force", "--quiet"]
            status = main([*given, "--material", "ground=asphalt_concrete", *relief])
            assert status == 0, f"import {relief} ended with {status}"
            extent = ["-D", "range_film.image_extent_azimuth=76", "-D", "range_film.image_extent_range=120"]
            images[title] = _render(scene, ["-D", "heading_deg=-8", *extent, "--no-error-bars"])
    return _shown(images, (-35.0, 5.0))


def _footprints() -> dict[str, object]:
    """Houses turned by 8 degrees in two streets, as GeoJSON with OpenStreetMap's tags."""
    rng = np.random.default_rng(7)
    turn = np.radians(8.0)
    axes = np.array([[np.cos(turn), np.sin(turn)], [-np.sin(turn), np.cos(turn)]])
    degrees = np.degrees(1.0 / 6.371e6) / np.array([np.cos(np.radians(48.137)), 1.0])
    features = []
    for i in range(6):
        size = rng.uniform([12.0, 18.0], [14.0, 24.0])
        ring = 0.5 * size * np.array([[-1, -1], [1, -1], [1, 1], [-1, 1], [-1, -1]])
        middle = np.array([36.0 * (i % 3 - 1), 32.0 * (i // 3 - 0.5)])
        ring = (ring + middle) @ axes
        tags = {"building": "yes", "building:levels": int(rng.integers(3, 8))}
        place = {"type": "Polygon", "coordinates": [(ring * degrees + [11.575, 48.137]).tolist()]}
        features.append({"type": "Feature", "id": f"way/{i}", "properties": tags, "geometry": place})
    return {"type": "FeatureCollection", "features": features}


def focusers() -> Figure:
    """Every focuser on the same echoes of a dozen points on weak clutter."""
    rng = np.random.default_rng(4)
    radar = ideal_radar(squint_angle=0.05, prf_factor=1.6)
    points = np.column_stack([rng.uniform(-24.0, 24.0, (12, 2)), np.zeros(12)])
    cloud = np.column_stack([rng.uniform(-30.0, 30.0, (600, 2)), np.zeros(600)])
    echoes = [
        ideal_echoes(radar, points, 10.0 ** rng.uniform(0.0, 2.0, 12), rng.uniform(0.0, 6.28, 12)),
        ideal_echoes(radar, cloud, 0.002 * rng.exponential(1.0, 600), rng.uniform(0.0, 6.28, 600)),
    ]
    raw = replace(echoes[0], data=echoes[0].data + echoes[1].data)
    grid = default_grid(raw, {"grid": "slant", "extent_azimuth": 60.0, "extent_range": 60.0})
    return focusers_figure(compare_focusers(raw, grid, window="taylor"))


def interferogram_tower() -> Figure:
    """The pair that `insar tower` makes: fringes, coherence, heights."""
    return _pair("tower")


def interferogram_fields() -> Figure:
    """The pair that `insar fields --days 12` makes."""
    return _pair("fields", "--days", "12")


def labels_of_buildings() -> Figure:
    """Layover and shadow of the sixteen buildings, in colours over their image by method raster."""
    spacing = [f"range_film.pixel_spacing_{axis}=0.4" for axis in ("azimuth", "range")]
    image = _render(
        "buildings16", ["--method", "raster", *(word for value in spacing for word in ("-D", value))]
    )
    return labels_figure(image, labels("buildings16", image=image))


def labels_of_echoes() -> Figure:
    """Mechanisms of the bridge over water, in colours over its image by method image."""
    image = _render("bridge", ["--method", "image"])
    return labels_figure(image, labels("bridge", image=image, layers=["mechanism"]), "mechanism")


def _pair(scene: str, *options: str) -> Figure:
    with tempfile.TemporaryDirectory() as folder:
        assert main(["insar", scene, "-o", f"{folder}/out", "--quiet", *options]) == 0
        one = read_image(f"{folder}/out/first/image.h5")
        two = focus(
            read_raw(f"{folder}/out/second/raw.h5"), one.grid, range_window="taylor", azimuth_window="taylor"
        )
    pair = interferogram(one, two)
    return interferogram_figure(pair, height_map(pair), title=scene)


# a steel container of 6 m, turned by 25 degrees, and a box on gravel, seen at 0.5 GHz from 2 km
YARD = """<scene version="3.0.0">
    <integrator type="sar_path"/>

    <sensor type="sar_antenna">
        <float name="slant_range" value="2000"/>
        <float name="center_frequency" value="0.5e9"/>
        <float name="bandwidth" value="200e6"/>
        <string name="pattern" value="rectangular"/>
        <float name="antenna_length" value="2"/>
        <float name="elevation_beamwidth_deg" value="30"/>
        <film type="range_film">
            <string name="image_grid" value="ground"/>
            <float name="image_center_x" value="0"/>
            <float name="image_center_y" value="0"/>
            <float name="image_extent_azimuth" value="20"/>
            <float name="image_extent_range" value="20"/>
        </film>
    </sensor>

    <bsdf type="radar_material" id="gravel">
        <string name="material" value="medium_dry_ground"/>
        <float name="rms_height" value="0.01"/>
        <string name="diffuse_law" value="constant_gamma"/>
        <float name="diffuse_level_db" value="-18"/>
    </bsdf>
    <bsdf type="radar_material" id="steel">
        <string name="material" value="pec"/>
    </bsdf>

    <shape type="rectangle" id="ground">
        <transform name="to_world"><scale x="14" y="14"/></transform>
        <ref id="gravel"/>
    </shape>
    <shape type="cube" id="container">
        <transform name="to_world">
            <scale x="3" y="1.2" z="1.2"/>
            <rotate z="1" angle="25"/>
            <translate x="-2" y="2.5" z="1.2"/>
        </transform>
        <ref id="steel"/>
    </shape>
    <shape type="cube" id="box">
        <transform name="to_world">
            <scale x="0.9" y="0.9" z="0.6"/>
            <translate x="4" y="-4" z="0.6"/>
        </transform>
        <ref id="steel"/>
    </shape>
</scene>"""


def modes() -> Figure:
    """The yard in every mode, on one grey scale."""
    own = {
        "stripmap": ["azimuth_resolution=1"],
        "sliding_spotlight": ["sliding_factor=0.5", "azimuth_resolution=0.5"],
        "spotlight": ["azimuth_resolution=0.3"],
        "circular": [],
    }
    variants = {
        mode: [*(f"-Dsar_antenna.{value}" for value in (f"mode={mode}", *values)), "--no-error-bars"]
        for mode, values in own.items()
    }
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "yard.xml"
        path.write_text(YARD, encoding="utf-8")
        return _panels(str(path), variants, window="rectangular", scale=(-35.0, 10.0))


def footprints() -> Figure:
    """The beam on the ground about the tower in every mode."""
    figure = Figure(figsize=(13.0, 3.4), layout="constrained")
    common = {"pattern": "rectangular", "antenna_length": "1.5", "elevation_beamwidth_deg": "3"}
    own = {
        "stripmap": {"azimuth_resolution": "0.75"},
        "sliding_spotlight": {"azimuth_resolution": "0.225"},
        "spotlight": {"azimuth_resolution": "0.2"},
        "circular": {"azimuth_resolution": "0"},
    }
    panels = figure.subplots(1, len(own), sharex=True, sharey=True)
    for axes, (mode, values) in zip(panels, own.items(), strict=True):
        parameters = {f"sar_antenna.{k}": v for k, v in {"mode": mode, **common, **values}.items()}
        scene = load_scene("tower", parameters=parameters)
        middle = np.array([scene.image.center_x, scene.image.center_y])
        half = 0.5 * np.array([scene.image.extent_range, scene.image.extent_azimuth])  # it flies north
        corners = np.array([[-1, -1], [1, -1], [1, 1], [-1, 1]]) * half + middle
        axes.add_patch(Polygon(corners, fill=False, color="#d62728"))
        axes.plot(*middle, "+", color=INK)
        axes.set_aspect("equal")
        draw_beam(axes, scene.radar, scene.image.height, whole=True)
        flown = float(np.linalg.norm(np.diff(scene.radar.track.position, axis=0), axis=1).sum())
        axes.set_title(f"{mode}, track of {flown / 1e3:.3g} km", fontsize=10)
        axes.set_xlabel("east (m)")
    figure.axes[0].set_ylabel("north (m)")
    return figure


def orbits() -> Figure:
    """Two passes over a scene on the map, and the angles and the altitude of an orbit from the side."""
    figure = Figure(figsize=(11.0, 4.6), layout="constrained")
    plan, side = figure.subplots(1, 2, width_ratios=(1.0, 1.15))
    anchor = Anchor.of_degrees(48.1, 11.6, 520.0)
    time = np.linspace(-150.0, 150.0, 61)
    aspect = 1.0 / np.cos(anchor.latitude)
    for name, color in (("ascending", RAY), ("descending", "#d62728")):
        wanted = OrbitRequest(514e3, np.radians(97.44), np.radians(35.0), ascending=name == "ascending")
        path = circular_orbit(wanted, anchor, np.zeros(3))
        track = np.degrees(anchor.to_geodetic(path.states(time)[0])[:, :2])
        plan.plot(track[:, 1], track[:, 0], color=color, linewidth=1.4, label=f"{name}, satellite")
        plan.annotate("", track[45, ::-1], track[43, ::-1], arrowprops={"arrowstyle": "-|>", "color": color})
        # ground seen at zero Doppler between two incidence angles
        position, velocity = path.states(time)
        swath = []
        for look in np.radians([18.0, 42.0]):
            up = (
                anchor.to_ecef(position) / np.linalg.norm(anchor.to_ecef(position), axis=1)[:, None]
            ) @ anchor.axes.T
            right = np.cross(velocity, up)
            right /= np.linalg.norm(right, axis=1)[:, None]
            line = (
                np.sin(look) * right
                - np.cos(look) * np.cross(right, velocity) / np.linalg.norm(velocity, axis=1)[:, None]
            )
            swath.append(np.degrees(_on_earth(anchor, position, line)[:, :2]))
        edge = np.concatenate([swath[0], swath[1][::-1]])
        plan.fill(edge[:, 1], edge[:, 0], color=color, alpha=0.15, label="looks of 18 to 42 deg")
        here = track[time.size // 2]
        plan.plot([here[1], 11.6], [here[0], 48.1], color=color, linestyle="--", linewidth=1.2)
        plan.plot(here[1], here[0], "s", color=color)
    plan.plot(11.6, 48.1, "o", color=INK)
    _text(plan, 11.9, 48.4, "scene")
    plan.set_xlim(0.0, 24.0)
    plan.set_ylim(42.0, 54.0)
    plan.set_aspect(aspect)
    plan.set_xlabel("longitude (deg)", fontsize=9)
    plan.set_ylabel("latitude (deg)", fontsize=9)
    plan.legend(fontsize=7, loc="lower right")
    plan.set_title("514 km, 97.44 deg, look_side right, incidence 35 deg", fontsize=10)
    _orbit_from_the_side(side)
    return figure


def _orbit_from_the_side(side: Axes) -> None:
    """Angles and altitude, the Earth drawn smaller than it is."""
    radius, height, turn = 10.0, 4.2, np.radians(22.0)
    ground = np.array([np.sin(turn), np.cos(turn)])
    satellite, aim = np.array([0.0, radius + height]), radius * ground
    angle = np.linspace(-0.35, 0.75, 100)
    side.fill_between(radius * np.sin(angle), 4.0, radius * np.cos(angle), color=GROUND)
    tangent = np.array([np.cos(turn), -np.sin(turn)])
    _line(side, aim - 2.6 * tangent, aim + 2.6 * tangent, "#2ca02c")
    _line(side, aim, aim + 3.4 * ground, GHOST, style="--")
    _line(side, satellite, (0.0, 4.0), GHOST, style="--")
    _line(side, satellite, aim, RAY)
    line = np.degrees(np.arctan2(*(aim - satellite)[::-1]))
    _arc(side, satellite, 270.0, 360.0 + line, 1.4)
    _arc(side, aim, 90.0 - 22.0, 180.0 + line, 1.5)
    side.plot(*satellite, "s", color=INK, markersize=9)
    side.plot(*aim, "o", color=INK)
    _text(side, 0.35, radius + height + 0.3, "satellite (flies into the page)")
    _text(side, 0.15, 12.2, "look\nangle")
    _text(side, 1.4, 13.0, "slant range R", color=RAY)
    _text(side, 3.65, 11.35, "incidence_angle_deg")
    _text(side, *(aim + 3.4 * ground + [0.15, 0.0]), "z, up at the anchor")
    _text(side, *(aim + 2.6 * tangent + [0.2, 0.0]), "the scene's plane z = 0", color="#2ca02c", va="center")
    _text(side, -0.15, 11.6, "orbit_altitude over\n6378.137 km", ha="right")
    _arrow(side, (-0.08, radius), (-0.08, radius + height - 0.2), INK)
    _text(side, -1.6, 8.0, "Earth (WGS-84),\nturning")
    side.set_xlim(-3.2, 10.5)
    side.set_ylim(7.0, 15.2)
    side.set_aspect("equal")
    side.set_axis_off()


def _on_earth(anchor: Anchor, position: F64, line: F64) -> F64:
    """Geodetic coordinates where lines from positions, both in the file's frame, meet the ellipsoid."""
    distance = np.full(len(position), 5e5)
    for _ in range(30):  # the height falls almost linearly along the line
        point = anchor.to_geodetic(position + distance[:, None] * line)
        further = anchor.to_geodetic(position + (distance + 10.0)[:, None] * line)
        distance = distance - point[:, 2] * 10.0 / (further[:, 2] - point[:, 2])
    return anchor.to_geodetic(position + distance[:, None] * line)


def _panels(
    scene: str,
    variants: dict[str, list[str]],
    window: str = "taylor",
    scale: tuple[float, float] = (-45.0, 5.0),
    *,
    lying: bool = False,
) -> Figure:
    """Images beside each other, or lying on their sides one below the other."""
    images = {title: _render(scene, [*options, "--window", window]) for title, options in variants.items()}
    return _shown(images, scale, lying=lying)


def _shown(
    images: dict[str, SarImage],
    scale: tuple[float, float],
    *,
    lying: bool = False,
    size: tuple[float, float] | None = None,
) -> Figure:
    """Images on one grey scale, ``size`` in inches."""
    figure = Figure(figsize=size or ((9.0, 4.4) if lying else (13.0, 3.7)), layout="constrained")
    rows, columns = (len(images), 1) if lying else (1, len(images))
    panels = figure.subplots(rows, columns, sharex=True, sharey=True)
    picture, shown = None, None
    for axes, (title, image) in zip(panels, images.items(), strict=True):
        picture, shown = _pixels(axes, image, image.sigma0(), scale, lying=lying)
        axes.set_title(title, fontsize=10)
        if lying:
            axes.set_ylabel(shown.range_label, fontsize=9)
    if lying:
        panels[-1].set_xlabel(shown.azimuth_label, fontsize=9)
    else:
        panels[0].set_ylabel(shown.azimuth_label, fontsize=9)
    figure.colorbar(picture, ax=list(panels), label="sigma0 (dB)", shrink=0.95)
    return figure


def _pixels(
    axes: Axes, image: SarImage, power: F64, scale: tuple[float, float], *, lying: bool = False
) -> tuple[AxesImage, ShownAxes]:
    """Pixels of an image in decibels, in coordinates of the scene as ``picture`` shows them."""
    shown = ShownAxes.of(image.grid)
    left, right, low, high = shown.extent(image.grid)
    values, extent = 10.0 * np.log10(np.maximum(power, 1e-12)), (left, right, low, high)
    if lying:
        values, extent = values.T, (low, high, left, right)
    picture = axes.imshow(
        values,
        cmap="gray",
        vmin=scale[0],
        vmax=scale[1],
        origin="lower",
        extent=extent,
    )
    axes.tick_params(labelsize=8)
    axes.ticklabel_format(useOffset=False)
    if not lying:
        axes.set_xlabel(shown.range_label, fontsize=9)
    return picture, shown


def _render(scene: str, options: Sequence[str]) -> SarImage:
    with tempfile.TemporaryDirectory() as folder:
        status = main(["render", scene, "-o", f"{folder}/out", "--quiet", *options])
        assert status == 0, f"render {scene} {options} ended with {status}"
        return read_image(f"{folder}/out/image.h5")


def _line(
    axes: Axes, start: Sequence[float], end: Sequence[float], color: str, style: str = "-", width: float = 1.4
) -> None:
    axes.plot([start[0], end[0]], [start[1], end[1]], style, color=color, linewidth=width)


def _arrow(axes: Axes, start: Sequence[float], end: Sequence[float], color: str, width: float = 1.4) -> None:
    style = {"arrowstyle": "->", "color": color, "linewidth": width}
    axes.annotate("", xy=tuple(end), xytext=tuple(start), arrowprops=style)


def _arc(axes: Axes, center: Sequence[float], start: float, end: float, radius: float) -> None:
    axes.add_patch(Arc(tuple(center), 2 * radius, 2 * radius, theta1=start, theta2=end, color=INK))


def _text(axes: Axes, x: float, y: float, text: str, **options: str) -> None:
    axes.text(x, y, text, fontsize=9, **{"color": INK, **options})


FIGURES = {
    figure.__name__: figure
    for figure in (
        geometry,
        orbits,
        paths,
        methods,
        effects,
        plate_edges,
        moving,
        railing,
        courtyard,
        glass,
        sea,
        facades,
        azimuth_ambiguities,
        receiver,
        focusers,
        interferogram_tower,
        interferogram_fields,
        labels_of_buildings,
        labels_of_echoes,
        modes,
        footprints,
    )
}


if __name__ == "__main__":
    for name in sys.argv[1:] or FIGURES:
        FigureCanvasAgg(FIGURES[name]()).print_figure(IMAGES / f"{name}.png", dpi=DPI)
        print(IMAGES / f"{name}.png")
