"""The terms of docs/GLOSSARY.md, for the list of words at the foot of a page."""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cache
from pathlib import Path

from markupsafe import Markup

from kincal_shared.printable import printable

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
    return [t for t in terms() if re.search(_words(t), text, re.I)]


def _words(term: Term) -> str:
    return rf"\b(?<!-){re.escape(term.name)}(s|es)?\b"


class Linker:
    """Makes the first use of each term on a page a link to its entry at the foot."""

    def __init__(self, known: Sequence[Term]):
        # long names first, so that "worst poses" is not taken for "pose"
        self._known = sorted(known, key=lambda term: -len(term.name))
        self._pattern = re.compile("|".join(f"({_words(t)})" for t in self._known) or "(?!)", re.I)
        self._used: set[str] = set()

    def linked(self, text: str) -> Markup:
        """The text as HTML, escaped; terms that were linked before stay plain."""
        out, at, text = Markup(""), 0, printable(text)
        for m in self._pattern.finditer(text):
            term = next(t for t in self._known if re.fullmatch(_words(t), m[0], re.I))
            out, at = out + text[at : m.start()] + self._link(term, m[0]), m.end()
        return out + text[at:]

    def _link(self, term: Term, used_as: str) -> Markup | str:
        if term.key in self._used:
            return used_as
        self._used.add(term.key)
        link = Markup('<a class="word" href="#word-{}" title="{}">{}</a>')
        return link.format(term.key, term.meaning, used_as)
