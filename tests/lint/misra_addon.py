"""cppcheck's MISRA addon over many dumps: loaded once, and forked for each. cppcheck itself starts an
interpreter for every file, and of two rules that a line breaks it tells one.

    misra_addon.py ADDON OWNED JOBS DUMP...     findings of each, one a line, to *.found beside it
    misra_addon.py ADDON LIST FOUND             rules across files, from the files in LIST, which it wrote

Four fifths of the tokens are of headers, the same in every dump that has them. Rules of expressions and
statements (10 to 16) need no more than the tokens around: OWNED names for each dump the files that they are
checked in there, each file in one dump. All other rules see everything everywhere.
"""

import copy
import gc
import io
import json
import multiprocessing
import runpy
import sys
from contextlib import redirect_stdout
from pathlib import Path

ADDON, *ARGUMENTS = sys.argv[1:]
sys.path.insert(0, str(Path(ADDON).parent))
MISRA = runpy.run_path(ADDON, run_name="misra")


EXECUTE = MISRA["MisraChecker"].executeCheck
FILES: set[str] = set()  # of the dump that is checked


def execute(checker: object, rule: int, check: object, *arguments: object) -> None:
    if 1000 < rule < 1700 and hasattr(arguments[0], "tokenlist"):
        arguments = (copy.copy(arguments[0]),)
        arguments[0].tokenlist = [token for token in arguments[0].tokenlist if token.file in FILES]
    EXECUTE(checker, rule, check, *arguments)


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
