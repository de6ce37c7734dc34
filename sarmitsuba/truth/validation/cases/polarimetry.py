"""Canonical targets and rough ground through the whole chain: entropy, alpha, orientation, compact decomposition."""

from dataclasses import dataclass

import numpy as np

from sarmitsuba.analysis.polarimetry import (
    cloude_pottier,
    coherency,
    m_chi,
    orientation_angle,
    quad_pol,
    span,
    stokes,
)
from sarmitsuba.core.arrays import F64, unit_rows
from sarmitsuba.core.units import amplitude_from_db, db_from_power, power_from_db
from sarmitsuba.scene.geometry import Geometry, PointTarget
from sarmitsuba.scene.materials.material import Material
from sarmitsuba.scene.settings import TraceSettings
from sarmitsuba.signal.image import SarImage
from sarmitsuba.truth import theory
from sarmitsuba.truth.validation import targets
from sarmitsuba.truth.validation.cases import CASES, CaseEntry
from sarmitsuba.truth.validation.chain import Parameter, bandwidth, chain, make_scene
from sarmitsuba.truth.validation.comparison import Case, Comparison

CELL = 1.0
# pixels about a target, m, and the edge of the plate, the dihedral and the trihedral, 32 wavelengths
EXTENT, EDGE = 16.0, 1.0
ALL = "HH,HV,VH,VV,RH,RV"
# the law of the rough ground: k s = 0.2, k l = 1.6 at X band
ROUGH = (1e-3, 8e-3)
DRAWS, SIGMAS = 40, 4.0


@dataclass(frozen=True, eq=False)
class RadarView:
    """A drawn radar and its line of sight at mid-aperture; ``across`` is h, ``up`` is v, ``back`` towards the radar."""

    parameters: dict[str, Parameter]
    across: F64
    up: F64
    back: F64

    @classmethod
    def drawn(cls, rng: np.random.Generator) -> "RadarView":
        """Heading, side and look angle at random."""
        parameters: dict[str, Parameter] = {
            "slant_range": 2000.0,
            "look_angle_deg": float(rng.uniform(30.0, 55.0)),
            "heading_deg": float(rng.uniform(0.0, 360.0)),
            "look_side": str(rng.choice(["left", "right"])),
            "azimuth_resolution": CELL,
            "bandwidth": bandwidth(CELL),
            "center_frequency": 9.65e9,
            "image_extent_azimuth": EXTENT,
            "image_extent_range": EXTENT,
            "polarisation": ALL,
        }
        point = PointTarget("aim", np.zeros(3), 1.0)
        back = make_scene(None, (), parameters, points=(point,)).radar.track.center_position
        back = back / np.linalg.norm(back)
        across = np.cross(-back, [0.0, 0.0, 1.0])
        across /= np.linalg.norm(across)
        return cls(
            {**parameters, "aim_x": 0.0, "aim_y": 0.0, "aim_z": 0.0}, across, np.cross(across, -back), back
        )

    def shape(self, name: str, roll: float) -> Geometry:
        """A target that faces the radar, turned by ``roll`` (rad, h towards v) about the line of sight."""
        a = np.cos(roll) * self.across + np.sin(roll) * self.up
        b = np.cos(roll) * self.up - np.sin(roll) * self.across
        e = self.back
        if name == "sphere":
            return targets.sphere(1.0, 1e-4)
        if name == "plate":
            return targets.geometry([targets.parallelogram(-0.5 * (a + b) * EDGE, a * EDGE, b * EDGE)])
        if name == "dihedral":
            half = EDGE / np.sqrt(2.0)
            return targets.geometry(
                [
                    targets.parallelogram(-0.5 * a * EDGE, a * EDGE, half * (e + side * b))
                    for side in (1.0, -1.0)
                ]
            )
        turn = 2.0 * np.pi * np.arange(3) / 3.0
        tips = e / np.sqrt(3.0) + np.sqrt(2.0 / 3.0) * (np.cos(turn)[:, None] * a + np.sin(turn)[:, None] * b)
        return targets.geometry([targets.triangle(np.zeros(3), tips[i], tips[(i + 1) % 3]) for i in range(3)])


def polarimetric_targets(quick: bool = False) -> Case:
    """Deterministic targets from drawn headings: alpha, entropy, orientation, and decompositions of RH and RV."""
    rng = np.random.default_rng(15)
    rolls = np.sort(rng.uniform(-44.0, 44.0, 3 if quick else 9))
    cases = [("plate", 0.0), ("trihedral", 20.0), ("sphere", 0.0), *(("dihedral", r) for r in rolls)]
    rows = []
    for name, roll in cases:
        view = RadarView.drawn(rng)
        image = chain(make_scene(view.shape(name, np.radians(roll)), targets.PEC, view.parameters))
        t = coherency(quad_pol(image), image.grid.shape)
        d = cloude_pottier(t)
        powers = m_chi(stokes(image, image.grid.shape))[0, 0]
        cross = t[0, 0, 2, 2].real / span(t)[0, 0]
        rows.append(
            (
                np.degrees(d.alpha[0, 0]),
                d.entropy[0, 0],
                np.degrees(orientation_angle(t)[0, 0]),
                cross,
                powers[0] / powers.sum(),
            )
        )
    alpha, entropy, orientation, cross, even = np.array(rows).T
    number = np.arange(len(cases), dtype=np.float64)
    dihedrals = theory.polarimetry.rotate_target(theory.polarimetry.DIHEDRAL, np.radians(rolls))
    closed = theory.polarimetry.coherency_of(dihedrals)
    double = np.array([float(name == "dihedral") for name, _ in cases])
    corner = double > 0.0
    rim = "single bounces and the rim of finite faces, summed over the whole chip"
    comparisons = (
        Comparison(
            "mean alpha: plate, trihedral, sphere, dihedrals",
            number,
            90.0 * double,
            alpha,
            1.0,
            rim,
            unit="deg",
            shown=len(cases) - 1,
        ),
        Comparison(
            "entropy", number, np.zeros(number.size), entropy, 0.01, rim, unit="", shown=len(cases) - 1
        ),
        Comparison(
            "orientation of the dihedrals over roll",
            rolls,
            rolls,
            orientation[corner],
            1.0,
            rim,
            unit="deg",
            shown=0,
        ),
        Comparison(
            "cross-polar share of the dihedrals over roll, sin^2 2 psi",
            rolls,
            closed[:, 2, 2].real / np.trace(closed, axis1=1, axis2=2).real,
            cross[corner],
            0.01,
            rim,
            unit="",
            shown=0,
        ),
        Comparison(
            "share of even bounces by m-chi, from RH and RV",
            number,
            double,
            even,
            0.01,
            rim,
            unit="",
            shown=len(cases) - 1,
        ),
    )
    return Case(
        name="polarimetric_targets",
        topic="polarimetry",
        title="Canonical targets in their polarimetric classes",
        formula="alpha = 0 (odd bounces), 90 deg (even); H = 0; T33 / span = sin^2 2 psi; even share 0 or 1",
        source="Cloude and Pottier, IEEE TGRS 35 (1) 1997; Raney et al., JGR 117 (2012)",
        x_label="number of the target, or roll (deg)",
        y_label="see the legend",
        comparisons=comparisons,
        note="X band, cells and edges of 1 m; heading, side, look angle drawn for every target; T3 of the whole chip.",
    )


def rough_ground_polarimetry(quick: bool = False) -> Case:
    """Entropy and alpha of slightly rough ground against first-order theory, without and with a cross-polar part."""
    rng = np.random.default_rng(1997)
    n = 40 if quick else 64
    draws = [
        (float(a), float(e), r)
        for a, e, r in zip(
            rng.uniform(30.0, 60.0, 6),
            rng.uniform(4.0, 20.0, 6),
            (-np.inf, -15.0, -10.0, -20.0, -12.0, -7.0),
            strict=True,
        )
    ]
    rows = [_ground(rng, n, *one) for one in (draws[:3] if quick else draws)]
    values = np.array(rows)
    angles = values[:, 0]
    order = np.argsort(angles)
    reason = f"{SIGMAS:g} standard deviations over Wishart draws of the theory's matrix with {n}^2 looks"
    return Case(
        name="rough_ground_polarimetry",
        topic="polarimetry",
        title="Rough ground: entropy and alpha by first-order theory",
        formula="T of co-polar channels in phase, and a cross-polar part of azimuthal symmetry",
        source="small-perturbation ratio (Ulaby and Elachi 1990); Cloude and Pottier 1997",
        x_label="incidence angle (deg)",
        y_label="H, or alpha (deg)",
        comparisons=tuple(
            Comparison(
                label,
                angles[order],
                values[order, i],
                values[order, i + 1],
                float(values[:, i + 2].max()),
                reason,
                unit=unit,
                shown=0,
            )
            for label, i, unit in (("entropy", 1, ""), ("mean alpha", 4, "deg"))
        ),
        note="Whole chain: drawn heading, incidence, permittivity 4 to 20, cross-polar ratio none to -7 dB.",
    )


def _ground(rng: np.random.Generator, n: int, angle: float, eps: float, ratio_db: float) -> tuple[float, ...]:
    """Angle; entropy, alpha (deg): theory, simulated and tolerance."""
    permittivity = complex(eps, -0.1 * eps)
    ground = Material(
        "ground",
        permittivity=permittivity,
        rms_height=ROUGH[0],
        correlation_length=ROUGH[1],
        diffuse_law="small_perturbation",
        cross_polar_ratio_db=ratio_db,
    )
    view = RadarView.drawn(rng).parameters
    width = n * CELL / np.sin(np.radians(angle))
    parameters = {
        **view,
        "look_angle_deg": angle,
        "image_extent_azimuth": n * CELL,
        "image_extent_range": width,
    }
    shape = targets.plate(2.0 * width, 2.0 * width)  # whatever the heading
    image: SarImage = chain(make_scene(shape, (ground,), parameters, settings=TraceSettings(max_depth=1)))
    found = cloude_pottier(coherency(quad_pol(image), image.grid.shape))
    wavenumber = 2.0 * np.pi / image.wavelength
    hh, vv = (
        float(x[0])
        for x in theory.small_perturbation_sigma0([np.radians(angle)], permittivity, wavenumber, *ROUGH)
    )
    closed = theory.polarimetry.rough_surface_coherency(hh, vv, power_from_db(ratio_db))
    entropy, alpha = theory.polarimetry.entropy_alpha(closed)
    # samples of the theory's matrix with as many looks as the image has cells
    values, vectors = np.linalg.eigh(closed)
    root = vectors * np.sqrt(np.maximum(values, 0.0))
    noise = rng.standard_normal((2, DRAWS, n * n, 3))
    k = (noise[0] + 1j * noise[1]) @ root.T / np.sqrt(2.0)
    sample = cloude_pottier(np.einsum("dni,dnj->dij", k, np.conj(k)) / n**2)
    # the angle changes over the image, which adds a little
    spread = (
        SIGMAS * float(np.std(sample.entropy)) + 2e-3,
        SIGMAS * float(np.degrees(np.std(sample.alpha))) + 0.2,
    )
    return (
        angle,
        entropy,
        float(found.entropy[0, 0]),
        spread[0],
        float(np.degrees(alpha)),
        float(np.degrees(found.alpha[0, 0])),
        spread[1],
    )


def cross_polar_reciprocity(quick: bool = False) -> Case:
    """HV - VH through the image of random scenes: metal and rough, one bounce to three."""
    rng = np.random.default_rng(3)
    rough = Material(
        "rough",
        permittivity=5.3 - 0.3j,
        rms_height=2e-3,
        correlation_length=0.02,
        diffuse_law="small_slope",
        cross_polar_ratio_db=-15.0,
    )
    levels, cross = [], []
    for depth in (1, 3) if quick else (1, 2, 3, 1, 2, 3):
        view = RadarView.drawn(rng)
        normals = rng.standard_normal((3, 3))
        normals = unit_rows(normals)
        faces = [
            targets.parallelogram([0, 0, 0], a * 2.0, b * 2.0)
            for a, b in zip(normals, np.roll(normals, 1, 0), strict=True)
        ]
        # of metal alone one bounce would leave HV nothing
        shape = targets.geometry(faces, [0, 1, int(rng.integers(0, 2))])
        image = chain(
            make_scene(
                shape, (targets.PEC[0], rough), view.parameters, settings=TraceSettings(max_depth=depth)
            )
        )
        quad = quad_pol(image)
        t = coherency(quad, image.grid.shape)[0, 0]
        levels.append(amplitude_from_db(quad.asymmetry_db))
        cross.append(db_from_power(t[2, 2].real / np.trace(t).real))
    number = np.arange(len(levels), dtype=np.float64)
    return Case(
        name="cross_polar_reciprocity",
        topic="polarimetry",
        title="HV = VH through the image",
        formula="S_HV = S_VH",
        source="reciprocity",
        x_label="number of the scene",
        y_label="|HV - VH| over |HV|, |VH|, rms",
        comparisons=(
            Comparison(
                "random plates, metal and rough",
                number,
                np.zeros(number.size),
                np.array(levels),
                tolerance=1e-4,
                reason="-80 dB: float32 sums; every path is added with the reversed one",
                unit="",
                shown=int(np.argmax(levels)),
            ),
        ),
        note=f"Cross-polar power {min(cross):.0f} to {max(cross):.0f} dB of the span.",
    )


CASES.register(CaseEntry("polarimetric_targets", "polarimetry", polarimetric_targets))
CASES.register(CaseEntry("rough_ground_polarimetry", "polarimetry", rough_ground_polarimetry))
CASES.register(CaseEntry("cross_polar_reciprocity", "polarimetry", cross_polar_reciprocity))
