"""Run the commands of docs/TUTORIAL.md and put what they print into it, so that every number there comes
from a run.

    python ground/gen_tutorial.py            run, write outputs and pictures
    python ground/gen_tutorial.py --check    run, compare with what is written; status 1 if it differs

In the document a ```sh block is run; `<!-- show: REGEX -->` before the ```text block that follows picks the
lines of its output to print; `<!-- status: N -->` before a ```sh block says how it ends. What stands between
`<!-- made: summary -->` and `<!-- end -->` is computed from the outputs. Folder out/tutorial is made anew."""

from __future__ import annotations

import os
import re
import shlex
import shutil
import subprocess
import sys
import tempfile
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

ROOT = Path(__file__).resolve().parent.parent
DOCUMENT = ROOT / "docs" / "TUTORIAL.md"
IMAGES = ROOT / "docs" / "img"
OUT = "out/tutorial"
# picture of a report in out/tutorial -> picture of the page
PICTURES = {
    **{f"report-{name}": f"tutorial-{name}" for name in ("models", "posterior", "suspects", "map")},
    "wam-models": "tutorial-wam-models",
    "wam-found-1": "tutorial-wam-found",
}
REAL_ARM = "docs/data/wam"
TIMEOUT_S = 900
TOLERANCE = 0.02  # of a number, between machines
BLOCK = re.compile(
    r"(?:<!-- status: (?P<status>\d+) -->\n)?```sh\n(?P<commands>.*?)```\n"
    r"(?:\n<!-- show: (?P<show>.*?) -->\n```text\n(?P<text>.*?)```\n)?",
    re.S,
)
SUMMARY = re.compile(r"(<!-- made: summary -->\n).*?(<!-- end -->)", re.S)
NUMBER = re.compile(r"[-+]?\d+(?:\.\d+)?(?:e[-+]?\d+)?")


@dataclass(frozen=True)
class Step:
    """A block of commands, the status it must end with, and what it printed."""

    commands: str
    status: int
    output: str


class Shell:
    """Runs the blocks of a page in the root of a tree, as a person does in one shell: a folder
    and variables of a block hold for the next one, and a command that fails ends it, in a pipe too.

    kept: folder for what holds between two blocks; instead: what is run in place of a command; env: variables
    of the commands."""

    def __init__(self, root: Path, kept: Path, instead: Mapping[str, str], **env: str) -> None:
        self.root, self.kept, self.instead = root, kept / "shell", instead
        hidden = ("PYTHONPATH", "KINCAL_CORE", "KINCAL_KEYS", "KINCAL_JOURNAL", "VIRTUAL_ENV")
        self.env = {k: v for k, v in os.environ.items() if k not in hidden}
        self.env |= {"OMP_NUM_THREADS": "1", "COLUMNS": "140", **env}
        self.kept.write_text(f"cd {shlex.quote(str(root))}\n")

    def run(self, commands: str, status: int = 0) -> str:
        """What the commands print. SystemExit if they end with another status."""
        lines = (self.instead.get(line.partition("#")[0].strip(), line) for line in commands.splitlines())
        keep = f"(declare -px; echo cd \\'$PWD\\') > {shlex.quote(str(self.kept))}"
        script = "\n".join([f". {shlex.quote(str(self.kept))}", f"trap {shlex.quote(keep)} EXIT", *lines])
        done = subprocess.run(
            ["bash", "-e", "-o", "pipefail", "-c", script],
            cwd=self.root, env=self.env, capture_output=True, text=True, timeout=TIMEOUT_S,
        )  # fmt: skip
        if done.returncode != status:
            raise SystemExit(
                f"status {done.returncode}, not {status}:\n{commands}\n{done.stdout}{done.stderr}"
            )
        return done.stdout


def perform(text: str, shell: Shell) -> list[Step]:
    """Run every block of the document, in order."""
    return [
        Step(m["commands"], int(m["status"] or 0), shell.run(m["commands"], int(m["status"] or 0)))
        for m in BLOCK.finditer(text)
    ]


def shown(output: str, pattern: str) -> str:
    """The lines that match, each gap as one line of dots. A heading with nothing shown below it ends the
    run: the pattern misses what the heading is for."""
    lines, kept, gap = output.splitlines(), [], False
    for line in lines:
        if re.search(pattern, line):
            if gap and kept:
                kept.append("...")
            kept.append(line.rstrip())
            gap = False
        else:
            gap = True
    for line, after in zip(kept, [*kept[1:], "..."], strict=True):
        if line.endswith(":") and after == "...":
            raise SystemExit(f"nothing is shown below {line!r}; mend the pattern {pattern!r}")
    return "".join(f"{line}\n" for line in kept)


# --------------------------------------------------------------------------- the summary


def numbers(steps: list[Step]) -> dict[str, float]:
    """Errors from step to step, from the printed outputs."""
    others = ("odd", REAL_ARM, "tutorial/wam")  # another arm
    mine = (step.output for step in steps if not any(name in step.commands for name in others))
    text = "\n".join(mine)

    def last(pattern: str) -> float:
        return float(re.findall(pattern, text, re.M)[-1])

    floor = float(re.findall(r"^noise floor: ([\d.]+) mm", text, re.M)[-1])
    # the last pose of the first run: error of the DH calibration over the held-out poses
    alone = float(re.findall(r"^ ?(\d+)/\1 .* ([\d.]+) mm +[\d.]+ mrad$", text, re.M)[0][1])
    return {
        "floor": floor,
        "alone": alone,
        "before": last(r"^DH +held-out poses +([\d.]+)"),
        "after": last(r"^\+ backlash\[1\] +held-out poses +([\d.]+)"),
        "flown": last(r"^after +([\d.]+) mm"),
    }


def summary(n: dict[str, float]) -> str:
    """The table of errors, in Markdown."""
    rows = [
        ("noise floor of one measurement", n["floor"]),
        ("flight, DH alone, 200 held-out poses", n["alone"]),
        ("ground, DH alone, held-out poses of the log", n["before"]),
        ("ground, both effects added, the same poses", n["after"]),
        ("flight again, with the uplinked terms, 200 held-out poses", n["flown"]),
    ]
    lines = ["| error | mm | times the noise floor |", "|---|---|---|"]
    lines += [f"| {what} | {mm:.2f} | {mm / n['floor']:.1f} |" for what, mm in rows]
    return "\n" + "\n".join(lines) + "\n\n"


def written(text: str, steps: list[Step]) -> str:
    """The document with the outputs of these steps."""
    left = iter(steps)

    def fill(m: re.Match) -> str:
        step = next(left)
        if m["show"] is None:
            return m[0]
        start, end = m.span("text")
        return text[m.start() : start] + shown(step.output, m["show"]) + text[end : m.end()]

    out = BLOCK.sub(fill, text)
    return SUMMARY.sub(lambda m: m[1] + summary(numbers(steps)) + m[2], out)


def differences(old: str, new: str) -> list[str]:
    """Lines whose words differ, or whose numbers differ by more than the tolerance."""
    found = []
    a, b = old.splitlines(), new.splitlines()
    if len(a) != len(b):
        found.append(f"{len(a)} lines are written, {len(b)} come out")
    for x, y in zip(a, b, strict=False):
        same_words = NUMBER.sub("#", re.sub(r"\s+", " ", x)) == NUMBER.sub("#", re.sub(r"\s+", " ", y))
        pairs = zip(map(float, NUMBER.findall(x)), map(float, NUMBER.findall(y)), strict=False)
        if not same_words or any(abs(p - q) > TOLERANCE * max(abs(p), abs(q), 1e-3) + 1e-9 for p, q in pairs):
            found.append(f"- {x}\n+ {y}")
    return found


def main(argv: list[str]) -> int:
    """Write or check; the exit status."""
    folder = ROOT / OUT
    shutil.rmtree(folder, ignore_errors=True)
    text = DOCUMENT.read_text("utf-8")
    with tempfile.TemporaryDirectory() as kept:
        steps = perform(text, Shell(ROOT, Path(kept), {}))
    new = written(text, steps)
    if "--check" in argv:
        found = differences(text, new)
        print("\n".join(found), file=sys.stderr)
        return 1 if found else 0
    DOCUMENT.write_text(new, "utf-8")
    for drawn, name in PICTURES.items():
        if (folder / f"{drawn}.png").is_file():  # a report has a finding only if there is one
            shutil.copyfile(folder / f"{drawn}.png", IMAGES / f"{name}.png")
    print(f"{DOCUMENT.relative_to(ROOT)} and {len(PICTURES)} pictures written")
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
