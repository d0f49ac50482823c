"""Every set of measurements in a folder: what the model leaves, what the diagnosis names, what it gains.

    python tests/bench/real.py [FOLDER] [--only NAME ...] [--json FILE] [--max-poses N]

A set is a .csv with the arm table (.toml) beside it: each sub-folder holds one or more of both. Of several
arm tables a set takes the one with as many joints and the most similar name. A file X_random.csv is no set:
the models fitted to X.csv predict it, in rows of its own.

All figures are position RMS [mm], with orientations also rotation RMS [mrad] (0.95/2.7). Nominal: fitted
poses, base and tool frame fitted only; DH, named, unnamed: held-out poses with DH errors, then with the
effects that the diagnosis put into the model, then with the unnamed terms that it proposes; reachable: what a
black box predicts of the rest; noise: the noise floor. Names: `name P` an accepted effect, `+name` one that
only predicts better (no probability speaks for it), `? place by drivers P` something unnamed. Of a file that
the models of a set predict: the mean of the named model's residuals, a shift between the two sessions, and
the effects of the first session, without which it is predicted.

Each set runs in a process of its own: whatever happens in it, it gives a row. Exit 1 if a set has none but an
error. Uses the public library only.
"""

import argparse
import json
import multiprocessing
import os
import re
import sys
import time
import tomllib
from dataclasses import asdict, dataclass, field
from multiprocessing.connection import Connection
from pathlib import Path

for _name in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"):
    os.environ.setdefault(_name, "1")

import numpy as np  # noqa: E402

ROOT = Path(__file__).resolve().parents[2]
DATA = ROOT / "docs" / "data"

JUDGING = "_random"
INTERRUPTED = 130

PosRot = tuple[float | None, float | None]
"""RMS position [mm] and rotation [mrad]; None where there is no number."""
NONE: PosRot = (None, None)


# ------------------------------------------------------------------------------------------------ the sets


@dataclass(frozen=True)
class Case:
    """One set: its name, measurements, arm table, and the files that its models predict."""

    name: str
    data: Path
    arm: Path
    judging: tuple[Path, ...] = ()


def find_sets(folder: Path) -> list[Case]:
    """The sets of a folder and its sub-folders, by name."""
    places = [folder, *(p for p in sorted(folder.rglob("*")) if p.is_dir())]
    return [case for place in places for case in sets_of(place)]


def sets_of(folder: Path) -> list[Case]:
    """The sets of one folder: no table of an arm, no set."""
    files = sorted(folder.glob("*.csv"))
    stems = {path.stem for path in files}
    judging = [path for path in files if path.stem.removesuffix(JUDGING) in stems - {path.stem}]
    arms = [path for path in sorted(folder.glob("*.toml")) if not is_other_table(path)]
    mains = [path for path in files if path not in judging] if arms else []
    return [
        Case(name_of(main), main, arm_of(main, arms), tuple(j for j in judging if belongs(j, main)))
        for main in mains
    ]


def belongs(judging: Path, main: Path) -> bool:
    return judging.stem == main.stem + JUDGING


def name_of(data: Path) -> str:
    """The file's name, after its folder's where it does not begin with that."""
    folder = data.parent.name
    return data.stem if data.stem.startswith(folder) else f"{folder}/{data.stem}"


def read_toml(path: Path) -> dict[str, object]:
    """A TOML file; {} if it is none (the workbench says what is wrong with it)."""
    try:
        return tomllib.loads(path.read_text())
    except (OSError, ValueError):
        return {}


def is_other_table(path: Path) -> bool:
    """A readable TOML file that is no arm table: a data map, a model file."""
    content = read_toml(path)
    return bool(content) and "joint" not in content


def arm_of(data: Path, arms: list[Path]) -> Path:
    """The arm table of a set: as many joints, then the most similar name."""
    joints = joints_of(data)

    def fits(arm: Path) -> tuple[bool, int]:
        listed = read_toml(arm).get("joint")
        same = isinstance(listed, list) and len(listed) == joints
        return same, len(os.path.commonprefix([arm.stem.lower(), data.stem.lower()]))

    return max(arms, key=fits)


def joints_of(data: Path) -> int:
    """Columns q1, q2 ... of the header."""
    with data.open(encoding="utf-8", errors="replace") as file:
        header = next((line for line in file if line.strip() and line[0] != "#"), "")
    return len(re.findall(r"(?<![a-z])q\d+\b", header))


# ------------------------------------------------------------------------------------------------- a row


@dataclass(frozen=True)
class Row:
    """What one set (or, judged: a file that its models predict) gives. names: (name, role, probability);
    smooth: the unnamed effects that were added; seconds: of the diagnosis; verdict: its kind,
    judged: the effects that only hold for the session that was fitted; offset_mm: judged: the one shift of
    all positions that the named model leaves; error: why there are no figures."""

    name: str
    poses: int = 0
    nominal: PosRot = NONE
    dh: PosRot = NONE
    named: PosRot = NONE
    unnamed: PosRot = NONE
    reachable: PosRot = NONE
    reachable_by: list[tuple[str, str]] = field(default_factory=list)
    noise: PosRot = NONE
    noise_source: str = ""
    verdict: str = ""
    names: list[tuple[str, str, float]] = field(default_factory=list)
    smooth: list[str] = field(default_factory=list)
    seconds: float = 0.0
    judged: bool = False
    offset_mm: float | None = None
    error: str = ""


def mm(pair: tuple[float | None, float | None] | None) -> PosRot:
    """Millimetres and milliradians of metres and radians."""
    if pair is None:
        return NONE
    position, rotation = (None if x is None or not np.isfinite(x) else 1e3 * float(x) for x in pair)
    return position, rotation


def run_set(case: Case, most: int | None) -> list[Row]:
    """The row of a set and those of the files that it is judged by. Raises what the workbench raises."""
    from kincal import workbench as wb

    start = time.monotonic()
    arm = wb.read_arm(case.arm)
    data = wb.read_measurements(case.data, arm)
    if most is not None and data.n > most:
        data = data.take(np.linspace(0, data.n - 1, most).astype(int))
    found = wb.diagnose(arm, data, wb.Library.load())
    seconds = time.monotonic() - start
    added = wb.add_unnamed_to(found)
    row = row_of(case.name, found, added, seconds)
    return [row, *(try_judged(path, found, added, arm) for path in case.judging)]


def row_of(name, found, added, seconds: float) -> Row:
    """Figures of a diagnosis, and of the unnamed effects added to it."""
    before, left = found.comparison, found.remainder
    reachable = before.reachable
    return Row(
        name=name,
        poses=before.poses,
        nominal=mm(before.rms["nominal"]),
        dh=mm(before.rms["held"]),
        named=mm((left.held_pos_m, left.held_rot_rad)),
        unnamed=mm((added.held_pos_m, added.held_rot_rad)),
        smooth=[str(step.effect.name) for step in added.steps],
        reachable=NONE if reachable is None else mm((reachable.pos_m, reachable.rot_rad)),
        reachable_by=[] if reachable is None else list(reachable.parts),
        noise=mm((before.noise_floor.pos_m, before.noise_floor.rot_rad)),
        noise_source=before.noise_floor.source,
        verdict=found.verdict,
        names=names_of(found),
        seconds=seconds,
    )


def names_of(found) -> list[tuple[str, str, float]]:
    """Effects of the final model and, last, what has no name."""
    used = [e for e in found.effects if e.role != "alternative"]
    named = [(e.name, e.role, e.probability) for e in used]
    if found.novel is None:
        return named
    place = f"{found.novel.location} by {', '.join(found.novel.depends_on)}"
    return [*named, (place, "unnamed", found.novel.probability)]


def try_judged(path: Path, found, added, arm) -> Row:
    """`judged`, or the row of its error: the set keeps its own row."""
    try:
        return judged(path, found, added, arm)
    except Exception as error:
        return Row(path.stem, judged=True, error=f"{type(error).__name__}: {error}")


def judged(path: Path, found, added, arm) -> Row:
    """The models of a diagnosis, fitted to all poses, on the poses of another file; with unnamed effects
    fitted to the fit poses."""
    from kincal import workbench as wb
    from kincal.workbench.fit.least_squares import fit_model, rms

    data = wb.read_measurements(path, arm)
    plain, final = found.comparison.fit_all, found.final
    rigid = fit_model(arm, plain.data, dh=False, frames=(plain.base, plain.tool))
    fits = (rigid, plain, final, added.fit)
    left = [fit.predict(data) for fit in fits]
    nominal, dh, named, unnamed = (mm(rms(r)) for r in left)
    offset_mm = 1e3 * float(np.linalg.norm(left[2][:, :3].mean(axis=0)))
    return Row(
        path.stem,
        data.n,
        nominal,
        dh,
        named,
        unnamed,
        verdict=", ".join(final.of_session),
        judged=True,
        offset_mm=offset_mm,
    )


# ------------------------------------------------------------------------------------------- one process each


def try_set(case: Case, most: int | None, out: Connection) -> None:
    """Rows of a set, or the row of its error, sent to `out`."""
    try:
        rows = run_set(case, most)
    except KeyboardInterrupt:
        return
    except Exception as error:
        rows = [Row(case.name, error=f"{type(error).__name__}: {error}")]
    out.send(rows)


def rows_of(case: Case, most: int | None) -> list[Row]:
    """Rows of a set, computed in a process of its own."""
    spawn = multiprocessing.get_context("spawn")
    here, there = spawn.Pipe(duplex=False)
    process = spawn.Process(target=try_set, args=(case, most, there))
    start = time.monotonic()
    process.start()
    there.close()
    try:
        rows = here.recv()
    except EOFError:  # the process died without a word
        process.join()
        rows = [Row(case.name, error=f"its process ended with status {process.exitcode}")]
    process.join()
    return [Row(**{**asdict(r), "seconds": time.monotonic() - start}) if r.error else r for r in rows]


# ----------------------------------------------------------------------------------------------- the table

COLUMNS = ("nominal", "dh", "named", "unnamed", "reachable", "noise")
TITLES = ("nominal", "DH", "named", "unnamed", "reachable", "noise")
NAME_WIDTH = 22


def heading() -> str:
    figures = "".join(f"{title:>14}" for title in TITLES)
    return f"{'set':<{NAME_WIDTH}}{'poses':>6}{figures}{'s':>7}  names"


def line(row: Row) -> str:
    """One line of the table."""
    start = f"{'  ' * row.judged + row.name:<{NAME_WIDTH}}{row.poses or '-':>6}"
    if row.error:
        return f"{start}  {row.error}" + ("" if row.judged else f" ({row.seconds:.0f} s)")
    figures = "".join(f"{figure(getattr(row, key)):>14}" for key in COLUMNS)
    seconds = f"{'':>7}" if row.judged else f"{row.seconds:7.1f}"
    return f"{start}{figures}{seconds}  {judged_text(row) if row.judged else names_text(row)}".rstrip()


def figure(pair: PosRot) -> str:
    """0.951/2.70, or - without a number."""
    position, rotation = pair
    if position is None:
        return "-"
    return f"{position:.3f}" + ("" if rotation is None else f"/{rotation:.2f}")


def judged_text(row: Row) -> str:
    """What a session has of its own: an offset of all positions, and effects that did not predict it."""
    offset = [] if row.offset_mm is None else [f"all positions off by {row.offset_mm:.3f} mm"]
    return ", ".join([*offset, *([f"without {row.verdict}"] if row.verdict else [])])


def names_text(row: Row) -> str:
    marks = {"accepted": "", "helps": "+", "unnamed": "? "}
    named = [f"{marks[role]}{name}" + (f" {p:.2f}" if role != "helps" else "") for name, role, p in row.names]
    return ", ".join(named) or row.verdict


def run(cases: list[Case], most: int | None, json_path: Path | None) -> list[Row]:
    """All sets, a line as soon as one is done; the JSON file always holds what is there."""
    rows: list[Row] = []
    print(heading(), flush=True)
    for case in cases:
        new = rows_of(case, most)
        print("\n".join(map(line, new)), flush=True)
        rows += new
        if json_path:
            json_path.write_text(json.dumps([asdict(row) for row in rows], indent=1) + "\n")
    return rows


def main() -> int:
    raw = argparse.RawDescriptionHelpFormatter
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=raw)
    parser.add_argument("folder", nargs="?", type=Path, default=DATA)
    parser.add_argument("--only", nargs="+", default=[], help="sets whose names contain one of these")
    parser.add_argument("--json", type=Path, help="write all figures there")
    parser.add_argument("--max-poses", type=int, help="of each set, evenly spread (all if absent)")
    args = parser.parse_args()
    cases = [c for c in find_sets(args.folder) if not args.only or any(x in c.name for x in args.only)]
    if not cases:
        print(f"{args.folder}: no set (a .csv with an arm table .toml beside it)", file=sys.stderr)
        return 2
    try:
        rows = run(cases, args.max_poses, args.json)
    except KeyboardInterrupt:
        return INTERRUPTED
    return 1 if any(row.error for row in rows) else 0


if __name__ == "__main__":
    sys.exit(main())
