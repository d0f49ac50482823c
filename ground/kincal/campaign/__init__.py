"""Campaigns: many cases of one scenario with dispersed values, flown on this computer or on a cluster.

plan: the file, resolved and checked; the cases it makes. pool: worker processes on this computer. cluster:
the same through dask.distributed. worker: the process that flies. store: the folder of a campaign. fly: start
to end, and one case again. statistics: what the outcomes show."""

from .fly import BATCH, Progress, Replayed, replay, run
from .plan import Plan, prepare
from .statistics import Comparison, Report, compare, report
from .store import Results, read

__all__ = [
    "BATCH",
    "Comparison",
    "Plan",
    "Progress",
    "Replayed",
    "Report",
    "Results",
    "compare",
    "prepare",
    "read",
    "replay",
    "report",
    "run",
]
