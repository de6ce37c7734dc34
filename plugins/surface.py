"""Base of the radar BSDFs: holds the parameters, and looks like matte grey paint to light."""

from functools import cached_property
from typing import ClassVar

from sarmitsuba.core.parameters import ParamTable
from sarmitsuba.loading.plugins import describe, given_values
from sarmitsuba.machine.backend import mi

# a direction with its weight; a value with its density
Sampled = tuple[mi.BSDFSample3f, mi.Color3f]
Evaluated = tuple[mi.Color3f, mi.Float]


class RadarSurface(mi.BSDF):
    """A material whose radar meaning is in ``given``; for light it is a two-sided diffuse grey.

    Light only serves to look at a radar scene with Mitsuba's own sensors and integrators.
    """

    table: ClassVar[ParamTable]

    def __init__(self, props: mi.Properties) -> None:
        self.given = given_values(props, self.table)
        self.nested = [props[key] for key in props.keys() if isinstance(props[key], mi.BSDF)]
        self.maps = [key for key in props.keys() if isinstance(props[key], mi.Texture)]
        super().__init__(props)
        flags = mi.BSDFFlags.DiffuseReflection | mi.BSDFFlags.FrontSide | mi.BSDFFlags.BackSide
        self.m_components = [flags]
        self.m_flags = flags

    @cached_property
    def paint(self) -> mi.BSDF:
        """Made on first use: a plugin loaded in another's constructor nests Mitsuba's worker threads."""
        return mi.load_dict({"type": "twosided", "paint": {"type": "diffuse"}})

    def sample(
        self,
        ctx: mi.BSDFContext,
        si: mi.SurfaceInteraction3f,
        sample1: mi.Float,
        sample2: mi.Point2f,
        active: mi.Bool = True,
    ) -> Sampled:
        """Sample the paint."""
        sampled: Sampled = self.paint.sample(ctx, si, sample1, sample2, active)
        return sampled

    def eval(
        self, ctx: mi.BSDFContext, si: mi.SurfaceInteraction3f, wo: mi.Vector3f, active: mi.Bool = True
    ) -> mi.Color3f:
        """Evaluate the paint."""
        return self.paint.eval(ctx, si, wo, active)

    def pdf(
        self, ctx: mi.BSDFContext, si: mi.SurfaceInteraction3f, wo: mi.Vector3f, active: mi.Bool = True
    ) -> mi.Float:
        """Density of the paint's samples."""
        return self.paint.pdf(ctx, si, wo, active)

    def eval_pdf(
        self, ctx: mi.BSDFContext, si: mi.SurfaceInteraction3f, wo: mi.Vector3f, active: mi.Bool = True
    ) -> Evaluated:
        """Both at once."""
        evaluated: Evaluated = self.paint.eval_pdf(ctx, si, wo, active)
        return evaluated

    def to_string(self) -> str:
        """Return the parameters as text."""
        return describe(self.table, self.given)
