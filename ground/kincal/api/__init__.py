"""The one door to the ground's library: for commands, notebooks, and programs of your own.

Objects of the workbench; `import kincal` gives these names too.

    arm, data = kincal.Arm.load("wam"), kincal.Data.load("poses.csv")
    kincal.compare(arm, data)                       what the model leaves, and where
    kincal.diagnose(arm, data)                      which effect is missing
    fitted = kincal.fit(arm, data, ["backlash[4]"])
    fitted.predict(q, direction=d), fitted.correct(q, direction=d), fitted.export("c", "calibrated.c")

Whole runs in simulation (`Request`, `Observer`, `calibrate`), logs (`read_log`), the live link (`Link`), and
what commands do beyond one call into the library, by module: `case` and `models` (workbench), `tables`,
`spaces`, `reviews`, `corrected`, `previews`. Each is loaded when it is first used.
"""

from __future__ import annotations

import importlib
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from kincal.link import Link, read_log
    from kincal.run import Observer, Request, calibrate
    from kincal_shared.errors import BadInput, CannotAnswer

    from .case import Case
    from .fitted import Fitted, fit
    from .inputs import Arm, Data
    from .verdicts import Compared, Diagnosed, compare, diagnose

__all__ = [
    "Arm",
    "BadInput",
    "CannotAnswer",
    "Case",
    "Compared",
    "Data",
    "Diagnosed",
    "Fitted",
    "Link",
    "Observer",
    "Request",
    "calibrate",
    "compare",
    "diagnose",
    "fit",
    "read_log",
]

_HOME = {
    "Arm": "kincal.api.inputs",
    "BadInput": "kincal_shared.errors",
    "CannotAnswer": "kincal_shared.errors",
    "Case": "kincal.api.case",
    "Compared": "kincal.api.verdicts",
    "Data": "kincal.api.inputs",
    "Diagnosed": "kincal.api.verdicts",
    "Fitted": "kincal.api.fitted",
    "Link": "kincal.link",
    "Observer": "kincal.run",
    "Request": "kincal.run",
    "calibrate": "kincal.run",
    "compare": "kincal.api.verdicts",
    "diagnose": "kincal.api.verdicts",
    "fit": "kincal.api.fitted",
    "read_log": "kincal.link",
}


def __getattr__(name: str) -> Any:
    if name not in _HOME:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    return getattr(importlib.import_module(_HOME[name]), name)


def __dir__() -> list[str]:
    return sorted([*globals(), *__all__])
