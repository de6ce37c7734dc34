"""Distributed runs: batches of pulses and tiles of pixels in the worker processes of a Dask cluster.

Importing this package imports no Dask.
"""

from sarmitsuba.apps.cluster.address import ClusterAddress
from sarmitsuba.apps.cluster.scaling import ClusterPlan

__all__ = ["ClusterAddress", "ClusterPlan"]
