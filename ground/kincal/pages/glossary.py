"""The terms of docs/GLOSSARY.md, for the list of words at the foot of a page."""

from __future__ import annotations

import re
from dataclasses import dataclass
from functools import cache
from pathlib import Path

_HERE = Path(__file__).resolve().parent
# In the wheel the glossary lies beside this file, in the source tree in docs/.
_PLACES = (_HERE / "GLOSSARY.md", _HERE.parents[2] / "docs" / "GLOSSARY.md")
_ROW = re.compile(r'^\| <a id="(?P<key>[^"]+)"></a>(?P<term>[^|`(]+)[^|]*\| (?P<meaning>[^|]+) \|', re.M)


@dataclass(frozen=True)
class Term:
    """One entry: key is its anchor."""

    key: str
    name: str
    meaning: str


def parse(text: str) -> list[Term]:
    """All entries of a glossary, in order, without mark-up."""
    return [Term(m["key"], m["term"].strip(), _plain(m["meaning"])) for m in _ROW.finditer(text)]


def _plain(text: str) -> str:
    text = re.sub(r"\[([^\]]+)\]\([^)]*\)", r"\1", text)  # links
    return re.sub(r"[`*]", "", text).strip()


@cache
def terms() -> tuple[Term, ...]:
    """The glossary of this installation; empty when it came without one."""
    file = next((place for place in _PLACES if place.is_file()), None)
    return tuple(parse(file.read_text("utf-8"))) if file else ()


def terms_in(text: str) -> list[Term]:
    """The terms that a text uses as whole words, also in the plural."""
    return [t for t in terms() if re.search(rf"\b{re.escape(t.name)}(s|es)?\b", text, re.I)]
