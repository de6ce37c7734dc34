"""Materials at the ends of their ranges: conductivity, permittivity 1, smooth, rough beyond all models."""

import warnings
from pathlib import Path

import numpy as np
import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st

import sarmitsuba
from sarmitsuba.core.constants import SPEED_OF_LIGHT
from sarmitsuba.core.errors import SarmitsubaWarning, SceneError
from sarmitsuba.scene.materials.diffuse import diffuse_tables, spectrum_table
from sarmitsuba.scene.materials.diffuse_law import LAWS
from sarmitsuba.scene.materials.material import Material
from sarmitsuba.scene.materials.named_materials import permittivity_from_conductivity
from sarmitsuba.simulation.execution.rcs import RcsResult, monostatic_rcs
from sarmitsuba.truth.validation.targets import PEC, dihedral
from tests.support.paths import coherent_flags

FREQUENCY = 9.65e9
WAVELENGTH = SPEED_OF_LIGHT / FREQUENCY
CORNER = dihedral(0.6, 0.6, 0.6)
LOOK = [[1.0, 1.0, 0.0], [1.0, 0.6, 0.2]]


def rcs(material: Material, **options: object) -> RcsResult:
    return monostatic_rcs(CORNER, (material,), LOOK, FREQUENCY, ray_spacing=0.01, max_depth=2, **options)


def test_conductivity_from_none_to_a_superconductor(row) -> None:
    """A dihedral of conductivity 0 to 1e9 S/m grows steadily from a dielectric's to the perfect conductor's return.

    Naive way: the textbook's quotients, whose differences of large numbers lose the loss of a good metal.
    """
    perfect = np.abs(rcs(PEC[0]).amplitude[:, 0])
    steps = []
    for sigma in (0.0, *10.0 ** np.arange(-9.0, 10.0)):
        eps = permittivity_from_conductivity(5.0, sigma, FREQUENCY)
        steps.append(np.abs(rcs(Material("m", permittivity=eps)).amplitude[:, 0]))
    level = np.array(steps)[:, 0]  # HH, VV on the bisector
    assert np.isfinite(level).all() and (level > 0).all()
    assert (np.diff(level[:, 0]) > -1e-4 * perfect[0, 0]).all()  # tol: interference with the single bounces
    assert (level <= perfect[0] * (1 + 1e-4)).all()
    dielectric = np.abs(rcs(Material("m", permittivity=5.0)).amplitude[:, 0])
    # tol: float32 sums
    row(
        "dihedral of 0 S/m against its dielectric: change",
        float(np.abs(steps[0] / dielectric - 1).max()),
        1e-6,
    )
    # tol: the metal's own loss, 4 sqrt(pi f eps0 / sigma) a bounce: 1e-4
    row(
        "dihedral of 1e9 S/m against the perfect conductor",
        float(np.abs(steps[-1] / perfect - 1).max()),
        1e-3,
    )


def test_permittivity_one_returns_nothing(row, tmp_path: Path) -> None:
    """No return from a surface that is not there, and a scene of nothing else is refused."""
    air = np.abs(rcs(Material("air", permittivity=1.0)).amplitude).max()
    metal = np.abs(rcs(PEC[0]).amplitude).max()
    # tol: the incident field's two currents cancel to float32 rounding
    row("dihedral of permittivity 1 against metal", 20 * np.log10(max(air / metal, 1e-20)), -140.0, "dB")
    scene = tmp_path / "air.xml"
    scene.write_text(
        '<scene version="3.0.0"><sensor type="sar_antenna"/><shape type="cube"><bsdf type="radar_material">'
        '<float name="permittivity_real" value="1"/></bsdf></shape></scene>'
    )
    with pytest.raises(SceneError, match="the scene has no scatterers"):
        sarmitsuba.load_scene(scene)


def test_smooth_is_rms_height_zero(row) -> None:
    """The roughness factor of height 0, and of one atom's radius, changes nothing that matters."""
    smooth = rcs(Material("m", permittivity=5.0 - 1.0j)).amplitude
    switched = {}
    for height in (0.0, 1e-10):
        material = Material("m", permittivity=5.0 - 1.0j, rms_height=height)
        flags = coherent_flags((material,), ("HH", "VV"), 2, roughness=True)
        switched[height] = rcs(material, flags=flags).amplitude
    # tol: float32 sums in the order of the threads
    change = max(float(np.abs(a / smooth - 1).max()) for a in switched.values())
    row("rms height 0 and 1e-10 m against smooth: change", change, 1e-6)


def test_roughness_beyond_any_model_ends_the_coherent_return() -> None:
    """Heights of many wavelengths: no coherent return left, no NaN on the way (exp underflows to 0)."""
    levels = []
    for height in (1e-3, 3e-3, 1e-2, 1.0, 1e3):
        a = rcs(Material("m", pec=True, rms_height=height)).amplitude
        assert np.isfinite(a).all()
        levels.append(np.abs(a).max())
    assert (np.diff(levels) <= 0).all() and levels[-1] == 0.0


@settings(max_examples=150, deadline=None, derandomize=True)
@given(
    law=st.sampled_from(LAWS.names),
    height=st.floats(-300.0, 3.0),
    length=st.floats(-300.0, 3.0),
    level=st.floats(-200.0, 60.0),
    permittivity=st.sampled_from([None, 1.0 + 1e-9, 2.0, 5.0 - 1.0j, 1e9 - 1e12j, 1.0 - 1e12j]),
    wavelength=st.sampled_from([300.0, 0.03, 3e-4]),
)
@example("kirchhoff", -300.0, -30.0, 0.0, None, 0.03)
@example("kirchhoff", -30.0, -300.0, 0.0, None, 0.03)
@example("kirchhoff", -12.0, 3.0, 0.0, 5.0 - 1.0j, 0.03)
@example("iem", -300.0, -300.0, 0.0, 5.0 - 1.0j, 0.03)
@example("iem", -2.0, 3.0, 0.0, 5.0 - 1.0j, 0.03)
@example("small_slope", -2.0, 3.0, 0.0, 5.0 - 1.0j, 0.03)
@example("small_slope", -13.0, -3.0, 0.0, None, 0.03)
def test_diffuse_laws_stay_finite(
    law: str, height: float, length: float, level: float, permittivity: complex | None, wavelength: float
) -> None:
    """Slopes to 0 and to infinity, heights from nothing to a kilometre: finite float32 tables, or one clear line.

    Naive way: 1 / (2 m^2) and log(k s) of vanishing slopes and heights overflow.
    """
    material = Material(
        "m",
        pec=permittivity is None,
        permittivity=permittivity or 1.0,
        rms_height=10.0**height,
        correlation_length=10.0**length,
        diffuse_law=law,
        diffuse_level_db=level,
    )
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        try:
            table = diffuse_tables(material, wavelength, 32)
            tables = [table.amplitude_h, table.amplitude_v]
            if LAWS[law].bistatic == "spectrum":
                bistatic = spectrum_table(material, wavelength, 5, 9, 16)
                tables += [bistatic.amplitude, bistatic.correction]
        except SceneError as error:
            assert law in ("iem", "small_slope") and "rms_height" in str(error) and "\n" not in str(error)
            return
    for amplitude in tables:
        assert np.isfinite(amplitude.astype(np.float32)).all() and (amplitude >= 0).all()


@pytest.mark.parametrize(
    ("law", "height", "length", "says"),
    [
        ("kirchhoff", 1e-4, 0.1, "not rough enough for geometrical optics"),
        ("kirchhoff", 1e-5, 100.0, "a lobe narrower than two steps"),
        ("small_perturbation", 0.01, 0.05, "is above 0.3; use iem"),
        ("iem", 0.03, 0.05, "is above 3; use kirchhoff"),
        ("small_slope", 0.01, 0.1, "is above 1, where hh rises towards vv; use iem"),
    ],
)
def test_a_law_past_its_validity_is_said(
    tmp_path: Path, law: str, height: float, length: float, says: str
) -> None:
    """The scene loads, and a warning names the law, the figure and the law to take."""
    scene = tmp_path / "rough.xml"
    scene.write_text(
        '<scene version="3.0.0"><sensor type="sar_antenna"><float name="center_frequency" value="9.65e9"/></sensor>'
        '<shape type="cube"><bsdf type="radar_material" id="soil"><float name="permittivity_real" value="5"/>'
        f'<string name="diffuse_law" value="{law}"/><float name="rms_height" value="{height}"/>'
        f'<float name="correlation_length" value="{length}"/></bsdf></shape></scene>'
    )
    with pytest.warns(SarmitsubaWarning, match='rough.xml: material "soil": diffuse_law = ') as caught:
        loaded = sarmitsuba.load_scene(scene)
    assert any(says in str(w.message) for w in caught)
    assert any(says in note for note in loaded.notes)
