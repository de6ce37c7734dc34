"""Wires, rails and posts against the series of the circular cylinder, a mesh, the handbook and image theory."""

import numpy as np

from sarmitsuba.core.arrays import C128, F64
from sarmitsuba.core.units import db_from_power
from sarmitsuba.loading.build import SceneMesh, build_scene
from sarmitsuba.radar.description import RadarDescription
from sarmitsuba.scene.scene import Scene
from sarmitsuba.simulation.execution.rcs import monostatic_rcs
from sarmitsuba.simulation.execution.turntable import Aspects, rcs_sweep
from sarmitsuba.tracing.scatterers.wires.kind import WireTarget
from sarmitsuba.truth import theory
from sarmitsuba.truth.validation import targets
from sarmitsuba.truth.validation.band_sampling import X_BAND, X_WAVELENGTH
from sarmitsuba.truth.validation.cases import CASES, CaseEntry
from sarmitsuba.truth.validation.comparison import Case, Comparison

CHANNELS = ("HH", "HV", "VV")
# k a and relative permittivity of drawn wires: from hair-thin wires to lamp posts
RODS: tuple[tuple[str, float, complex | None], ...] = (
    ("wire, ka 0.0001", 1e-4, None),
    ("cable, ka 0.3", 0.3, None),
    ("post, ka 20", 20.0, None),
    ("mast, ka 100", 100.0, None),
    ("wooden post, ka 20", 20.0, 2.0 - 0.1j),
)
FLOAT = "float32 directions, tables of the series interpolated"


def _scene(*lines: WireTarget) -> Scene:
    return build_scene(wires=lines, radar=RadarDescription(center_frequency=X_BAND))


def _aspects(directions: F64) -> Aspects:
    return Aspects(np.arctan2(directions[:, 1], directions[:, 0]), np.arcsin(directions[:, 2]))


def _evaluate_closed_form(line: WireTarget, directions: F64) -> C128:
    """(n, 3) amplitudes in ``CHANNELS``, m, phase about the middle."""
    rows = []
    for s in directions:
        dyad = theory.line_amplitude(
            line.radius, line.ends - line.ends.mean(axis=0), X_WAVELENGTH, -s, s, line.permittivity
        )
        h = np.cross(-s, [0.0, 0.0, 1.0])
        h /= np.linalg.norm(h)
        basis = {"H": h, "V": np.cross(h, -s)}
        rows.append([basis[c[1]] @ dyad @ basis[c[0]] for c in CHANNELS])
    return np.array(rows)


def drawn_rod(rng: np.random.Generator, ka: float, permittivity: complex | None) -> WireTarget:
    """A rod of drawn length, heading, tilt and place."""
    axis = rng.normal(size=3)
    axis /= np.linalg.norm(axis)
    radius = ka * X_WAVELENGTH / (2.0 * np.pi)
    length = max(rng.uniform(20.0, 60.0) * X_WAVELENGTH, 8.0 * radius)
    middle = rng.uniform(-3.0, 3.0, 3)
    half = 0.5 * length * axis
    return WireTarget("rod", middle - half, middle + half, radius, permittivity)


def draw_beside_broadside(rng: np.random.Generator, line: WireTarget, lobes: F64) -> F64:
    """Random directions to the radar (n, 3), off broadside by multiples ``lobes`` of the main lobe's half width."""
    axis = (line.end - line.start) / line.length
    out = []
    for sine in lobes * X_WAVELENGTH / (2.0 * line.length):
        across = np.cross(axis, rng.normal(size=3))
        across /= np.linalg.norm(across)
        out.append(np.sqrt(1.0 - sine**2) * across + sine * axis)
    return np.array(out)


def rods(quick: bool = False) -> Case:
    """Drawn rods near broadside in all channels."""
    comparisons = []
    lobes = np.linspace(-0.9, 0.9, 7 if quick else 31)
    for number, (label, ka, permittivity) in enumerate(RODS):
        rng = np.random.default_rng([17, 4, number])
        line = drawn_rod(rng, ka, permittivity)
        directions = draw_beside_broadside(rng, line, lobes)
        result = rcs_sweep(_scene(line), _aspects(directions), channels=CHANNELS, checked=0)
        closed = _evaluate_closed_form(line, directions)
        for i, channel in enumerate(CHANNELS):
            comparisons.append(
                Comparison(
                    f"{label}, {channel}",
                    lobes,
                    db_from_power(np.abs(closed[:, i]) ** 2),
                    result.dbsm(channel),
                    tolerance=0.1,
                    reason=FLOAT,
                    floor=20.0,
                )
            )
    return Case(
        name="rods",
        topic="canonical",
        title="Wires, rails and posts of drawn headings near broadside",
        formula="(2 / sqrt(pi)) L sinc(k L sin p) sum of J_n / H_n and J_n' / H_n', both polarisations at any tilt",
        source="Wait, Can. J. Phys. 33 (1955); Ruck et al., Radar Cross Section Handbook (1970), chapter 4",
        x_label="off broadside, half widths of the main lobe",
        y_label="RCS (dBsm)",
        comparisons=tuple(comparisons),
        note="X band; lengths of 20 to 60 wavelengths; every direction another azimuth about the rod.",
    )


def rod_handbook(quick: bool = False) -> Case:
    """Broadside over the thickness against the handbook's formulas for thin wires and for thick cylinders."""
    length = 50.0 * X_WAVELENGTH
    thin, thick = (np.geomspace(*ends, 4 if quick else 17) for ends in ((1e-4, 1e-2), (50.0, 100.0)))
    simulated = {}
    for name, sizes in (("thin", thin), ("thick", thick)):
        values = []
        for ka in sizes:
            radius = ka * X_WAVELENGTH / (2.0 * np.pi)
            line = WireTarget(
                "rod", np.array([0.0, 0.0, -0.5 * length]), np.array([0.0, 0.0, 0.5 * length]), radius
            )
            result = rcs_sweep(
                _scene(line), Aspects(np.zeros(1), np.zeros(1)), channels=("HH", "VV"), checked=0
            )
            values.append([result.dbsm(c)[0] for c in ("HH", "VV")])
        simulated[name] = np.array(values)
    radius = thin * X_WAVELENGTH / (2.0 * np.pi)
    wire = np.array([theory.thin_wire_rcs(length, a, X_WAVELENGTH) for a in radius])
    optics = theory.cylinder_rcs(1.0, length, X_WAVELENGTH) * thick * X_WAVELENGTH / (2.0 * np.pi)
    comparisons = [
        Comparison(
            "thin wire, VV along it",
            np.log10(thin),
            db_from_power(wire),
            simulated["thin"][:, 1],
            tolerance=0.1,
            reason="orders of (ka)^2 that the handbook leaves out",
        ),
        *(
            Comparison(
                f"thick cylinder, {channel}",
                np.log10(thick),
                db_from_power(optics),
                simulated["thick"][:, i],
                tolerance=0.1,
                reason="creeping waves, which optics leaves out",
            )
            for i, channel in enumerate(("HH", "VV"))
        ),
    ]
    return Case(
        name="rod_handbook",
        topic="canonical",
        title="Rods at broadside: thin wire and thick cylinder",
        formula="pi L^2 / ((pi / 2)^2 + ln^2(lambda / (1.781 pi a))); 2 pi a L^2 / lambda",
        source="Chu, in Ruck et al. (1970), section 4.3; Knott, Shaeffer and Tuley, Radar Cross Section (2004), ch. 6",
        x_label="log10 of k a",
        y_label="RCS (dBsm)",
        comparisons=tuple(comparisons),
        note="X band, 50 wavelengths long.",
    )


def rod_and_mesh(quick: bool = False) -> Case:
    """The same cylinder as a rod and as a mesh that rays hit."""
    radius, length = 20.0 * X_WAVELENGTH / (2.0 * np.pi), 0.6
    # where the mesh's own theory holds: main lobe and two sidelobes
    psi = np.linspace(0.0, 0.06, 7 if quick else 41)
    directions = np.stack([np.cos(psi), np.zeros_like(psi), np.sin(psi)], axis=1)
    mesh = monostatic_rcs(
        targets.cylinder(radius, length, X_WAVELENGTH / 512.0),
        (targets.PEC[0], targets.BLACK),
        directions,
        X_BAND,
        max_depth=1,
    )
    line = WireTarget("rod", np.array([0.0, 0.0, -0.5 * length]), np.array([0.0, 0.0, 0.5 * length]), radius)
    rod = rcs_sweep(_scene(line), _aspects(directions), channels=("HH", "VV"), checked=0)
    return Case(
        name="rod_and_mesh",
        topic="canonical",
        title="A cylinder as a rod and as a mesh",
        formula="series of the infinite cylinder times sinc against rays with physical optics",
        source="two independent ways through the program",
        x_label="off broadside (deg)",
        y_label="RCS (dBsm)",
        comparisons=tuple(
            Comparison(
                channel,
                np.degrees(psi),
                rod.dbsm(channel),
                mesh.rcs_dbsm(channel),
                tolerance=0.3,
                reason="physical optics of the mesh: false return of its shadow boundary, facets of lambda / 512",
                floor=20.0,
            )
            for channel in ("HH", "VV")
        ),
        note=f"X band, k a = 20, {length:g} m long, caps black.",
    )


def post(quick: bool = False) -> Case:
    """Upright posts on flat ground: the dihedral of a lamp post, straight and mirrored returns together."""
    comparisons = []
    half = 40.0
    corners = np.array([[-half, -half, 0.0], [half, -half, 0.0], [half, half, 0.0], [-half, half, 0.0]])
    for number, (label, eps) in enumerate((("metal", None), ("concrete", targets.PERMITTIVITY["concrete"]))):
        rng = np.random.default_rng([17, 5, number])
        radius, height = rng.uniform(0.03, 0.08), rng.uniform(3.0, 6.0)
        theta = np.linspace(25.0, 65.0, 7 if quick else 41)
        aspects = Aspects(np.full(theta.size, rng.uniform(-np.pi, np.pi)), np.radians(90.0 - theta))
        line = WireTarget("post", np.zeros(3), np.array([0.0, 0.0, height]), radius)
        ground = {"permittivity_real": eps.real, "permittivity_imag": -eps.imag} if eps else "pec"
        scene = build_scene(
            [SceneMesh(corners, [[0, 1, 2], [0, 2, 3]], ground, "ground")],
            wires=[line],
            radar=RadarDescription(center_frequency=X_BAND),
        )
        # what the edges of the ground return is not the post's
        whole, without = (
            rcs_sweep(s, aspects, channels=("HH", "VV"), checked=0, most_rays=2000).result.amplitude.sum(
                axis=1
            )
            for s in (scene, scene.without_kind("radar_wire"))
        )
        closed = np.array(
            [theory.post_amplitude(radius, height, X_WAVELENGTH, t, eps) for t in np.radians(theta)]
        )
        for i, channel in enumerate(("HH", "VV")):
            comparisons.append(
                Comparison(
                    f"{label}, {channel}",
                    theta,
                    db_from_power(np.abs(closed[:, i]) ** 2),
                    db_from_power(np.abs(whole - without)[:, i] ** 2),
                    tolerance=0.1,
                    reason=f"{FLOAT}; the ground's own return subtracted",
                    floor=20.0,
                )
            )
    return Case(
        name="post",
        topic="canonical",
        title="Upright post on flat ground",
        formula="D(d, -d) + 2 R D(d', -d) + R^2 D(d', -d'), HH by TE, VV by TM",
        source="image theory with the series of the cylinder and Fresnel coefficients",
        x_label="incidence angle on the ground (deg)",
        y_label="RCS (dBsm)",
        comparisons=tuple(comparisons),
        note="X band; metal posts of drawn radius and height on metal and on concrete.",
    )


def rod_full_wave(quick: bool = False) -> Case:
    """Thin wires against the method of moments, which includes their ends."""
    radius = 1e-3 * X_WAVELENGTH

    def along_z(length: float) -> WireTarget:
        half = np.array([0.0, 0.0, 0.5 * length])
        return WireTarget("wire", -half, half, radius)

    def simulated(length: float, psi: F64) -> F64:
        aspects = Aspects(np.zeros(psi.size), psi)
        return rcs_sweep(_scene(along_z(length)), aspects, channels=("VV",), checked=0).dbsm("VV")

    def exact(length: float, psi: F64) -> F64:
        return db_from_power(np.abs(theory.thin_wire_moments(length, radius, X_WAVELENGTH, psi)) ** 2)

    rng = np.random.default_rng([17, 6])
    lengths = np.sort(rng.uniform(10.0, 40.0, 4 if quick else 24))
    square = np.zeros(1)
    comparisons = [
        Comparison(
            "broadside, drawn lengths (wavelengths)",
            lengths,
            np.array([exact(n * X_WAVELENGTH, square)[0] for n in lengths]),
            np.array([simulated(n * X_WAVELENGTH, square)[0] for n in lengths]),
            tolerance=0.7,
            reason="currents that the ends send back, largest at half-integer lengths, are ignored",
        )
    ]
    for n in (20.3, 40.0):
        length = n * X_WAVELENGTH
        psi = np.linspace(0.0, 2.5 / (2.0 * n), 41)
        comparisons.append(
            Comparison(
                f"lobes, {n:g} wavelengths (deg off broadside)",
                np.degrees(psi),
                exact(length, psi),
                simulated(length, psi),
                tolerance=0.5,
                reason="the same; beyond the main lobe it grows, to 8 dB and more 30 dB below the peak",
                floor=12.0,
                drawn=35.0,
            )
        )
    return Case(
        name="rod_full_wave",
        topic="full_wave",
        title="Thin wires against the method of moments",
        formula="reduced-kernel integral equation, piecewise sinusoids, 40 per wavelength",
        source="Richmond, Proc. IEEE 53 (1965)",
        x_label="length (wavelengths) or angle off broadside (deg)",
        y_label="RCS (dBsm)",
        comparisons=tuple(comparisons),
        note="X band, radius of a thousandth of the wavelength, field along the wire.",
    )


CASES.register(CaseEntry("rods", "canonical", rods))
CASES.register(CaseEntry("rod_handbook", "canonical", rod_handbook))
CASES.register(CaseEntry("rod_and_mesh", "canonical", rod_and_mesh))
CASES.register(CaseEntry("post", "canonical", post))
CASES.register(CaseEntry("rod_full_wave", "full_wave", rod_full_wave))
