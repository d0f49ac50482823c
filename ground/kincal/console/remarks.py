"""Questions and comments about a correction, for its review in the browser."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Iterable
from typing import Any

from kincal.review.journal import REMARKS, Entry, Journal, one_line

Plain = dict[str, Any]


def listed(kept: Journal, crc: str) -> list[Plain]:
    """Those of a correction, oldest first; line: in the journal; open: a question without an answer."""
    open_ = kept.open_questions(crc)
    return [
        {
            "line": n,
            "what": e.decision,
            "by": e.by,
            "key": e.key_id,
            "time": e.time,
            "text": e.why,
            "answers": e.answers,
            "open": n in open_,
        }
        for n, e in enumerate(kept.entries, 1)
        if e.crc == crc and e.decision in REMARKS
    ]


def open_text(number: int, entry: Entry) -> str:
    """An open question that stands out; it is answered on the same page."""
    return f"open question by {entry.by}, {entry.time} (line {number} of the journal): {one_line(entry.why)}"


def stamp(stands_out: Iterable[str], remarks: Iterable[Plain]) -> str:
    """What a page says for and against a correction, as a few letters: a person who says that it was seen has
    seen that, and not what was found or written since."""
    said = json.dumps([list(stands_out), [remark["line"] for remark in remarks]])
    return hashlib.sha256(said.encode()).hexdigest()[:16]
