"""What a radar can do on a scene, before anything is traced: signal, noise, timing, data, and what cannot be."""

from sarmitsuba.link.budget import LinkBudget, link_budget
from sarmitsuba.link.findings import Finding
from sarmitsuba.link.place import PlaceBudget
from sarmitsuba.link.prf_bounds import PulseTiming

__all__ = ["Finding", "LinkBudget", "PlaceBudget", "PulseTiming", "link_budget"]
