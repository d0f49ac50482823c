"""The terms of docs/GLOSSARY.md, for the list of words at the foot of a page."""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cache
from pathlib import Path

from markupsafe import Markup

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
    return rf"\b{re.escape(term.name)}(s|es)?\b"


class Linker:
    """Makes the first use of each term on a page a link to its entry at the foot."""

    def __init__(self, known: Sequence[Term]):
        # long names first, so that "held-out poses" is not taken for "pose"
        self._left = sorted(known, key=lambda term: -len(term.name))

    def linked(self, text: str) -> Markup:
        """The text as HTML, escaped; terms that were linked before stay plain."""
        found = [(m.span(), t) for t in self._left if (m := re.search(_words(t), text, re.I))]
        chosen: list[tuple[tuple[int, int], Term]] = []
        for span, term in found:
            if all(span[1] <= a or b <= span[0] for (a, b), _ in chosen):
                chosen.append((span, term))
        out, at = Markup(""), 0
        for (a, b), term in sorted(chosen, key=lambda item: item[0]):
            link = Markup('<a class="word" href="#word-{}" title="{}">{}</a>')
            out, at = out + text[at:a] + link.format(term.key, term.meaning, text[a:b]), b
            self._left.remove(term)
        return out + text[at:]
