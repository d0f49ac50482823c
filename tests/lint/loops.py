"""Every loop of the flight core has a named bound.

    loops.py [ROOT]

Writes build/LOOPS.md: each loop of fsw/math to fsw/exec with its bound. A bound is a
number or a macro of upper case in the loop's condition, or what tests/lint/loops.toml says of the variable in
it: a name that has one meaning everywhere, one of a file ("n"), or of a function in it ("kc_x.n"). Whatever
bound that file gives has to be made of numbers and of macros that the code defines. Exits with 1 if a loop
has none."""

import re
import sys
import tomllib
from pathlib import Path

CORE = ("math", "eigen", "model", "estimate", "design", "motion", "tables", "decide", "exec")
NUMBER = re.compile(r"\d+u?$")
MACRO = re.compile(r"[A-Z][A-Z0-9_]+$")


def without_comments(text: str) -> str:
    return re.sub(r"/\*.*?\*/|//[^\n]*", lambda m: re.sub(r"[^\n]", " ", m[0]), text, flags=re.DOTALL)


def loops_of(text: str):
    """Line, initial part and condition of every loop."""
    for found in re.finditer(r"\b(for|while)\s*\(", text):
        depth, end = 1, found.end()
        while depth:
            depth += {"(": 1, ")": -1}.get(text[end], 0)
            end += 1
        head = " ".join(text[found.end() : end - 1].split())
        first, _, rest = head.partition(";") if found[1] == "for" else ("", "", head)
        yield text.count("\n", 0, found.start()) + 1, first.strip(), rest.partition(";")[0].strip()


def candidates(first: str, condition: str):
    """Expressions that may bound the loop: the right of a comparison, or where a countdown begins."""
    for part in condition.split("&&"):
        right = re.search(r"<=?\s*(.+)$", part.strip())
        if right and "<<" not in part:
            yield right[1].strip()
        if re.search(r"(--\s*>|> 0u?$)", part.strip()) and "=" in first:
            yield first.rsplit("=", 1)[1].strip()
    yield condition


def bound(expression: str, here: dict[str, str], everywhere: dict[str, str], used: set) -> str | None:
    if expression in here:
        used.add(expression)
        return here[expression]
    bare = re.sub(r"\(uint32_t\)|\(int32_t\)", "", expression)
    macros = re.findall(r"\b[A-Z][A-Z0-9_]{2,}\b", bare)
    names = re.findall(r"\b[a-z]\w*\b(?!\s*(?:->|\.))", bare)
    if NUMBER.match(bare):
        return bare.rstrip("u")
    if macros and not names:
        return bare
    if re.search(r"[\s(]", bare):
        return None
    last = re.split(r"->|\.", bare)[-1]
    if last in here:
        used.add(last)
        return here[last]
    if re.fullmatch(r"\w+", last) and last in everywhere:
        used.add(("", last))
        return everywhere[last]
    return None


def function_at(lines: list[str], line: int) -> str:
    for text in reversed(lines[:line]):
        found = re.match(r"^[a-z][\w \*:]*?\b\*?(\w+)\(", text)
        if found and not text.rstrip().endswith(";"):
            return found[1]
    return ""


def survey(root: Path) -> tuple[list[tuple[str, int, str, str, str]], list[str]]:
    rules = tomllib.loads((root / "tests/lint/loops.toml").read_text())
    everywhere, files = rules.get("everywhere", {}), rules.get("file", {})
    rows, faults, used = [], [], {name: set() for name in files}
    general: set = set()
    sources = [p for room in CORE for p in sorted((root / "fsw" / room).glob("*.*")) if p.suffix != ".txt"]
    texts = {p: without_comments(p.read_text()) for p in sources}
    defined = set(re.findall(r"#define (\w+)|\b([A-Z][A-Z0-9_]{2,})\b\s*[=,]", "\n".join(texts.values())))
    macros = {a or b for a, b in defined}
    for path, text in texts.items():
        here = files.get(path.name, {})
        for line, first, condition in loops_of(text):
            name = function_at(text.splitlines(), line)
            used.setdefault(path.name, set())
            got = None
            for expression in candidates(first, condition):
                mine = set()
                scoped = {
                    k.removeprefix(name + "."): (k, v) for k, v in here.items() if k.startswith(name + ".")
                }
                if expression in scoped:
                    key, got = scoped[expression]
                    used[path.name].add(key)
                    break
                got = bound(expression, here, everywhere, mine)
                if got is not None:
                    used[path.name] |= {u for u in mine if isinstance(u, str)}
                    general |= {u[1] for u in mine if isinstance(u, tuple)}
                    break
            where = f"{path.relative_to(root)}:{line}"
            if got is None:
                faults.append(f"{where}: no bound of this loop is known: {condition}")
                continue
            unknown = [m for m in re.findall(r"\b[A-Za-z_]\w*", got) if m not in macros]
            if unknown:
                faults.append(f"{where}: the bound {got} names {', '.join(unknown)}, which is no macro")
            rows.append((str(path.relative_to(root / "fsw")), line, name, condition, got))
    for name, here in files.items():
        faults += [f"tests/lint/loops.toml: {name} has no loop for {key}" for key in set(here) - used[name]]
    faults += [f"tests/lint/loops.toml: no loop for {key}" for key in set(everywhere) - general]
    return rows, faults


def page(rows) -> str:
    out = [
        "# Loops",
        "",
        "Which bound does each loop of the flight core have? Made by `tests/lint/loops.py` from the code and",
        "from `tests/lint/loops.toml`; `make lint-loops` fails on a loop without one. Constants are those of",
        "`fsw/math/kc_limits.h`, or of the file itself.",
        "",
        f"{len(rows)} loops.",
        "",
    ]
    last = None
    for path, _line, function, condition, got in rows:
        if path != last:
            out += ["", f"## {path}", "", "| function | goes on while | at most |", "|---|---|---|"]
            out = out if last else [*out[:-5], *out[-4:]]
            last = path
        shown = condition.replace("|", "\\|")
        out.append(f"| `{function}` | `{shown}` | `{got}` |")
    return "\n".join(out) + "\n"


def main(argv: list[str]) -> int:
    root = Path(argv[0]) if argv else Path(__file__).parents[2]
    rows, faults = survey(root)
    path = root / "build/LOOPS.md"
    path.parent.mkdir(exist_ok=True)
    path.write_text(page(rows))
    print("\n".join(faults), end="\n" if faults else "")
    return 1 if faults else 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
