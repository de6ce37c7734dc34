"""Radar cross section of small metal bodies from their solved surface currents, and whether it is worth its time."""

import math
from dataclasses import dataclass

import numpy as np

from sarmitsuba.core.arrays import C128, F64, all_finite
from sarmitsuba.core.errors import RadarError, ResourceError
from sarmitsuba.core.progress import Progress
from sarmitsuba.core.units import db_from_power
from sarmitsuba.core.witness import Witness
from sarmitsuba.effects.flags import KernelFlags
from sarmitsuba.effects.omitted_waves import polarisation_vectors
from sarmitsuba.machine.memory import check_fits
from sarmitsuba.radar.polarisation import linear_parts
from sarmitsuba.scene.mesh.double_faces import double_faces
from sarmitsuba.scene.mesh.mirrors import count_pieces
from sarmitsuba.scene.mesh.remesh import contacts
from sarmitsuba.scene.scene import Scene
from sarmitsuba.scene.visible_faces import VisibleFaces
from sarmitsuba.tracing.scatterers.currents.solution import (
    JOINED,
    MIRROR_STEP,
    BodyMesh,
    WholeSurface,
    scattering_matrices,
)

# wanted lengths of edges, wavelengths: the finest; the coarsest by itself, and where the solution is asked for
FINEST, COARSEST, ASKED = 1.0 / 16.0, 1.0 / 7.0, 1.0 / 5.5
# functions on a surface of one square length of edges, and least number of them on a body
FUNCTIONS, LEAST = 4.6, 600
# wavelengths: extent of a body below which single precision does not solve its charges
SMALLEST = 0.03
# processor seconds of a pair of functions and of an unknown cubed on one core, and how many a sweep may take by itself
PAIR_SECONDS, CUBE_SECONDS, MOST_SECONDS = 2.7e-8, 2.3e-11, 8.0
# error of ray optics from which on currents are solved, dB
WORTH_DB = 0.5
# edges of the mesh to compare with over those of the solution
COARSER = 1.4
# least ratio of both
APART = 1.15
# copies by three mirror planes
MOST_COPIES = 8
# bytes of a triangle, and of a point for mirrors, while a surface is meshed, and such points of one square of an edge
MESH_BYTES, SAMPLES = 3000, 16.0
# bytes of a piece of surface while mirrors are looked for, and how many are looked through without being asked
PIECE_BYTES, MOST_PIECES = 400, 1.5e6
# distance, over the length of edges, of parts that touch
TOUCHING = 0.1
# lengths of edges that are tried where parts touch, over the wanted one
AGAIN = (1.0, 0.85)
# surface, square wavelengths, beyond which nothing is meshed without being asked
LARGEST_AREA = 250.0


@dataclass(frozen=True, eq=False)
class SolvedCurrents:
    """Scattering amplitudes from solved currents.

    Parameters
    ----------
    amplitude : (n_directions, n_channels) complex128, m, phase about the reference point
    error : (n_channels,) float64, m^2, energy of the error by the mesh, in a direction
    unknowns : of the linear equations
    length : rms length of the mesh's edges, wavelengths
    witness : of the error by the mesh, the artificial losses and the residual of the equations, over the directions
    """

    amplitude: C128
    error: F64
    unknowns: int
    length: float
    witness: Witness

    @property
    def error_db(self) -> tuple[float, ...]:
        """Energy of the error relative to the echoes, dB, of every channel."""
        with np.errstate(divide="ignore", invalid="ignore"):
            level = db_from_power(self.error / np.square(np.abs(self.amplitude)).mean(axis=0))
        return tuple(float(v) for v in level)

    @property
    def text(self) -> str:
        """Description of the solution."""
        return (
            f"currents solved by the method of moments, {self.unknowns} unknowns, edges of "
            f"{self.length:.2g} wavelengths"
        )


@dataclass(frozen=True, eq=False)
class FullWaveTarget:
    """Metal body whose currents may be solved.

    Parameters
    ----------
    corners : (n, 3, 3) float64, m, visible triangles, each once
    wavelength : m
    reference : (3,) float64, m, of the phase
    refusal : reason why its currents cannot be solved; empty where they can
    """

    corners: F64
    wavelength: float
    reference: F64
    refusal: str = ""

    @staticmethod
    def of(scene: Scene, flags: KernelFlags, reference: F64) -> "FullWaveTarget":
        """Target of a scene with the effects that are simulated."""
        faces = VisibleFaces.of(scene.geometry, scene.materials)
        wavelength = scene.radar.waveform.wavelength
        why = ""
        if not len(faces.corners):
            why = "no surface"
        elif not faces.metal.all():
            other = scene.geometry.face_material[faces.face[~faces.metal][0]]
            why = f"{scene.materials[other].name} is not a perfect conductor"
        elif flags.roughness or flags.diffuse:
            why = "surfaces are rough"
        elif scene.scatterers:
            why = "wires, volumes and scatterers of extensions are no part of the equations"
        elif np.ptp(faces.corners.reshape(-1, 3), axis=0).max() < SMALLEST * wavelength:
            why = f"the body is smaller than {SMALLEST:g} wavelengths"
        corners = faces.corners
        if not why and len(corners):
            corners = corners[~double_faces(corners, faces.shape)]
        return FullWaveTarget(corners, wavelength, reference, why)

    @property
    def area(self) -> float:
        """Surface, square wavelengths."""
        t = self.corners
        twice = np.linalg.norm(np.cross(t[:, 1] - t[:, 0], t[:, 2] - t[:, 0]), axis=1)
        return float(0.5 * twice.sum()) / self.wavelength**2

    def refused(self, switch: str) -> str:
        """Reason why the currents are not solved, whatever they are worth; empty where they may be.

        Parameters
        ----------
        switch : of the effect ``full_wave``

        Raises
        ------
        RadarError
            The solution is asked for, and impossible.
        """
        if switch == "off":
            return "full_wave is off"
        if self.refusal and switch == "on":
            raise RadarError(f"rcs: full_wave = on, but {self.refusal}; leave it out")
        if not self.refusal and switch != "on" and self.area > LARGEST_AREA:
            return f"a surface of {self.area:.3g} square wavelengths is too large"
        return self.refusal


def processor_seconds(unknowns: int, copies: int) -> float:
    """Processor seconds of a solution, about: pairs of functions, and equations of each symmetry."""
    return PAIR_SECONDS * float(unknowns) ** 2 / copies + CUBE_SECONDS * copies * (unknowns / copies) ** 3


def edge_length(area: float, copies: int) -> float:
    """Finest length of edges, wavelengths, for which a surface (square wavelengths) takes ``MOST_SECONDS``."""

    def fits(length: float) -> bool:
        return processor_seconds(int(FUNCTIONS * area / length**2), copies) <= MOST_SECONDS

    if fits(FINEST):
        return FINEST
    low, high = FINEST, 10.0
    while high / low > 1.001:
        middle = math.sqrt(low * high)
        low, high = (low, middle) if fits(middle) else (middle, high)
    return high


def solve_currents(
    target: FullWaveTarget,
    directions: F64,
    up: F64,
    channels: tuple[str, ...],
    asked: bool,
    progress: Progress,
) -> SolvedCurrents | str:
    """Amplitudes from solved currents, or the reason why they are not solved by themselves.

    Parameters
    ----------
    target : that can be solved
    directions : (n, 3) float64, unit vectors to the radar
    up : (n, 3) float64, vertical reference of the polarisation in each
    channels : such as HH
    asked : whether the solution is asked for, whatever it takes
    progress : called while equations are solved

    Raises
    ------
    RadarError
        It is asked for, and parts of the surface touch without sharing edges, are too narrow, or have no solution.
    ResourceError
        The equations do not fit into memory.
    """
    wave = target.wavelength
    # as if it had all mirrors, before they are looked for
    if not asked and edge_length(target.area, MOST_COPIES) > COARSEST:
        return _too_long(target.area, MOST_COPIES)
    samples = int(SAMPLES * target.area / COARSEST**2)
    pieces = count_pieces(target.corners, MIRROR_STEP * COARSEST * wave)
    if pieces > MOST_PIECES and not asked:
        return f"its mirrors would be looked for in {pieces:.2g} pieces of surface; full_wave = on does"
    try:
        check_fits(
            "rcs: meshing the surface for its currents",
            int(MESH_BYTES * (len(target.corners) + samples) + PIECE_BYTES * pieces),
            "switch full_wave off",
        )
    except ResourceError as full:
        if asked:
            raise
        return str(full)
    whole = WholeSurface.of(target.corners, COARSEST * wave)
    if not len(whole.faces):
        return _give_reason(f"the surface is narrower than {JOINED * COARSEST:.1g} wavelengths", asked)
    copies = 2 ** len(whole.normals)
    wanted = edge_length(target.area, copies)
    if wanted > COARSEST and not asked:
        return _too_long(target.area, copies)
    length = min(wanted, ASKED, math.sqrt(FUNCTIONS * target.area / LEAST))
    check_fits(
        "rcs with full_wave = on",
        int(10.0 * (FUNCTIONS * target.area / length**2 / copies) ** 2),
        f"about {FUNCTIONS * target.area / length**2:.2g} unknowns in {copies} symmetric parts are too many; switch "
        "full_wave off",
    )
    for factor in AGAIN:  # chords of a narrow tip may cross each other in one mesh, and not in the next
        fine = whole.make_mesh(factor * length * wave)
        at = contacts(fine.vertices, fine.faces, TOUCHING * fine.length)
        if not len(at):
            break
    else:
        place = ", ".join(f"{v:.3g}" for v in at[0] + fine.center)
        return _give_reason(
            f"parts of the surface touch or cross without common edges, at ({place}) m", asked
        )
    fields = np.stack(polarisation_vectors(directions, up), axis=1)
    meshes = sorted((fine, _coarser(whole, fine)), key=lambda mesh: -mesh.rms_edge)
    rough, fine = meshes
    found = []
    for mesh in meshes:

        def solved(done: int, total: int, mesh: BodyMesh = mesh) -> None:
            progress("currents" if mesh is fine else "currents, coarser", done, total, {})

        found.append(scattering_matrices(mesh, wave, directions, fields, solved))
    turn = np.exp(-4j * np.pi / wave * (directions @ target.reference))[:, None]
    fine_one = found[1]
    rough_part, amplitude = (turn * _pick_channels(s.matrices, channels) for s in found)
    if not (all_finite(rough_part) and all_finite(amplitude)):
        return _give_reason("its equations have no single solution", asked)
    # currents at edges make the error fall as the length
    share = 1.0 / max(rough.rms_edge / fine.rms_edge - 1.0, 1e-3)
    by_mesh = np.square(share) * np.square(np.abs(amplitude - rough_part))
    rest = np.square(np.abs(_pick_channels(fine_one.losses, channels)))
    rest += np.square(np.abs(_pick_channels(fine_one.residual.astype(np.complex128), channels)))
    witness = Witness.from_weighted(
        (by_mesh + rest).sum(axis=1),
        np.square(np.abs(amplitude)).sum(axis=1),
        seed=0,
        reference=f"edges {rough.rms_edge / fine.rms_edge:.2g} times as long, extrapolated; artificial losses taken "
        "out; residual of drawn equations",
    )
    left = (by_mesh + rest).mean(axis=0)
    return SolvedCurrents(amplitude, left, fine.unknowns * copies, fine.rms_edge / wave, witness)


def _too_long(area: float, copies: int) -> str:
    """The reason why a surface, square wavelengths, in symmetric copies is not solved by itself."""
    seconds = processor_seconds(int(FUNCTIONS * area / COARSEST**2), copies)
    return f"its currents would take about {seconds:.2g} processor seconds; full_wave = on solves them"


def _give_reason(why: str, asked: bool) -> str:
    """The reason why currents are not solved; an error where they are asked for."""
    if asked:
        raise RadarError(f"rcs: full_wave = on, but {why}; leave it out, or mend the mesh")
    return why


def _coarser(whole: WholeSurface, fine: BodyMesh) -> BodyMesh:
    """Mesh with longer edges to compare with; where details of the body set their length, with shorter ones."""
    for factor in (COARSER, COARSER**2, COARSER**3, 1.0 / COARSER, 1.0 / COARSER**2):
        mesh = whole.make_mesh(factor * fine.length)
        if not 1.0 / APART < mesh.rms_edge / fine.rms_edge < APART:
            return mesh
    return mesh


def _pick_channels(matrices: C128, channels: tuple[str, ...]) -> C128:
    """Amplitudes (n, n_channels) from [direction, received, sent], H first."""
    return np.stack([_channel(matrices, c) for c in channels], axis=1)


def _channel(matrices: C128, channel: str) -> C128:
    """Amplitude (n,) of a channel from [direction, received, sent], H first."""
    total = np.zeros(len(matrices), dtype=np.complex128)
    for factor, part in linear_parts(channel):
        total += factor * matrices[:, "HV".index(part[1]), "HV".index(part[0])]
    return total
