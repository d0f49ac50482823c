"""Are the probabilities of real findings what they say? Poses that no diagnosis saw judge its claims.

    python tests/bench/claims.py [FOLDER] [--only NAME ...] [--quarters 20] [--sizes 18 25 40 60 100]
                                 [--seed 1] [--out FILE]

Sets are found as in real.py. Of each set a random quarter is kept away, again and again; the rest is
diagnosed, and random parts of the rest with few poses. Of every named effect that the diagnosis gives a
probability, and of every effect of its final model, the ratio of the RMS position error of the poses kept
away is measured with over without it, everything fitted to the diagnosed poses: the final model with and
without it. Of a part all poses outside it judge, 300 at most.

The table: stated probability against the share of claims that helped (ratio below 1) and that harmed (above
1.02), all sets pooled. An effect that helps need not be what its name says: shares may exceed what is stated.
Of the claims with P >= 0.9 at most 5 % may harm.

Each diagnosis is a line of FILE (default build/claims.jsonl) as soon as it is done; a second start goes on
from there as long as the sources are the same. Exit 1 if the criterion fails or a diagnosis ended with an
error."""

import argparse
import hashlib
import json
import os
import sys
import time
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

for _name in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"):
    os.environ.setdefault(_name, "1")

import numpy as np  # noqa: E402

ROOT = Path(__file__).resolve().parents[2]

from real import DATA, Case, find_sets  # noqa: E402

SURE = 0.9
HARM = 1.02
HARMFUL = 0.05  # share of the sure claims
SIZES = (18, 25, 40, 60, 100)
MOST_AWAY = 300
BINS = (0.0, 0.05, 0.2, 0.5, 0.8, SURE, 1.01)
INTERRUPTED = 130


@dataclass(frozen=True)
class Asked:
    """One diagnosis: of a set, which quarter is kept away, how many of the other poses (None: all)."""

    name: str
    quarter: int
    size: int | None
    seed: int

    @property
    def key(self) -> list[object]:
        return [self.name, self.quarter, self.size, self.seed]


def parts(n: int, asked: Asked) -> tuple[np.ndarray, np.ndarray] | None:
    """Poses to diagnose and poses that judge, of n; None where the others are too few for a part."""
    rng = np.random.default_rng([asked.seed, asked.quarter])
    order = rng.permutation(n)
    away, rest = order[: n // 4], order[n // 4 :]
    if asked.size is None:
        return np.sort(rest), np.sort(away)
    if asked.size >= len(rest):
        return None
    away = np.concatenate([away, rest[asked.size :]])[:MOST_AWAY]
    return np.sort(rest[: asked.size]), np.sort(away)


def claims_of(found, away) -> list[dict]:
    """Every finding with what it does to poses that were kept away."""
    return [claim(e, found, away) for e in found.effects]


def claim(e, found, away) -> dict:
    """One finding: the final model with and without its effect, on poses that were kept away."""
    from kincal.workbench.fit.least_squares import fit_model, rms

    near, final = found.comparison.fit_all, found.final
    frames, start = (near.base, near.tool), dict(zip(near.names, near.estimate, strict=True))
    others = [h for h in final.hypotheses if h.name != e.name]

    def left(hypotheses):  # begun where the diagnosis begins its fits
        fit = fit_model(near.arm, near.data, hypotheses, frames=frames, start=start) if hypotheses else near
        return rms(fit.predict(away))

    (before, turned), (after, turned_after) = left(others), left([*others, e.hypothesis])
    return {
        "name": e.name,
        "role": e.role,
        "probability": e.probability,
        "evidence": e.doubts.evidence,
        "support": e.doubts.support,
        "identity": e.doubts.identity,
        "held": e.held.after_m / e.held.before_m if e.held.before_m else None,
        "ratio": after / before,
        "rotation_ratio": None if turned is None or turned_after is None else turned_after / turned,
    }


def answer(case: Case, asked: Asked) -> dict:
    """A diagnosis and its claims, as a line; the row of its error if there is one."""
    from kincal import workbench as wb
    from kincal_shared.errors import CannotAnswer

    row: dict = {"asked": asked.key}
    arm, library = wb.read_arm(case.arm), wb.Library.load()
    data = wb.read_measurements(case.data, arm)
    chosen = parts(data.n, asked)
    if chosen is None:
        return row | {"skipped": "too few poses"}
    part, away = (data.take(some) for some in chosen)
    start = time.monotonic()
    try:
        found = wb.diagnose(arm, part, library)
    except CannotAnswer as error:
        return row | {"skipped": str(error)}
    except Exception as error:
        return row | {"error": f"{type(error).__name__}: {error}"}
    return row | {
        "poses": part.n,
        "verdict": found.verdict,
        "adequate": found.adequate_after,
        "seconds": time.monotonic() - start,
        "claims": claims_of(found, away),
    }


# ----------------------------------------------------------------------------------------------- the run


def fingerprint() -> str:
    """Of the sources that answers come from."""
    digest = hashlib.sha256(Path(__file__).read_bytes())
    for path in sorted((ROOT / "ground" / "kincal" / "workbench").rglob("*.*")):
        if path.suffix != ".pyc":
            digest.update(path.read_bytes())
    return digest.hexdigest()


def wanted(cases: list[Case], args: argparse.Namespace) -> Iterator[tuple[Case, Asked]]:
    """All diagnoses, quarter by quarter, so that a run that is stopped has some of each set."""
    for quarter in range(args.quarters):
        for size in (*args.sizes, None):
            for case in cases:
                yield case, Asked(case.name, quarter, size, args.seed)


def run(cases: list[Case], args: argparse.Namespace) -> list[dict]:
    """All lines, those of an earlier run of the same sources too."""
    path, mark = args.out, json.dumps({"of": fingerprint()})
    path.parent.mkdir(parents=True, exist_ok=True)
    lines = path.read_text().splitlines() if path.exists() else []
    if not lines or lines[0] != mark:
        lines = [mark]
        path.write_text(f"{mark}\n")
    known = {json.dumps(row["asked"]): row for row in map(json.loads, lines[1:])}
    rows = []
    with path.open("a") as file:
        for case, asked in wanted(cases, args):
            key = json.dumps(asked.key)
            if key not in known:
                known[key] = answer(case, asked)
                file.write(json.dumps(known[key]) + "\n")
                file.flush()
                print(line(known[key]), file=sys.stderr, flush=True)
            rows.append(known[key])
    return rows


def line(row: dict) -> str:
    name, quarter, size, _ = row["asked"]
    start = f"{name:<10} quarter {quarter:<3}{'all' if size is None else size:>4}"
    if "claims" not in row:
        return f"{start}  {row.get('error') or row['skipped']}"
    shown = [c for c in row["claims"] if c["probability"] >= BINS[1]]
    said = ", ".join(f"{c['name']} {c['probability']:.2f} ({c['ratio']:.3f})" for c in shown)
    return f"{start} {row['seconds']:6.1f} s  {said or row['verdict']}"


# --------------------------------------------------------------------------------------------- the table


def claims_in(rows: list[dict]) -> list[dict]:
    return [c for row in rows for c in row.get("claims", ())]


def harmful(claims: list[dict]) -> list[dict]:
    """Sure claims that harm poses they were kept away from."""
    return [c for c in claims if c["probability"] >= SURE and c["ratio"] > HARM]


def table(rows: list[dict]) -> list[str]:
    """Stated probability against what came true, and the sure claims by number of poses."""
    claims = claims_in(rows)
    out = ["stated         mean   helped  harmed  claims"]
    for low, high in zip(BINS, BINS[1:], strict=False):
        some = [c for c in claims if low <= c["probability"] < high]
        if some:
            out.append(f"{low:.2f} to {min(high, 1.0):.2f}  {shares(some)}")
    for size in dict.fromkeys(row["asked"][2] for row in rows):
        some = [c for c in claims_in([r for r in rows if r["asked"][2] == size]) if c["probability"] >= SURE]
        if some:
            out.append(f"P >= {SURE}, {'all poses' if size is None else f'{size} poses'}: {shares(some)}")
    return out


def shares(claims: list[dict]) -> str:
    mean = np.mean([c["probability"] for c in claims])
    helped, harmed = (
        np.mean(x) for x in zip(*[(c["ratio"] < 1, c["ratio"] > HARM) for c in claims], strict=True)
    )
    return f"{mean:7.2f} {helped:8.2f} {harmed:7.2f} {len(claims):7}"


def failures(rows: list[dict]) -> list[str]:
    """The criteria that are not met."""
    claims = claims_in(rows)
    sure, harm = [c for c in claims if c["probability"] >= SURE], harmful(claims)
    found = [f"{line(row)}" for row in rows if "error" in row]
    if len(harm) > HARMFUL * len(sure):
        names = ", ".join(f"{c['name']} {c['ratio']:.3f}" for c in harm)
        found.append(f"{len(harm)} of {len(sure)} claims with P >= {SURE} harm: {names}")
    return found


def main() -> int:
    raw = argparse.RawDescriptionHelpFormatter
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=raw)
    parser.add_argument("folder", nargs="?", type=Path, default=DATA)
    parser.add_argument("--only", nargs="+", default=[], help="sets whose names contain one of these")
    parser.add_argument("--quarters", type=int, default=20)
    parser.add_argument(
        "--sizes", type=int, nargs="*", default=list(SIZES), help="poses of parts of the rest"
    )
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--out", type=Path, default=ROOT / "build" / "claims.jsonl")
    args = parser.parse_args()
    cases = [c for c in find_sets(args.folder) if not args.only or any(x in c.name for x in args.only)]
    if not cases:
        print(f"{args.folder}: no set (a .csv with an arm table .toml beside it)", file=sys.stderr)
        return 2
    try:
        rows = run(cases, args)
    except KeyboardInterrupt:
        return INTERRUPTED
    print("\n".join(table(rows)))
    failed = failures(rows)
    print("\n".join(f"FAILED: {text}" for text in failed) or "all criteria are met")
    return 1 if failed else 0


if __name__ == "__main__":
    sys.exit(main())
