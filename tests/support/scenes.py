"""Shipped scenes that several tests look at, loaded once in a process; and texts of small scenes."""

import warnings
from functools import cache

from sarmitsuba.loading.load import load_scene
from sarmitsuba.scene.scene import Scene


@cache
def shipped(name: str) -> Scene:
    """A shipped scene under its own radar; a warning is an error."""
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        return load_scene(name)


POINT = """<shape type="sphere"><point name="center" x="{0}" y="{1}" z="{2}"/><float name="radius" value="0.05"/>
        <bsdf type="point_scatterer"><float name="rcs_dbsm" value="20"/></bsdf></shape>"""
_SMALL = """<scene version="3.0.0">
    <integrator type="sar_path"/>
    <sensor type="sar_antenna">
        <float name="slant_range" value="5000"/><float name="look_angle_deg" value="{look}"/>
        <float name="heading_deg" value="{heading}"/><string name="look_side" value="{side}"/>
        <float name="squint_angle_deg" value="{squint}"/><string name="mode" value="{mode}"/>
        <float name="center_frequency" value="9.65e9"/><float name="bandwidth" value="150e6"/>
        <float name="azimuth_resolution" value="1"/>
        <float name="aim_x" value="{x}"/><float name="aim_y" value="{y}"/><float name="aim_z" value="0"/>
        <film type="range_film">
            <string name="image_grid" value="{grid}"/>
            <float name="image_center_x" value="{x}"/><float name="image_center_y" value="{y}"/>
            <float name="image_extent_azimuth" value="60"/><float name="image_extent_range" value="110"/>
        </film>
    </sensor>
    {shapes}
</scene>
"""


def small_scene(
    shapes: str,
    *,
    look: object = 40.0,
    heading: object = 0.0,
    side: object = "right",
    grid: object = "ground",
    squint: object = 0.0,
    mode: object = "stripmap",
    x: object = 0.0,
    y: object = 0.0,
) -> str:
    """Text of a scene of these shapes in cells of 1 m, its image of 60 m x 110 m about (x, y); ``POINT`` is a shape."""
    values = {"look": look, "heading": heading, "side": side, "grid": grid, "squint": squint, "mode": mode}
    return _SMALL.format(**values, x=x, y=y, shapes=shapes)
