"""Cities of boxes of any size: the same ground, more and more buildings on it."""

from pathlib import Path

from sarmitsuba.core.constants import SPEED_OF_LIGHT
from sarmitsuba.scene.mesh.formats import write_ply
from scenes.city import city_mesh

_XML = """<!--
{n} buildings
Boxes of {low:g} m to {high:g} m on {extent:g} m x {extent:g} m of soil, made by tests/support/city.py.
-->
<scene version="3.0.0">
    <integrator type="sar_path"/>
    <sensor type="sar_antenna">
        <float name="slant_range" value="10000"/>
        <float name="look_angle_deg" value="35"/>
        <float name="aim_x" value="0"/>
        <float name="aim_y" value="0"/>
        <float name="aim_z" value="0"/>
        <float name="center_frequency" value="9.65e9"/>
        <float name="bandwidth" value="{bandwidth:.0f}"/>
        <float name="azimuth_resolution" value="{resolution:g}"/>
        <film type="range_film">
            <float name="image_extent_azimuth" value="{extent:g}"/>
            <float name="image_extent_range" value="{extent:g}"/>
        </film>
    </sensor>
    <bsdf type="radar_material" id="soil">
        <float name="permittivity_real" value="12"/>
        <float name="permittivity_imag" value="2.6"/>
        <float name="rms_height" value="0.01"/>
        <string name="diffuse_law" value="constant_gamma"/>
        <float name="diffuse_level_db" value="-14"/>
    </bsdf>
    <bsdf type="radar_material" id="concrete">
        <string name="material" value="concrete"/>
        <float name="rms_height" value="0.002"/>
        <string name="diffuse_law" value="lambert"/>
        <float name="diffuse_level_db" value="-12"/>
    </bsdf>
    <shape type="rectangle" id="ground">
        <transform name="to_world"><scale x="{half:g}" y="{half:g}"/></transform>
        <ref id="soil"/>
    </shape>
    <shape type="ply" id="buildings">
        <string name="filename" value="city_{n}.ply"/>
        <ref id="concrete"/>
    </shape>
</scene>
"""


def make_city(
    n_buildings: int,
    folder: Path | str,
    *,
    extent: float = 400.0,
    resolution: float = 1.0,
    heights: tuple[float, float] = (6.0, 30.0),
    seed: int = 1,
) -> Path:
    """Write a scene of ``n_buildings`` boxes on a fixed piece of ground, and return its XML file.

    Parameters
    ----------
    n_buildings : 1 to as many as wanted; ``extent`` stays, so the ray count does too
    folder : where ``city_N.xml`` and ``city_N.ply`` go; made if missing
    extent : side of ground and image, m
    resolution : azimuth and slant-range cell, m
    heights : lowest and highest building, m
    seed : of the buildings
    """
    folder = Path(folder)
    folder.mkdir(parents=True, exist_ok=True)
    write_ply(folder / f"city_{n_buildings}.ply", *city_mesh(n_buildings, extent, heights, seed))
    path = folder / f"city_{n_buildings}.xml"
    text = _XML.format(
        n=n_buildings,
        low=heights[0],
        high=heights[1],
        extent=extent,
        half=0.5 * extent,
        resolution=resolution,
        bandwidth=0.5 * SPEED_OF_LIGHT / resolution,
    )
    path.write_text(text, encoding="utf-8")
    return path


__all__ = ["make_city"]
