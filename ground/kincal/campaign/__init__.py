"""Campaigns: many cases of one scenario with dispersed values, flown on this computer or on a cluster.

plan: the file, resolved and checked; the cases it makes. pool: worker processes on this computer. cluster:
the same through dask.distributed. worker: the process that flies. function: cases without a scenario. store:
the folder of a campaign. fly: start to end, and one case again. statistics: what the outcomes show. Each is
loaded when it is first used: a worker needs none but its own."""

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from .fly import BATCH, Progress, Replayed, replay, run
    from .plan import Plan, planned, prepare
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
    "planned",
    "prepare",
    "read",
    "replay",
    "report",
    "run",
]

_HOME = {
    "fly": ("BATCH", "Progress", "Replayed", "replay", "run"),
    "plan": ("Plan", "planned", "prepare"),
    "statistics": ("Comparison", "Report", "compare", "report"),
    "store": ("Results", "read"),
}


def __getattr__(name: str) -> Any:
    for module, names in _HOME.items():
        if name in names:
            return getattr(import_module(f"{__name__}.{module}"), name)
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
