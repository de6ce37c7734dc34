"""Link budget of a radar on a scene before tracing: signal, noise, timing, data volume, inconsistencies."""

from sarmitsuba.link.budget import LinkBudget, link_budget
from sarmitsuba.link.findings import Finding
from sarmitsuba.link.place import PlaceBudget
from sarmitsuba.link.prf_bounds import PulseTiming

__all__ = ["Finding", "LinkBudget", "PlaceBudget", "PulseTiming", "link_budget"]
