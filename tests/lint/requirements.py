"""Every requirement has a test, and every test file of flight a requirement.

    requirements.py [ROOT]

docs/REQUIREMENTS.csv: id, requirement, rationale, verified by. What verifies stands with semicolons between:
a test file, a test in it (file::function), or a target (`make wcet`). Exits with 1 and says what does not
hold."""

import csv
import re
import sys
from collections.abc import Iterator
from pathlib import Path

COLUMNS = ["id", "requirement", "rationale", "verified by"]
# Files whose tests are of flight; each has to verify some requirement.
OF_FLIGHT = (
    "tests/unit/test_kc_*.c", "tests/system/test_*.c",
    "tests/oracle/test_*.py", "tests/integration/test_*.py",
)  # fmt: skip


def wrong_row(root: Path, row: dict[str, str]) -> Iterator[str]:
    if not re.fullmatch(r"KC-[A-Z]+-\d\d", row["id"]):
        yield "the id is not like KC-MOT-01"
    if " shall " not in row["requirement"]:
        yield "the requirement does not say what shall be"
    yield from (f"{name} is empty" for name in COLUMNS if not row[name].strip())
    for proof in proofs(row):
        if (why := missing(root, proof)) is not None:
            yield f"{proof}: {why}"


def proofs(row: dict[str, str]) -> list[str]:
    return [proof for proof in row["verified by"].split("; ") if proof]


def missing(root: Path, proof: str) -> str | None:
    """Why a proof is none; None if it is there."""
    if proof.startswith("make "):
        target = rf"^{re.escape(proof.removeprefix('make '))}:"
        return None if re.search(target, (root / "Makefile").read_text(), re.M) else "no such target"
    name, _, function = proof.partition("::")
    if not (root / name).is_file():
        return "no such file"
    defined = rf"^(void|def) {re.escape(function)}\("
    found = not function or re.search(defined, (root / name).read_text(), re.M)
    return None if found else "no such test"


def findings(root: Path) -> Iterator[str]:
    with (root / "docs/REQUIREMENTS.csv").open(newline="") as file:
        reader = csv.DictReader(file)
        rows = list(reader)
    if reader.fieldnames != COLUMNS:
        yield f"the columns have to be {', '.join(COLUMNS)}"
        return
    ids = [row["id"] for row in rows]
    yield from (f"{one}: twice" for one in sorted({one for one in ids if ids.count(one) > 1}))
    yield from (f"{row['id']}: {why}" for row in rows for why in wrong_row(root, row))
    used = {proof.partition("::")[0] for row in rows for proof in proofs(row)}
    there = {str(path.relative_to(root)) for pattern in OF_FLIGHT for path in root.glob(pattern)}
    yield from (f"{name}: verifies no requirement" for name in sorted(there - used))


def main() -> int:
    root = Path(sys.argv[1]) if len(sys.argv) > 1 else Path(__file__).resolve().parents[2]
    found = list(findings(root))
    for text in found:
        print(f"docs/REQUIREMENTS.csv: {text}")
    return 1 if found else 0


if __name__ == "__main__":
    sys.exit(main())
