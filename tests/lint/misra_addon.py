"""cppcheck's MISRA addon over many dumps: loaded once, and forked for each. cppcheck itself starts an
interpreter for every file, and of two rules that a line breaks it tells one.

    misra_addon.py ADDON OWNED JOBS DUMP...     findings of each, one a line, to *.found beside it
    misra_addon.py ADDON LIST FOUND             rules across files, from the files in LIST, which it wrote

Four fifths of the tokens are of headers, the same in every dump that has them. Rules of expressions and
statements (10 to 16) and some others need no more than the tokens around, prototypes (8.2) no more than
their function: OWNED names for each dump the files that they are checked in there, each file in one dump.
All other rules see everything everywhere.

Dumps are read by expat, which takes half as long as the addon's way by ElementTree.
"""

import copy
import functools
import gc
import io
import json
import multiprocessing
import runpy
import sys
from collections.abc import Callable, Iterator
from contextlib import redirect_stdout
from pathlib import Path
from types import SimpleNamespace
from xml.parsers import expat

ADDON, *ARGUMENTS = sys.argv[1:]
sys.path.insert(0, str(Path(ADDON).parent))
MISRA = runpy.run_path(ADDON, run_name="misra")
EXECUTE = MISRA["MisraChecker"].executeCheck
# Words of C11, operations without effect, bit-fields, suffixes, int left out, prototypes; 10 to 16;
# <stdarg.h>, unused results, changed parameters, pointer arithmetic, unions, functions of the library, FILE,
# EOF. The addon carries nothing from one token to the next for any of them.
AROUND = {104, 202, 602, 702, 801, 802, *range(1001, 1700), 1701, 1707, 1708, 1804, 1902, 2103, 2107, 2108,
          2109, 2110, 2115, 2116, 2119, 2121, 2205, 2207}  # fmt: skip
FILES: set[str] = set()  # of the dump that is checked


def execute(checker: object, rule: int, check: object, *arguments: object) -> None:
    if rule in AROUND and hasattr(arguments[0], "tokenlist"):
        arguments = (part(arguments[0]), *arguments[1:])
    EXECUTE(checker, rule, check, *arguments)


def part(configuration):
    """The configuration with the tokens and functions of FILES, the same for every rule. A function is of the
    files that declare and define it."""
    if not hasattr(configuration, "part"):
        configuration.part = copy.copy(configuration)
        configuration.part.tokenlist = [token for token in configuration.tokenlist if token.file in FILES]
        configuration.part.functions = [
            f for f in configuration.functions if any(t and t.file in FILES for t in (f.token, f.tokenDef))
        ]
    return configuration.part


class Element:
    """Of an XML element what the addon's reader asks for."""

    __slots__ = ("children", "get", "tag")

    def __init__(self, tag: str, get: Callable):
        self.tag, self.get, self.children = tag, get, []

    def __iter__(self) -> Iterator["Element"]:
        return iter(self.children)

    def clear(self) -> None:
        pass


WHOLE = ("rawtokens", "suppressions")  # elements whose children the reader takes from them
ENDS = ("dump", "function", "varlist", "typedef-info", "values")  # that the reader waits for
Events = list[tuple[str, Element]]


@functools.cache  # the reader begins twice
def read(path: str) -> Events:
    """Starts of elements outside WHOLE, and the ends that the reader waits for."""
    found: Events = []
    inside: Element | None = None

    def start(tag: str, attributes: dict[str, str]) -> None:
        nonlocal inside
        element = Element(tag, attributes.get)
        if inside:
            inside.children.append(element)
            return
        if tag in WHOLE:
            inside = element
        found.append(("start", element))

    def end(tag: str) -> None:
        nonlocal inside
        if inside and tag == inside.tag:
            found.append(("end", inside))
            inside = None
        elif not inside and tag in ENDS:
            found.append(("end", Element(tag, {}.get)))

    parser = expat.ParserCreate()
    parser.StartElementHandler, parser.EndElementHandler = start, end
    parser.Parse(Path(path).read_bytes(), True)
    return found


def iterparse(path: str, events: tuple[str, ...]) -> Iterator[tuple[str, Element]]:
    """In the place of ElementTree's."""
    assert events == ("start", "end")
    return iter(read(path))


sys.modules["cppcheckdata"].ElementTree = SimpleNamespace(iterparse=iterparse)


def findings(*words: str) -> str:
    sys.argv = [ADDON, "--cli", *words]
    with redirect_stdout(io.StringIO()) as out:
        MISRA["main"]()
    return out.getvalue()


def check(name: str) -> None:
    gc.disable()  # the process ends with this file
    FILES.update(OWNED[name])
    MISRA["MisraChecker"].executeCheck = execute
    dump = Path(name)
    dump.with_suffix(".ctu-info").write_text("")  # the addon appends to it
    new = dump.with_suffix(".new")
    new.write_text(findings(name))
    new.rename(dump.with_suffix(".found"))  # whole, or not there


if __name__ == "__main__":
    if len(ARGUMENTS) > 2:
        OWNED = json.loads(Path(ARGUMENTS[0]).read_text())
        with multiprocessing.get_context("fork").Pool(int(ARGUMENTS[1]), maxtasksperchild=1) as pool:
            pool.map(check, ARGUMENTS[2:], chunksize=1)
    else:
        Path(ARGUMENTS[1]).write_text(findings("--file-list", ARGUMENTS[0]))
