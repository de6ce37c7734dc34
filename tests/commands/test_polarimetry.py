"""The command ``polarimetry``: pictures and figures of quad-pol and compact images, and what it refuses."""

import json
from pathlib import Path
from typing import Any

import matplotlib.image
import numpy as np
import pytest

from sarmitsuba import cli
from sarmitsuba.radar.polarisation import LINEAR
from sarmitsuba.truth.validation.chain import make_scene
from sarmitsuba.truth.validation.targets import PEC, wall_and_ground
from tests.support.unweighted import render

RADAR = {
    "slant_range": 1000.0,
    "look_angle_deg": 45.0,
    "heading_deg": 180.0,
    "azimuth_resolution": 1.0,
    "bandwidth": 150e6,
    "image_extent_azimuth": 12.0,
    "image_extent_range": 12.0,
}


def image_folder(folder: Path, channels: str) -> Path:
    """Folder with ``image.h5`` of a corner whose fold is level, seen at 45 degrees."""
    shape = wall_and_ground(0.6, 0.6, 0.6)
    scene = make_scene(shape, PEC * 2, {**RADAR, "polarisation": channels})
    folder.mkdir()
    render(scene).save(folder / "image.h5")
    return folder


def test_a_dihedral_is_red_and_has_alpha_of_90_degrees(tmp_path: Path, capsys: Any) -> None:
    source = image_folder(tmp_path / "run", ",".join((*LINEAR, "RH", "RV")))
    assert cli.main(["polarimetry", str(source), "-o", str(tmp_path / "out"), "--looks", "3", "3"]) == 0
    out = capsys.readouterr().out
    assert "low entropy, multiple scattering" in out and "m-chi" in out
    facts = json.loads((tmp_path / "out" / "polarimetry.json").read_text())
    assert facts["looks"] == [3, 3]
    assert facts["quad"]["zones"]["7"]["power"] > 0.99
    assert facts["quad"]["pauli_shares"]["even_bounce"] > 0.98
    assert facts["compact"]["m_chi_shares"]["even_bounce"] > 0.98
    for name in ("pauli", "m_chi", "m_delta"):
        picture = matplotlib.image.imread(tmp_path / "out" / f"{name}.png")[..., :3]
        red, green, blue = np.moveaxis(picture, -1, 0)
        assert ((red > 0.9) & (green < 0.3) & (blue < 0.3)).any()
    for name in ("h_a_alpha", "h_alpha_plane"):
        assert matplotlib.image.imread(tmp_path / "out" / f"{name}.png").std() > 0.05


def test_compact_and_linear_pairs(tmp_path: Path, capsys: Any) -> None:
    source = image_folder(tmp_path / "compact", "RH,RV")
    assert cli.main(["polarimetry", str(source)]) == 0
    assert (source / "m_chi.png").is_file() and not (source / "pauli.png").exists()
    assert json.loads((source / "polarimetry.json").read_text())["quad"] is None
    capsys.readouterr()
    source = image_folder(tmp_path / "dual", "HH,VV")
    assert cli.main(["polarimetry", str(source)]) == 2
    assert 'channels HH, VV; HH, HV, VH, VV or RH, RV are needed: set polarisation to "HH,HV,VH,VV"' in (
        capsys.readouterr().err
    )


@pytest.mark.parametrize("looks", [("0", "1"), ("1", "9999")])
def test_looks_that_do_not_fit(looks: tuple[str, str], tmp_path: Path, capsys: Any) -> None:
    source = image_folder(tmp_path / "run", "RH,RV")
    assert cli.main(["polarimetry", str(source), "--looks", *looks]) == 2
    assert "give 1 or more, up to its size" in capsys.readouterr().err
