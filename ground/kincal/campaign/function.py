"""Cases that a function flies instead of a scenario.

MODULE:FUNCTION is called with the seed of a case and its values by name, and gives a flat dict: texts,
numbers, true or false, None. Its keys become columns; `ended` and `reason` are what reports say of a case."""

from __future__ import annotations

import hashlib
import sys
import time
from collections.abc import Callable, Mapping
from importlib import import_module
from pathlib import Path
from typing import Any, TypeAlias

import numpy as np

from kincal.results import Flown, Value
from kincal_shared.errors import BadInput

from . import installed

DIED = "died"
TIMINGS = ("wall_s", "cpu_s")  # the columns that differ from one flight of a case to the next
FIXED = ("index", "seed", "digest", *TIMINGS)  # columns that every campaign has
DISPERSED = "x."  # before the key, in the names of columns
_WHOLE_MAX = 2**63
Function: TypeAlias = Callable[[int, dict[str, Value]], Any]


def load(reference: str, beside: Path) -> Function:
    """The function of MODULE:FUNCTION; its module is in a folder, or installed. BadInput if there is none."""
    name, _, attribute = reference.partition(":")
    todo = f"write MODULE:FUNCTION; modules are looked for in {beside} and among what is installed"
    if str(beside) not in sys.path:
        sys.path.insert(0, str(beside))
    try:
        found: Function = getattr(import_module(name), attribute)
    except (Exception, SystemExit) as error:  # noqa: BLE001 whatever a module of others does when it is read
        raise BadInput(f"cannot be used: {type(error).__name__}: {error}", reference, todo) from None
    if not callable(found):
        raise BadInput("is no function", reference, todo)
    return found


def software(reference: str, beside: Path) -> dict[str, str]:
    """Everything but the spec that the bits of a case depend on: with a function, its file too."""
    found = installed.software()
    if not reference:
        return found
    load(reference, beside)
    file = getattr(sys.modules[reference.partition(":")[0]], "__file__", None)
    code = Path(file).read_bytes() if file else b""
    return found | {"function": hashlib.sha256(code).hexdigest()[:16]}


def fly(reference: str, beside: Path, values: Mapping[str, Value], seed: int) -> Flown:
    """One case. TypeError if the function gives anything but a flat dict."""
    begun = time.process_time()
    outcome = columns(load(reference, beside)(seed, dict(values)))
    digest = hashlib.sha256(repr(sorted(outcome.items())).encode())
    return Flown(dict(values), outcome, digest.hexdigest(), time.process_time() - begun)


def _is_unicode(text: str) -> bool:
    try:
        text.encode()
    except UnicodeEncodeError:  # half a surrogate pair, as in a file name of other bytes
        return False
    return True


def columns(given: Any) -> dict[str, Value | None]:
    """What a function gave, if it can be columns. TypeError if not."""
    if not isinstance(given, Mapping):
        raise TypeError(f"the function gave a {type(given).__name__}, not a dict of columns")
    found = {key: value.item() if isinstance(value, np.generic) else value for key, value in given.items()}
    for key, value in found.items():
        if not isinstance(key, str) or key in FIXED or key.startswith(DISPERSED):
            raise TypeError(f"no column can be called {key!r}")
        if key in ("ended", "reason") and (not isinstance(value, str) or value == DIED):
            raise TypeError(f"{key} is {value!r}; a text is needed, other than {DIED!r}")
        if any(isinstance(text, str) and not _is_unicode(text) for text in (key, value)):
            raise TypeError(f"{key!a} is no Unicode text: {value!a}")
        whole = isinstance(value, int) and not -_WHOLE_MAX <= value < _WHOLE_MAX
        if whole or not isinstance(value, (str, bool, int, float, type(None))):
            kind = "too large" if whole else f"of type {type(value).__name__}"
            raise TypeError(f"{key} is {kind}; columns hold texts, numbers of 64 bits, true or false")
    return found
