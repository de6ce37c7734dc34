"""Munich with drawn materials, and starts of fits that are off."""

from dataclasses import dataclass, replace

import numpy as np

from benchmarks.support import harness
from sarmitsuba import Material, Prior, Scene
from sarmitsuba.apps.fit.parsing import parse
from sarmitsuba.core.arrays import F64

# starts are off by at most so much: levels, dB, and shares of permittivities and rms heights
LEVEL_OFF, SHARE_OFF = 3.0, 0.2
KINDS = {"level": "dB", "permittivity": "1", "rms_height": "m"}


@dataclass(frozen=True)
class Size:
    """Size of the study: kinds of walls and of roofs, side of the scene in m, pulses."""

    kinds: int
    extent: float
    pulses: int


WHOLE, SMALL = Size(12, 160.0, 32), Size(3, 60.0, 8)


def drawn(seed: int, size: Size, heights: tuple[float, float] = (0.002, 0.0045)) -> Scene | None:
    """Munich with drawn materials, rms heights between two, m, under the airborne X-band radar without noise."""
    scene = harness.load_munich(
        **{
            "n_pulses": str(size.pulses),
            "polarisation": "VV,HH,HV,VH",
            "image_extent_limit": str(size.extent),
            "sar_antenna.bandwidth": "150e6",
            "sar_antenna.azimuth_resolution": "2",
        }
    )
    if scene is None:
        return None
    rng = np.random.default_rng([seed, 0x3A7])
    materials = [_lambert(f"wall{k}", rng, heights) for k in range(size.kinds)]
    materials += [_small_slope(f"roof{k}", rng, heights) for k in range(size.kinds)]
    materials.append(_lambert("ground", rng, heights))
    geometry = scene.geometry
    of_mesh = []
    for name in geometry.mesh_names:  # mesh-BUILDING-MATERIAL; roofs are of metal and wood there
        wall, roof = rng.integers(size.kinds, size=2)
        is_roof = name.endswith(("itu_metal", "itu_wood"))
        of_mesh.append(2 * size.kinds if name == "mesh-ground" else size.kinds + roof if is_roof else wall)
    faces = np.repeat(of_mesh, np.diff(geometry.mesh_face_offset)).astype(geometry.face_material.dtype)
    off = {"diffuse_pairs": "off", "edge_diffraction": "off"}
    return replace(
        scene,
        materials=tuple(materials),
        geometry=replace(geometry, face_material=faces),
        settings=replace(scene.settings, max_depth=3, effects={**scene.settings.effects, **off}),
        radar=replace(scene.radar, noise_temperature=0.0),
    )


def _lambert(name: str, rng: np.random.Generator, heights: tuple[float, float]) -> Material:
    """Rough dielectric with a level."""
    return Material(
        name,
        permittivity=complex(rng.uniform(3.0, 8.0), -rng.uniform(0.05, 0.5)),
        rms_height=float(rng.uniform(*heights)),
        diffuse_law="lambert",
        diffuse_level_db=float(rng.uniform(-16.0, -8.0)),
        cross_polar_ratio_db=-10.0,
    )


def _small_slope(name: str, rng: np.random.Generator, heights: tuple[float, float]) -> Material:
    """Rough dielectric whose diffuse return follows from its properties."""
    return replace(
        _lambert(name, rng, heights),
        diffuse_law="small_slope",
        correlation_length=float(rng.uniform(0.01, 0.03)),
        diffuse_level_db=-np.inf,
    )


def parameters_of(scene: Scene) -> str:
    """All levels, permittivities and rms heights."""
    names = [m.name for m in scene.materials]
    return ",".join(["levels", *(f"{kind}:{name}" for kind in list(KINDS)[1:] for name in names)])


def started(scene: Scene, seed: int) -> tuple[Scene, F64, dict[str, Prior]]:
    """The scene with wrong values, the true values, and priors as wide as the starts are off."""
    parameters = parse(parameters_of(scene), scene)
    rng = np.random.default_rng([seed, 0x57A])
    start, truth, priors = scene, [], {}
    for parameter in parameters:
        value = float(parameter.values(scene)[0])
        level = parameter.label.startswith("level:")
        off = float(rng.uniform(-1.0, 1.0)) * (LEVEL_OFF if level else SHARE_OFF * value)
        start = parameter.changed(start, np.array([value + off]))
        width = (LEVEL_OFF if level else SHARE_OFF * (value + off)) / np.sqrt(3.0)
        truth.append(value)
        priors[parameter.label] = Prior(value + off, float(width))
    return start, np.array(truth), priors
