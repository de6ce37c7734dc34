"""Link budget of a radar on a scene before tracing: signal, noise, timing, data volume, inconsistencies."""

from sarmitsuba.analysis.link.budget import LinkBudget, link_budget
from sarmitsuba.analysis.link.findings import Finding
from sarmitsuba.analysis.link.place import PlaceBudget
from sarmitsuba.analysis.link.prf_bounds import PulseTiming

__all__ = ["Finding", "LinkBudget", "PlaceBudget", "PulseTiming", "link_budget"]
