"""KinCal on the ground: tables, search spaces, runs, logs, review, pictures, and the model workbench.

Kinematics, terms, tables and events come from the flight core itself (kincal.flight), so what is
reviewed is what flies.

    import kincal
    arm, data = kincal.Arm.load("wam"), kincal.Data.load("poses.csv")
    fitted = kincal.fit(arm, data, ["joint_compliance[2]"])
    fitted.export("urdf", "calibrated.urdf")
"""

from __future__ import annotations

import importlib
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from kincal.api import (
        Arm,
        BadInput,
        CannotAnswer,
        Compared,
        Data,
        Diagnosed,
        Fitted,
        compare,
        diagnose,
        fit,
    )

__version__ = "0.1.0"
__all__ = [
    "Arm",
    "BadInput",
    "CannotAnswer",
    "Compared",
    "Data",
    "Diagnosed",
    "Fitted",
    "compare",
    "diagnose",
    "fit",
]


def __getattr__(name: str) -> Any:
    """Names of the Python interface, loaded when they are first used: `import kincal` alone is light."""
    if name not in __all__:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    return getattr(importlib.import_module("kincal.api"), name)


def __dir__() -> list[str]:
    return sorted([*globals(), *__all__])
