"""Text from elsewhere, as people may see it."""

from __future__ import annotations

import re

_CONTROL = re.compile(
    "[\x00-\x08\x0b-\x1f\x7f-\x9f\u061c\u200e\u200f\u2028-\u202e\u2066-\u2069\ud800-\udfff]"
)


def printable(text: str) -> str:
    """The same text with everything that a terminal or a browser would obey shown instead: names in logs,
    tables and journals may hold escape sequences, or characters that turn the direction of what follows."""
    return _CONTROL.sub(lambda found: f"\\x{ord(found[0]):02x}", text)
