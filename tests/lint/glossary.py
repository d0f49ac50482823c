"""One vocabulary: no old word is left, every specialised word is in docs/GLOSSARY.md, links lead somewhere.

    glossary.py [ROOT [PATH...]]     PATH: search old words in these files or folders only, and nothing else

Old words are searched in names and in prose (comments, strings, pages) of all sources, tests and pages;
tests/lint/vocabulary.toml lists them. Specialised words are those of states, verdicts, causes, commands,
events, table fields and JSON answers. States are explained by their table in docs/STATES.md, all others by
the glossary.
"""

from __future__ import annotations

import ast
import re
import sys
import tomllib
from collections.abc import Iterator
from dataclasses import dataclass
from functools import cache
from pathlib import Path

SEARCHED = {
    "fsw": (".c", ".h", ".cpp", ".hpp", ".lcm"),
    "sim": (".py", ".toml", ".cpp", ".hpp"),
    "ground": (".py", ".toml", ".j2", ".css"),
    "tables/src": (".toml",),
    "tests": (".py", ".c", ".h", ".toml"),
    "docs": (".md",),
    ".": (".md",),
}


@dataclass(frozen=True)
class Rule:
    """One old word: words of identifiers and senses in prose that are not allowed, and what to write."""

    instead: str
    names: frozenset[str]
    text: re.Pattern[str] | None


@dataclass(frozen=True)
class Vocabulary:
    """Content of tests/lint/vocabulary.toml; any_text, any_name: what the rules forbid, together; parts (of
    names), files: where old words are allowed."""

    rules: tuple[Rule, ...]
    any_text: re.Pattern[str]
    any_name: frozenset[str]
    parts: re.Pattern[str]
    files: frozenset[str]
    ordinary: frozenset[str]

    @classmethod
    def read(cls) -> Vocabulary:
        doc = tomllib.loads(Path(__file__).with_name("vocabulary.toml").read_text("utf-8"))
        rules = []
        for entry in doc["rule"]:
            text = re.compile("|".join(entry["text"])) if "text" in entry else None
            rules.append(Rule(entry["instead"], frozenset(entry.get("names", [])), text))
        allow = doc["allow"]
        return cls(
            rules=tuple(rules),
            any_text=re.compile("|".join(rule.text.pattern for rule in rules if rule.text)),
            any_name=frozenset().union(*(rule.names for rule in rules)),
            parts=re.compile("|".join(allow["parts"]), re.I),
            files=frozenset(allow["files"]),
            ordinary=frozenset(allow["ordinary"].split()),
        )


VOCABULARY = Vocabulary.read()


def words_of(name: str) -> list[str]:
    """Words of an identifier in small letters: KC_MON_OBS_MAX, FitResult, n_obs."""
    return [word.lower() for word in re.findall(r"[A-Z]+(?![a-z])|[A-Z]?[a-z]+|\d+", name)]


# --------------------------------------------------------------------------- names and prose of a file


@dataclass(frozen=True)
class Piece:
    """An identifier ("name") or a line of prose ("text")."""

    line: int
    kind: str
    text: str


ONE_WORD = re.compile(r"""[rbfuRBFU]*(['"]{0,3})([A-Za-z_]\w*)\1""")
C_TOKEN = re.compile(r'/\*.*?\*/|//[^\n]*|"(?:[^"\\\n]|\\.)*"|[A-Za-z_]\w*|\n', re.S)
TOML_TOKEN = re.compile(r"""#.*|"(?:[^"\\]|\\.)*"|'[^']*'|[A-Za-z_][\w-]*""")
# Comments, strings, numbers, names, ends of lines: `tokenize` has all tokens, in four times the time.
PYTHON_TOKEN = re.compile(
    r"""\#[^\n]* | [rbfu]{0,2}(?:
        \"{3}(?:[^\\]|\\.)*?\"{3} | '{3}(?:[^\\]|\\.)*?'{3} | "(?:[^"\\\n]|\\.)*" | '(?:[^'\\\n]|\\.)*'
    ) | \d[\w.]* | [^\W\d]\w* | \n""",
    re.S | re.I | re.X,
)


def of_literal(line: int, literal: str) -> Iterator[Piece]:
    """A string or comment. A string of a single word is a name (a key), anything else is prose."""
    if one := ONE_WORD.fullmatch(literal):
        yield Piece(line, "name", one[2])
        return
    for offset, row in enumerate(literal.splitlines()):
        yield Piece(line + offset, "text", row)


def of_python(text: str) -> Iterator[Piece]:
    line = 1
    for token in PYTHON_TOKEN.findall(text):
        if token[0] == "#" or token[-1] in "'\"":
            yield from of_literal(line, token)
        elif not (token == "\n" or token[0].isdigit()):
            yield Piece(line, "name", token)
        line += token.count("\n")


def of_c(text: str) -> Iterator[Piece]:
    line = 1
    for token in C_TOKEN.findall(text):
        if token[0] in '/"':
            yield from of_literal(line, token)
        elif token != "\n":
            yield Piece(line, "name", token)
        line += token.count("\n")


def of_toml(text: str) -> Iterator[Piece]:
    for line, row in enumerate(text.splitlines(), 1):
        for token in TOML_TOKEN.findall(row):
            if token[0] in "#\"'":
                yield from of_literal(line, token)
            else:
                yield Piece(line, "name", token)


def of_page(text: str) -> Iterator[Piece]:
    for line, row in enumerate(text.splitlines(), 1):
        for code in re.findall(r"`([A-Za-z_][\w.]*)`", row):
            yield Piece(line, "name", code)
        yield Piece(line, "text", row)


READERS = {".py": of_python, ".toml": of_toml, ".md": of_page, ".j2": of_page, ".css": of_page}


def pieces(path: Path) -> Iterator[Piece]:
    return READERS.get(path.suffix, of_c)(path.read_text("utf-8"))


# --------------------------------------------------------------------------- old words


def searched(root: Path) -> Iterator[tuple[str, Path]]:
    """Name in the repository and path of every file that is searched."""
    for folder, suffixes in SEARCHED.items():
        for path in sorted((root / folder).glob("*" if folder == "." else "**/*")):
            name = path.relative_to(root).as_posix()
            if path.suffix in suffixes and name not in VOCABULARY.files and path.is_file():
                yield name, path


@cache  # most names and many lines stand in more than one place
def old_words(kind: str, text: str) -> tuple[tuple[str, str], ...]:
    """Of a piece: (what was found, what to write instead)."""
    name = VOCABULARY.parts.sub("", text) if kind == "name" else ""
    words, faults = set(words_of(name)), []
    if not (VOCABULARY.any_name & words or VOCABULARY.any_text.search(name or text)):
        return ()  # nearly always
    for rule in VOCABULARY.rules:
        if rule.text and (found := rule.text.search(name or text)):
            faults.append((found.group(), rule.instead))
        elif rule.names & words:
            faults.append((text, rule.instead))
    return tuple(faults)


def check_old_words(root: Path, only: list[Path]) -> list[str]:
    faults = []
    for name, path in searched(root):
        if only and not any(path.is_relative_to(place) for place in only):
            continue
        for piece in pieces(path):
            for found, instead in old_words(piece.kind, piece.text):
                faults.append(f"{name}:{piece.line}: {found!r} is an old word: {instead}")
    return list(dict.fromkeys(faults))


# --------------------------------------------------------------------------- the glossary itself

TERM_ROW = re.compile(r'\| <a id="([^"]+)"></a>(.*?) \| (.*\S.*) \| (.*\S.*) \|')


@dataclass(frozen=True)
class Glossary:
    """groups: heading -> terms in their order; words: every word that has an entry; faults of its form."""

    groups: dict[str, list[str]]
    words: frozenset[str]
    faults: list[str]


def read_glossary(text: str) -> Glossary:
    groups: dict[str, list[str]] = {"": []}
    words: set[str] = set()
    faults: list[str] = []
    anchors: list[str] = []
    for number, line in enumerate(text.splitlines(), 1):
        if line.startswith("## "):
            groups[line[3:]] = []
        elif line.startswith("| <a id"):
            if not (row := TERM_ROW.fullmatch(line)):
                faults.append(f"docs/GLOSSARY.md:{number}: a row is | anchor and term | meaning | source |")
                continue
            anchors.append(row[1])
            groups[list(groups)[-1]].append(row[2].split("`")[0].strip(" ,").lower())
            words.update(words_of(row[2]))
    for anchor in sorted({anchor for anchor in anchors if anchors.count(anchor) > 1}):
        faults.append(f"docs/GLOSSARY.md: {anchor} is there twice")
    return Glossary(groups, frozenset(words), faults + unsorted(groups))


def unsorted(groups: dict[str, list[str]]) -> list[str]:
    faults = []
    for name, terms in groups.items():
        for a, b in zip(terms, terms[1:], strict=False):
            if a > b:
                faults.append(f"docs/GLOSSARY.md: {name}: {a!r} stands before {b!r}")
    return faults


# --------------------------------------------------------------------------- specialised words


def enum(prefix: str):
    """Reader of the names of a C enum."""
    return lambda text: re.findall(rf"\b{prefix}([A-Z0-9_]+)\s*=", text)


def matches(pattern: str):
    """Reader of what a pattern finds in a page or list."""
    return lambda text: re.findall(pattern, text, re.M)


def dict_keys(source: str) -> list[str]:
    """Keys of the dictionaries in a Python source."""
    dicts = [node for node in ast.walk(ast.parse(source)) if isinstance(node, ast.Dict)]
    keys = [key.value for node in dicts for key in node.keys if isinstance(key, ast.Constant)]
    return [key for key in keys if isinstance(key, str)]


# Pages on which every name in `code` needs an entry.
PAGES = ("STATES", "SPACES", "DESIGN", "WORKBENCH", "TUTORIAL")
# What it is, where it stands, how it is read.
TERMS = (
    ("states", "fsw/state/kc_states.h", enum("KC_ST_")),
    ("causes", "fsw/tables/kc_events.h", matches(r'\bX\(\d+, ([A-Z]\w+),\s*"')),
    ("verdicts", "fsw/decide/kc_verdict.h", enum("KC_VERDICT_")),
    ("opcodes", "fsw/msg/cmd_t.lcm", matches(r"\b(?!SRC_)([A-Z_]+) = \d")),
    ("coefficient statuses", "fsw/estimate/kc_estimate.h", enum("KC_COEF_")),
    ("monitor states", "fsw/estimate/kc_monitor.h", enum("KC_MON_")),
    ("events", "fsw/tables/kc_events.h", matches(r"\bX\(\d+, ([A-Z]\w+),\s*(?:DEBUG|INFO|WARN|ERROR)\b")),
    ("table fields", "docs/TABLES.md", matches(r"^\| \d+ \| ([\w.]+) \|")),
    ("tables", "docs/TABLES.md", matches(r"^### \d (\w+)$")),
    ("JSON keys", "ground/kincal/workbench/report/answers.py", dict_keys),
    ("commands", "docs/CLI.md", matches(r"^#+ `?(kincal [a-z -]+)`?$")),
    *(("names", f"docs/{page}.md", matches(r"`([A-Za-z_][\w.]*)`")) for page in PAGES),
)  # fmt: skip


STATE_ROW = re.compile(r"^\| `([A-Z]+)` \| [^|]*\w[^|]* \| [^|]*\w[^|]* \|$", re.M)


def explained_states(root: Path) -> frozenset[str]:
    """Words of the states that the first table of STATES.md explains: what happens, and when it ends."""
    page = root / "docs/STATES.md"
    text = page.read_text("utf-8") if page.exists() else ""
    table = text.partition("| state | what happens | ends when |")[2].partition("\n\n")[0]
    return frozenset(word for state in STATE_ROW.findall(table) for word in words_of(state))


def check_terms(root: Path, glossary: Glossary) -> list[str]:
    faults = []
    known = glossary.words | explained_states(root)
    for what, name, read in TERMS:
        found = read((root / name).read_text("utf-8")) if (root / name).exists() else []
        if not found:
            faults.append(f"{name}: no {what} found, so this check would see nothing")
        for term in dict.fromkeys(found):
            for word in words_of(term):
                if not is_known(word, known):
                    faults.append(f"{name}: {term} ({what}): {word!r} is not in docs/GLOSSARY.md")
    return faults


def is_known(word: str, entries: frozenset[str]) -> bool:
    """Whether a word is ordinary, a number or a letter, or has an entry, also in another form."""
    forms = {word} | {word.removesuffix(ending) for ending in ("s", "es", "d", "ed")}
    return word.isdigit() or len(word) == 1 or bool(forms & (VOCABULARY.ordinary | entries))


# --------------------------------------------------------------------------- links and references


def anchors_of(page: Path) -> set[str]:
    """Anchors of a page: those that it states, and those of its headings."""
    text = page.read_text("utf-8")
    headings = re.findall(r"^#+ (.*)$", text, re.M)
    slugs = {re.sub(r"[^\w\- ]", "", heading.lower().strip()).replace(" ", "-") for heading in headings}
    return slugs | set(re.findall(r'<a id="([^"]+)"', text))


def leads_nowhere(page: Path, target: str) -> bool:
    if re.match(r"[a-z]+:", target):
        return False
    place, _, anchor = target.partition("#")
    there = page.parent / place if place else page
    return not there.exists() or bool(anchor and there.suffix == ".md" and anchor not in anchors_of(there))


def check_links(root: Path) -> list[str]:
    faults = []
    for page in [*sorted(root.glob("*.md")), *sorted(root.glob("docs/*.md"))]:
        code = r"```.*?```|`[^`\n]*`(?!\]\()"  # has no links, but may be the text of one
        text = re.sub(code, "", page.read_text("utf-8"), flags=re.S)
        for target in re.findall(r"\]\(([^)\s]+)\)", text):
            if leads_nowhere(page, target):
                faults.append(f"{page.relative_to(root).as_posix()}: link to {target} leads nowhere")
    return faults


OUTSIDE = re.compile(
    r"\b(?:method|diagnosis|architecture|workbench)\.md\b|\.\./shared\b|ROOT\.parent\b|\"shared\" /"
)


def check_outside(root: Path) -> list[str]:
    """Pages and folders outside the repository that sources or pages name."""
    faults = []
    for name, path in searched(root):
        for number, line in enumerate(path.read_text("utf-8").splitlines(), 1):
            if found := OUTSIDE.search(line):
                faults.append(f"{name}:{number}: {found.group()} is outside the repository")
    return faults


def main() -> int:
    root = Path(sys.argv[1]).resolve() if len(sys.argv) > 1 else Path(__file__).resolve().parents[2]
    only = [(root / name).resolve() for name in sys.argv[2:]]
    faults = check_old_words(root, only)
    if not only:
        glossary = read_glossary((root / "docs/GLOSSARY.md").read_text("utf-8"))
        faults += glossary.faults + check_terms(root, glossary) + check_links(root) + check_outside(root)
    for fault in faults:
        print(fault)
    return 1 if faults else 0


if __name__ == "__main__":
    sys.exit(main())
