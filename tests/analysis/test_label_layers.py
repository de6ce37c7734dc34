"""Labels of an image: which layers are made, for which windows, and what is said where there are none."""

import json

import numpy as np
import pytest

import sarmitsuba
from sarmitsuba.analysis import labels as makers
from sarmitsuba.analysis.labels import LAYERS, MAKERS
from sarmitsuba.core.errors import DataError
from sarmitsuba.files.coco import coco_document
from sarmitsuba.loading.build import SceneMesh, build_scene
from sarmitsuba.radar.description import RadarDescription
from sarmitsuba.scene.scene import Scene
from tests.support.scenes import shipped


def _scene(**settings: object) -> Scene:
    return shipped("dihedral").replace(method="image", noise="off", **settings)


def test_layers_are_those_that_the_makers_name() -> None:
    scene = _scene()
    found = sarmitsuba.labels(scene, classes={scene.geometry.mesh_names[0]: "metal"})
    assert tuple(found.layers) == LAYERS
    plain = sarmitsuba.labels(scene)
    assert set(LAYERS) - set(plain.layers) == {"class", "class_share"}


@pytest.mark.parametrize("maker", range(len(MAKERS)))
def test_only_layers_that_are_wanted_are_made(maker: int, monkeypatch: pytest.MonkeyPatch) -> None:
    def never(*_: object, **__: object) -> None:
        raise AssertionError("made, and nobody asked")

    scene = _scene()
    whole = sarmitsuba.labels(scene)
    names = [name for name in MAKERS[maker].layers if name in whole.layers][:2]
    monkeypatch.setattr(makers, ("echo_labels", "geometric_layers")[maker], never)
    found = sarmitsuba.labels(scene, layers=names)
    assert list(found.layers) == names
    for name in names:
        np.testing.assert_array_equal(found[name], whole[name])
    assert bool(found.instances) == (maker == 1)


def test_layers_that_there_are_not_are_refused() -> None:
    scene = _scene()
    with pytest.raises(DataError, match=r'no layer "mechanisms".*did you mean.*mechanism'):
        sarmitsuba.labels(scene, layers=["mechanisms"])
    with pytest.raises(DataError, match=r'no layer "class": name classes'):
        sarmitsuba.labels(scene, layers=["shape", "class"])
    two_antennas = shipped("plate").replace(receiver_offset_across=400.0)
    with pytest.raises(DataError, match=r'no layer "instance": .*left out: .*method'):
        sarmitsuba.labels(two_antennas, layers=["instance"])
    found = sarmitsuba.labels(two_antennas)
    assert "mechanism" not in found.layers and "shape" in found.layers
    assert any("left out" in note for note in found.notes)


@pytest.mark.parametrize("windows", [("rectangular", "taylor"), ("hann", "rectangular")])
def test_echoes_are_labelled_with_the_windows_of_the_image(windows: tuple[str, str]) -> None:
    """All power of a dihedral that method image shows is one mechanism's, in every pixel."""
    scene = _scene(max_depth=2)
    image = sarmitsuba.render(scene, range_window=windows[0], azimuth_window=windows[1])
    found = sarmitsuba.labels(scene, image=image, layers=["mechanism_energy", "mechanism"])
    main = np.bincount(found["mechanism"].ravel()).argmax() - 1
    power = sum(np.square(np.abs(image.total(name).astype(np.complex128))) for name in image.channels)
    peak = np.unravel_index(power.argmax(), power.shape)
    near = tuple(slice(max(0, i - 6), i + 7) for i in peak)
    labelled = found["mechanism_energy"][..., main][near]
    # tol: single bounces and edges beside the double one, in the same pixels
    assert np.linalg.norm(labelled - power[near]) < 0.02 * np.linalg.norm(power[near])


def test_masks_of_coco_are_where_a_shape_has_echoes() -> None:
    found = sarmitsuba.labels(_scene())
    document = json.loads(json.dumps(coco_document(found, "pixels.png", "instance")))
    own = found["instance_here"] != 0
    for one in document["annotations"]:
        code = next(n for n, name in found.layers["instance"].codes.items() if name == one["name"])
        assert one["area"] == int(((found["instance"] == code) & own).sum()) > 0
        assert one["iscrowd"] == 0
    assert document["annotations"]


def test_parts_named_alike_are_one_object() -> None:
    """Walls and roof of a house are one shape of the labels, and parts in a layer of their own."""
    import trimesh

    solid = trimesh.creation.box((8.0, 8.0, 6.0))
    solid.apply_translation((0.0, 0.0, 3.0))
    up = solid.face_normals[:, 2] > 0.5
    meshes = [
        SceneMesh(
            [[-30, -30, 0], [30, -30, 0], [30, 30, 0], [-30, 30, 0]], [[0, 1, 2], [0, 2, 3]], "soil", "lawn"
        ),
        *(
            SceneMesh(solid.vertices, solid.faces[own], kind, f"house/{part}")
            for own, kind, part in ((~up, "brick", "walls"), (up, "metal", "roof"))
        ),
    ]
    scene = build_scene(meshes, radar=RadarDescription(azimuth_resolution=1.0, bandwidth=150e6))
    geometry = scene.geometry
    assert geometry.object_names == ("lawn", "house") and geometry.mesh_object.tolist() == [0, 1, 1]
    assert geometry.faces_of_object(1).tolist() == list(range(2, 14))
    found = sarmitsuba.labels(scene, classes={"hou*": "building"})
    assert [(one.name, one.semantic_class) for one in found.instances] == [
        ("lawn", ""),
        ("house", "building"),
    ]
    shape, part = found["shape"], found["part"]
    assert found.layers["part"].codes == {0: "none", 1: "lawn", 2: "house/walls", 3: "house/roof"}
    assert np.any(part == 3) and ((part >= 2) == (shape == 2)).all()
    # the house alone hides the ground behind it, whichever part a line of sight meets
    assert (found["shadow_of"][found["layover_shadow"] == 1] == 2).all() and found.instances[
        1
    ].shadow_pixels > 0
    lone = [SceneMesh(m.vertices, m.faces, m.material, name) for m, name in zip(meshes, "abc", strict=True)]
    apart = sarmitsuba.labels(
        build_scene(lone, radar=RadarDescription(azimuth_resolution=1.0, bandwidth=150e6))
    )
    np.testing.assert_array_equal(apart["shape"], part)  # one shape each without a common name


def test_labels_print_on_one_line() -> None:
    found = sarmitsuba.labels(_scene(), layers=["layover_shadow", "shape"])
    assert str(found).startswith("Labels(") and "layover_shadow, shape; 0 instances" in str(found)
    assert len(str(found).splitlines()) == 1 and len(str(found)) < 120


def test_instances_of_chosen_mechanisms() -> None:
    """Of the dihedral's echoes only those of its two faces together: fewer pixels than all, and a hint for a typo."""
    scene = _scene()
    whole, double = (
        sarmitsuba.labels(scene, mechanisms=m) for m in (None, ["double bounce", "wall and ground"])
    )
    none = sarmitsuba.labels(scene, mechanisms=["point"])
    assert 0 < np.count_nonzero(double["instance"]) <= np.count_nonzero(whole["instance"])
    assert not none["instance"].any() and all(one.pixels == 0 for one in none.instances)
    np.testing.assert_array_equal(double["mechanism"], whole["mechanism"])
    with pytest.raises(DataError, match=r'no mechanism "double bounces".*did you mean'):
        sarmitsuba.labels(scene, mechanisms=["double bounces"])
