"""Every event with its likely causes and what to do, as docs/OPERATIONS.md has them."""

from __future__ import annotations

import tomllib
from functools import cache
from typing import Any

from kincal.flight import event_action, event_name
from kincal_shared import installation

SOURCE = "fsw/tables/kc_events.toml"
_MOST = 2**12


@cache
def dictionary() -> dict[str, dict[str, str]]:
    """Name of an event -> cause, do. Without the file of causes (an incomplete installation) flight's own
    advice alone."""
    path = installation.root() / SOURCE
    known: dict[str, Any] = tomllib.loads(path.read_text("utf-8"))["event"] if path.is_file() else {}
    out: dict[str, dict[str, str]] = {}
    for number in range(1, _MOST):
        name = event_name(number)
        if name in ("", "UNKNOWN") or name in out:
            continue
        about = known.get(name, {})
        steps = (event_action(number), about.get("do", ""))
        out[name] = {"cause": about.get("cause", ""), "do": " ".join(step for step in steps if step)}
    return out
