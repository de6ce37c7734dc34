"""First-bounce level of diffuse laws that differ between HH and VV, through the automatic effects plan."""

from pathlib import Path

import numpy as np
import pytest

from sarmitsuba.core.units import db_from_power
from sarmitsuba.loading.load import load_scene
from sarmitsuba.scene.materials.diffuse import diffuse_tables
from sarmitsuba.simulation.execution.render import simulate

SCENE = """<scene version="3.0.0">
    <integrator type="sar_path"><integer name="seed" value="1"/></integrator>
    <sensor type="sar_antenna">
        <string name="polarisation" value="HH,VV"/>
        <float name="look_angle_deg" value="60"/>
        <float name="bandwidth" value="150e6"/>
        <film type="range_film"/>
    </sensor>
    <bsdf type="radar_material" id="wall">
        <string name="material" value="concrete"/>
        <float name="rms_height" value="0.01"/>
        {law}
    </bsdf>
    <shape type="rectangle">
        <transform name="to_world"><scale x="8" y="8"/></transform>
        <ref id="wall"/>
    </shape>
</scene>
"""


@pytest.mark.parametrize(
    ("law", "difference_db"),
    [
        ('<string name="diffuse_law" value="roughness"/>', -24.5),
        ('<string name="diffuse_law" value="iem"/><float name="correlation_length" value="0.1"/>', -0.7),
        ('<string name="diffuse_law" value="lambert"/><float name="diffuse_level_db" value="-10"/>', 0.0),
    ],
)
def test_vv_over_hh_of_one_bounce_is_the_laws(tmp_path: Path, law: str, difference_db: float) -> None:
    """Rationale: both channels carry the same random numbers, so that their ratio has no speckle.

    The level of VV was that of HH for `roughness`, that is 24 dB too bright here: a list of names left the law out.
    """
    path = tmp_path / "ground.xml"
    path.write_text(SCENE.format(law=law))
    scene = load_scene(path)
    h, v = diffuse_tables(scene.materials[0], scene.radar.waveform.wavelength).sigma0(np.radians(60.0))
    expected = float(db_from_power(v / h))
    # tol: the figures above, as printed
    assert expected == pytest.approx(difference_db, abs=0.06)
    raw = simulate(scene)
    assert raw.metadata["effects"]["max_depth"] == 1
    power = {channel: np.abs(raw.total(channel)) ** 2 for channel in ("HH", "VV")}
    measured = float(db_from_power(power["VV"].sum() / power["HH"].sum()))
    # tol: 16 m of ground at 10 km, 0.05 degrees of incidence, where the steepest law changes by 1.6 dB a degree
    assert measured == pytest.approx(expected, abs=0.1)
