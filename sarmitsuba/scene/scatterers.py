"""Scatterers beside the meshes of a scene: the statements of every kind, and the scatterers of extensions' kinds."""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import ClassVar, Protocol

import numpy as np

from sarmitsuba.core.arrays import F64, I32
from sarmitsuba.core.errors import SceneError
from sarmitsuba.core.parameters import Param, ParamTable, did_you_mean
from sarmitsuba.core.registry import Registry


class Target(Protocol):
    """A scatterer beside the meshes of a scene. It rests, and no ray hits it."""

    @property
    def name(self) -> str:
        """Name of the shape."""

    @property
    def kind(self) -> str:
        """Name in ``SCATTERERS``."""

    @property
    def places(self) -> F64:
        """Points whose hull holds it, (n, 3) float64, m, scene frame."""

    @property
    def segments(self) -> F64:
        """Pieces of line that it consists of, (n, 2, 3) float64, m, scene frame.

        Both ends of a point are the same. A body, which ``places`` outline, has none.
        """

    def moved(self, step: F64) -> "Target":
        """The same, (3,) m farther on."""


class Medium(Protocol):
    """Filling of a body, as far as it changes between passes; see :mod:`sarmitsuba.scene.materials.change`."""

    @property
    def name(self) -> str:
        """Name for notes."""

    @property
    def temporal_coherence(self) -> float:
        """Coherence that never decays."""

    def coherence_after(self, days: float) -> float:
        """Coherence after a time, days."""


class ScattererKind:
    """A kind of scatterers beside the meshes; register an instance in ``SCATTERERS``.

    A :class:`sarmitsuba.loading.scatterer_shapes.ShapeKind` reads its shapes itself, into targets of its own class.
    All others derive from :class:`sarmitsuba.tracing.scatterers.reflectors.reflector.Reflector`, which has the
    scattering; their targets are of the class :class:`ScattererTarget`.

    Attributes
    ----------
    name : of the bsdf in scene files; of extensions' kinds on a `sphere` whose centre and axes are the scatterer's
    title : half a sentence
    parameters : of the bsdf, numbers
    hints : remedies for names of parameters that do not apply
    on : shapes that take the bsdf
    plural : under which its targets are counted
    mechanism : of its echoes, of :data:`sarmitsuba.tracing.kernel.path_groups.MECHANISMS`; also the material of its
        targets in labels
    rank : order of kinds in a scene
    random : its amplitudes are random numbers of the scene's seed
    needs_surface : it grows on a surface of the scene
    shown_as : name of its material where a page draws it
    frequencies : at which the band is traced for it at least; 1 for an amplitude without frequency dependence over the
        band, 2 for up to the square of the frequency (where that exceeds the tolerance), more for delays
    """

    name: ClassVar[str]
    title: ClassVar[str] = ""
    parameters: ClassVar[tuple[Param, ...]] = ()
    hints: ClassVar[Mapping[str, str]] = {}
    on: ClassVar[str] = "a sphere"
    plural: ClassVar[str] = "scatterers"
    mechanism: ClassVar[str] = "scatterer"
    rank: ClassVar[int] = 100
    random: ClassVar[bool] = False
    needs_surface: ClassVar[bool] = False
    shown_as: ClassVar[str] = ""
    frequencies: ClassVar[int] = 2

    @property
    def states_frequencies(self) -> bool:
        """Whether a class or instance itself sets ``frequencies``."""
        return any(
            "frequencies" in vars(part) for part in (self, *type(self).__mro__) if part is not ScattererKind
        )

    @property
    def table(self) -> ParamTable:
        """Parameters of the bsdf."""
        return ParamTable(self.name, "bsdf", self.title, self.parameters, hints=self.hints)

    def media(self, targets: Sequence[Target]) -> Sequence[Medium]:
        """Media that may change between passes; none by default."""
        return ()

    def drawn(self, targets: Sequence[Target], thinnest: float) -> tuple[F64, I32] | None:
        """Vertices (n, 3), m, and faces (n, 3) that a page draws of targets; None: nothing, the default.

        Parameters
        ----------
        targets : of the kind
        thinnest : m, radius below which a line is not drawn any thinner
        """
        return None


SCATTERERS: Registry[ScattererKind] = Registry(
    "kind of scatterer", ScattererKind, "sarmitsuba.tracing.scatterers.*.kind"
)


def is_own(target: Target) -> bool:
    """Whether a target is of an extension's kind."""
    return target.kind not in SCATTERERS.own_names


def kinds_in_order() -> tuple[ScattererKind, ...]:
    """All kinds by their rank."""
    return tuple(sorted(SCATTERERS, key=lambda kind: kind.rank))


def targets_by_kind(targets: Iterable[Target]) -> dict[ScattererKind, list[Target]]:
    """Targets of every kind that occurs, in the order of the kinds."""
    found: dict[ScattererKind, list[Target]] = {}
    for target in sorted(targets, key=lambda target: SCATTERERS[target.kind].rank):
        found.setdefault(SCATTERERS[target.kind], []).append(target)
    return found


def joined_rows(rows: Iterable[F64], empty: tuple[int, ...]) -> F64:
    """Rows of several arrays in one; without any an array of the shape ``empty``."""
    return np.concatenate([np.zeros(empty), *rows])


@dataclass(frozen=True, eq=False)
class ScattererTarget:
    """One scatterer of an extension's kind; no ray hits it, and it casts no shadow.

    Parameters
    ----------
    name : of the shape
    kind : name in ``SCATTERERS``
    position : (3,) float64, m, scene frame
    axes : (3, 3) float64, its own unit axes x, y, z as columns, scene frame
    values : of the kind's parameters

    Raises
    ------
    SceneError
        There is no such kind, or position or axes are not finite and right-angled.
    """

    name: str
    kind: str
    position: F64
    axes: F64
    values: Mapping[str, float]

    def __post_init__(self) -> None:
        if self.kind not in SCATTERERS:
            own = [name for name in SCATTERERS.names if name not in SCATTERERS.own_names]
            known, guess = ", ".join(own) or "none", did_you_mean(self.kind, own)
            raise SceneError(
                f'scatterer "{self.name}": there is no kind {self.kind!r}{guess}; registered: {known}'
            )
        square = np.allclose(self.axes.T @ self.axes, np.eye(3), atol=1e-6) and np.linalg.det(self.axes) > 0.0
        if not (np.isfinite(self.position).all() and square):
            raise SceneError(
                f'{self.kind} "{self.name}": to_world is not a turn and a shift; give it rotate and translate alone'
            )

    @property
    def places(self) -> F64:
        """See :class:`Target`."""
        return self.position[None]

    @property
    def segments(self) -> F64:
        """See :class:`Target`."""
        return np.stack([self.position, self.position])[None]

    def moved(self, step: F64) -> "ScattererTarget":
        """The same, (3,) m farther on."""
        return replace(self, position=self.position + step)
