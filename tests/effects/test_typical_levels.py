"""Ground by its name alone in the image: visible, and at the level of its kind."""

from pathlib import Path

import numpy as np
import pytest

import sarmitsuba

# a farm yard as a user writes it: ground, house and silo, each with a name and no more
YARD = """<scene version="3.0.0">
  <default name="ground" value="soil"/>
  <sensor type="sar_antenna">
    <float name="look_angle_deg" value="40"/><float name="slant_range" value="5000"/>
    <float name="bandwidth" value="150e6"/><float name="azimuth_resolution" value="1"/>
    <film type="range_film"><string name="image_grid" value="ground"/>
      <float name="image_extent_azimuth" value="60"/><float name="image_extent_range" value="60"/></film>
  </sensor>
  <bsdf type="radar_material" id="ground"><string name="material" value="$ground"/></bsdf>
  <bsdf type="radar_material" id="wall"><string name="material" value="Backstein"/></bsdf>
  <bsdf type="radar_material" id="silo"><string name="material" value="steel"/></bsdf>
  <shape type="rectangle"><transform name="to_world"><scale x="45" y="45"/></transform><ref id="ground"/></shape>
  <shape type="cube"><transform name="to_world"><scale x="3" y="5" z="2"/><translate z="2"/></transform>
    <ref id="wall"/></shape>
  <shape type="cylinder"><point name="p0" x="0" y="9" z="0"/><point name="p1" x="0" y="9" z="6"/>
    <float name="radius" value="1.5"/><ref id="silo"/></shape>
</scene>"""
# dB, of the mean of the outer half of the image, around the level of the table of docs/materials.md at 40 degrees
EXPECTED = {"asphalt": -24.2, "gravel": -16.2, "soil": -13.2, "grass": -12.2, "Rasen": -12.2}


def level_of_ground(path: Path, ground: str) -> float:
    """Mean sigma0 of the image's quarter beyond house and silo on both sides along the track, dB.

    With the default window: side lobes of the silo on asphalt, 50 dB above that, are as strong as asphalt without one.
    """
    image = sarmitsuba.render(sarmitsuba.load_scene(path, parameters={"ground": ground}))
    sigma0 = np.asarray(image.sigma0())
    rows = len(sigma0) // 5
    away = np.concatenate([sigma0[:rows], sigma0[-rows:]])
    return float(10.0 * np.log10(away.mean()))


@pytest.mark.slow
@pytest.mark.filterwarnings("ignore::sarmitsuba.core.errors.SarmitsubaWarning")
def test_a_farm_yard_of_names_is_no_black_image(tmp_path: Path) -> None:
    (tmp_path / "yard.xml").write_text(YARD, encoding="utf-8")
    levels = {ground: level_of_ground(tmp_path / "yard.xml", ground) for ground in EXPECTED}
    print(levels)
    assert levels["asphalt"] < levels["gravel"] < levels["soil"] < levels["grass"]
    for ground, level in levels.items():
        # tol: speckle of about 700 cells is 0.2 dB, the outer cells' incidence and weights
        assert level == pytest.approx(EXPECTED[ground], abs=1.0)
