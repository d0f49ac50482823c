"""Answers that cannot be read by accident, and that show it when they were changed."""

from __future__ import annotations

import base64
import hashlib
import json
import zlib


class BrokenSeal(ValueError):
    """The answer is not the one that was sealed."""


def seal(answer: dict) -> dict:
    """The answer, unreadable to the eye, with the hash of its canonical text."""
    text = json.dumps(answer, sort_keys=True, separators=(",", ":")).encode()
    return {
        "sha256": hashlib.sha256(text).hexdigest(),
        "sealed": base64.b64encode(zlib.compress(text)).decode(),
    }


def unseal(sealed: dict, sha256: str | None = None) -> dict:
    """The answer. sha256: as the manifest had it when the case was made. Raises BrokenSeal."""
    text = zlib.decompress(base64.b64decode(sealed["sealed"]))
    found = hashlib.sha256(text).hexdigest()
    if found != sealed["sha256"] or (sha256 is not None and found != sha256):
        raise BrokenSeal(f"the answer has hash {found[:12]}, sealed was {(sha256 or sealed['sha256'])[:12]}")
    return json.loads(text)
