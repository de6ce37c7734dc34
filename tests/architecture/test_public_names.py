"""The package's public names: ordinary functions and classes with real signatures."""

import inspect
import pickle

import pytest

import sarmitsuba

FUNCTIONS = {
    "build_scene": ("meshes", "points", "radar"),
    "cloude_pottier": ("coherency",),
    "explain": ("scene",),
    "fit": ("scene", "data", "parameters"),
    "focus": ("raw", "grid"),
    "focusing_operator": ("raw", "grid"),
    "gradient": ("scene", "parameters", "loss"),
    "height_map": ("pair", "phase", "lowest"),
    "error_budget": ("image",),
    "image_quality": ("image", "points", "areas"),
    "pauli_rgb": ("coherency",),
    "polarimetry_report": ("image", "looks"),
    "interferogram": ("first", "second", "looks"),
    "jacobian": ("scene", "parameters"),
    "read_image": ("path",),
    "read_raw": ("path",),
    "refine": ("scene",),
    "trace_paths": ("scene", "pulses", "strongest", "near"),
    "write_image": ("image", "path"),
    "write_raw": ("raw", "path"),
    "labels": ("scene", "grid", "image", "classes"),
    "link_budget": ("scene", "rcs", "sigma0_db"),
    "load_extension": ("module_or_file",),
    "load_scene": ("scene",),
    "monostatic_rcs": ("geometry", "materials", "directions", "frequency"),
    "register_plugins": (),
    "render": ("scene",),
    "simulate": ("scene",),
    "spectral_looks": ("image", "azimuth", "range"),
}


@pytest.mark.parametrize("name", sorted(FUNCTIONS))
def test_functions_have_signatures_and_pickle(name: str) -> None:
    function = getattr(sarmitsuba, name)
    assert inspect.isfunction(function)
    parameters = tuple(inspect.signature(function).parameters)
    assert set(FUNCTIONS[name]) <= set(parameters)
    assert "args" not in parameters and "kwargs" not in parameters
    assert pickle.loads(pickle.dumps(function)) is function
    assert inspect.getdoc(function)


def test_dir_shows_the_public_names_only() -> None:
    assert dir(sarmitsuba) == sorted(sarmitsuba.__all__)
    classes = [n for n in sarmitsuba.__all__ if n not in FUNCTIONS and n != "__version__"]
    assert all(inspect.isclass(getattr(sarmitsuba, name)) for name in classes)


def test_unknown_names_are_refused() -> None:
    with pytest.raises(AttributeError, match="no attribute 'simulat'"):
        sarmitsuba.simulat  # noqa: B018
