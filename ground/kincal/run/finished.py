"""What a run left."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

from kincal.link import LogSummary, Session

from .evaluate import Evaluator


@dataclass(frozen=True)
class Finished:
    """What a run left: its log, its last session, launch.json, the evaluator with the ground truth, and how
    long it took on the wall clock [s]."""

    log: LogSummary
    session: Session
    launch: dict[str, Any]
    evaluator: Evaluator
    wall_s: float
