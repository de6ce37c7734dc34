"""Base of the radar BSDFs: holds the parameters, and looks like matte grey paint to light."""

from functools import cached_property
from typing import Any, ClassVar

import mitsuba as mi

from sarmitsuba.loader.plugins import describe, given_values
from sarmitsuba.parameters import ParamTable


class RadarSurface(mi.BSDF):
    """A material whose radar meaning is in ``given``; for light it is a two-sided diffuse grey.

    Light only serves to look at a radar scene with Mitsuba's own sensors and integrators.
    """

    table: ClassVar[ParamTable]

    def __init__(self, props: mi.Properties) -> None:
        self.given = given_values(props, self.table)
        children = [props[key] for key in props.keys() if key.startswith("_arg_")]
        self.nested = [child for child in children if isinstance(child, mi.BSDF)]
        super().__init__(props)
        flags = mi.BSDFFlags.DiffuseReflection | mi.BSDFFlags.FrontSide | mi.BSDFFlags.BackSide
        self.m_components = [flags]
        self.m_flags = flags

    @cached_property
    def paint(self) -> Any:
        """Made on first use: a plugin loaded in another's constructor nests Mitsuba's worker threads."""
        return mi.load_dict({"type": "twosided", "paint": {"type": "diffuse"}})

    def sample(self, ctx: Any, si: Any, sample1: Any, sample2: Any, active: Any = True) -> Any:
        """Sample the paint."""
        return self.paint.sample(ctx, si, sample1, sample2, active)

    def eval(self, ctx: Any, si: Any, wo: Any, active: Any = True) -> Any:
        """Evaluate the paint."""
        return self.paint.eval(ctx, si, wo, active)

    def pdf(self, ctx: Any, si: Any, wo: Any, active: Any = True) -> Any:
        """Density of the paint's samples."""
        return self.paint.pdf(ctx, si, wo, active)

    def eval_pdf(self, ctx: Any, si: Any, wo: Any, active: Any = True) -> Any:
        """Both at once."""
        return self.paint.eval_pdf(ctx, si, wo, active)

    def to_string(self) -> str:
        """Return the parameters as text."""
        return describe(self.table, self.given)
