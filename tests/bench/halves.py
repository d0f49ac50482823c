"""Is a diagnosis of real poses stable, and silent where there is nothing? Halves, and permuted residuals.

    python tests/bench/halves.py [FOLDER] [--only NAME ...] [--halves 10] [--permutations 20]
                                 [--max-poses N] [--seed 1] [--json FILE]

Sets are found as in real.py. For each set:
- Halves: random halves of the poses are diagnosed on their own. The leading cause of a half is its first
  effect (without joints: a half may see fewer of them), or the unnamed where no effect is in the model. It
  ties with what it lists as confounded, and with effects of the model of which the evidence is as sure (0.9
  counts like more) and whose held-out interval overlaps with its own. The halves agree if one cause leads, or
  ties with what leads, in at least 8 of 10.
- Refuted claims: effects stated with P > 0.9 while the 95 % interval of their held-out ratio lies at or
  above 1. There must be none.
- Permutations: the residuals of the DH fit, shuffled among the poses and put back on what that fit predicts:
  whatever depends on anything is gone. A false claim is an effect accepted, helping or stated with P > 0.9,
  or a verdict of something unnamed. At most 1 of 20 permutations may have one.

Exit 1 if a criterion fails.
"""

import argparse
import json
import os
import sys
import time
from collections import Counter
from dataclasses import asdict, dataclass, replace
from pathlib import Path

for _name in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"):
    os.environ.setdefault(_name, "1")

import numpy as np  # noqa: E402

ROOT = Path(__file__).resolve().parents[2]

from real import DATA, Case, find_sets  # noqa: E402

CLAIM = 0.9
AGREEING = 0.8  # share of the halves
FALSE_CLAIMS = 0.05  # share of the permutations
UNNAMED, NOTHING = "unnamed", "nothing"
INTERRUPTED = 130


@dataclass(frozen=True)
class Half:
    """What one half says: its leading cause, what ties with it, all causes in its model, held-out mm before
    and after, and claims that its own held-out poses refute."""

    leading: str
    ties: tuple[str, ...]
    model: tuple[str, ...]
    before_mm: float
    after_mm: float
    refuted: tuple[str, ...]


@dataclass(frozen=True)
class Outcome:
    """One set: its halves, and the false claims of each permutation that has some."""

    name: str
    poses: int
    halves: tuple[Half, ...]
    permutations: int
    false_claims: tuple[tuple[str, ...], ...]
    seconds: float

    @property
    def cause(self) -> str:
        """The cause that leads most halves, or ties with what leads."""
        counts = Counter(name for half in self.halves for name in {half.leading, *half.ties})
        return max(counts, key=lambda name: (counts[name], name)) if counts else NOTHING

    @property
    def agreeing(self) -> int:
        return sum(self.cause in (half.leading, *half.ties) for half in self.halves)

    @property
    def worse(self) -> int:
        """Halves whose final model predicts held-out poses worse than DH."""
        return sum(half.after_mm > half.before_mm for half in self.halves)

    @property
    def failed(self) -> list[str]:
        """The criteria that are not met."""
        tests = {
            "halves agree": self.agreeing >= AGREEING * len(self.halves),
            "no refuted claim": not any(half.refuted for half in self.halves),
            "never worse than DH": self.worse == 0,
            "permutations silent": len(self.false_claims) <= FALSE_CLAIMS * self.permutations,
        }
        return [name for name, met in tests.items() if not met]


def effect_of(name: str) -> str:
    return name.partition("[")[0]


def half_of(found) -> Half:
    """What a diagnosis of one half says."""
    used = [e for e in found.effects if e.in_model]
    first = found.effects[: 1 if used else 0]
    unnamed = UNNAMED if found.novel is not None else NOTHING
    return Half(
        leading=effect_of(first[0].name) if first else unnamed,
        ties=tuple(sorted({effect_of(n) for e in first for n in (*e.confounded_with, *peers(e, used))})),
        model=tuple(e.name for e in used),
        before_mm=1e3 * found.comparison.rms["held"][0],
        after_mm=1e3 * found.remainder.held_pos_m,
        refuted=tuple(e.name for e in found.effects if e.probability > CLAIM and e.held.interval[0] >= 1.0),
    )


def peers(first, used) -> list[str]:
    """Effects of the model whose evidence is as sure as that of the first, and whose held-out intervals
    overlap with its own."""

    def sure(e):
        return e.role, round(min(e.doubts.evidence, CLAIM), 2)

    low, high = first.held.interval
    return [
        e.name
        for e in used
        if e is not first
        and sure(e) == sure(first)
        and e.held.interval[0] <= high
        and e.held.interval[1] >= low
    ]


def false_claims(found) -> tuple[str, ...]:
    """What a diagnosis claims of residuals that follow nothing."""
    claimed = [e for e in found.effects if e.in_model or e.probability > CLAIM]
    named = [f"{e.name} {e.role} {e.probability:.2f}" for e in claimed]
    return (*named, *([UNNAMED] if found.novel is not None else []))


def permuted(fit, rng):
    """Measurements of a fit with its residuals shuffled among the poses."""
    from scipy.spatial.transform import Rotation

    order = rng.permutation(fit.data.n)
    r = fit.evaluation.r
    expected = fit.model.poses(fit.estimate)
    data = replace(fit.data, p_m=fit.data.p_m - r[:, :3] + r[order, :3])
    if r.shape[1] == 3:
        return data
    turned = Rotation.from_rotvec(r[order, 3:]) * Rotation.from_matrix(expected.R)
    return replace(data, quat_wxyz=turned.as_quat()[:, [3, 0, 1, 2]])


def run_set(case: Case, args: argparse.Namespace) -> Outcome:
    """All halves and permutations of one set."""
    from kincal import workbench as wb

    start = time.monotonic()
    arm, library = wb.read_arm(case.arm), wb.Library.load()
    data = wb.read_measurements(case.data, arm)
    if args.max_poses and data.n > args.max_poses:
        data = data.take(np.arange(args.max_poses))
    rng = np.random.default_rng(args.seed)
    halves = []
    for _ in range(args.halves):
        part = data.take(np.sort(rng.permutation(data.n)[: data.n // 2]))
        halves.append(half_of(wb.diagnose(arm, part, library)))
        print(f"  {case.name} half: {halves[-1]}", flush=True)
    plain = wb.compare(arm, data).fit_all
    silent = [false_claims(wb.diagnose(arm, permuted(plain, rng), library)) for _ in range(args.permutations)]
    claims = tuple(found for found in silent if found)
    for found in claims:
        print(f"  {case.name} permuted: {', '.join(found)}", flush=True)
    seconds = time.monotonic() - start
    return Outcome(case.name, data.n, tuple(halves), args.permutations, claims, seconds)


def line(o: Outcome) -> str:
    return (
        f"{o.name:<12}{o.poses:>6} poses  {o.cause} leads or ties in {o.agreeing}/{len(o.halves)}, "
        f"refuted claims {sum(len(h.refuted) for h in o.halves)}, worse than DH {o.worse}, "
        f"false claims in {len(o.false_claims)}/{o.permutations} permutations  {o.seconds:.0f} s"
        + (f"  FAILED: {', '.join(o.failed)}" if o.failed else "")
    )


def main() -> int:
    raw = argparse.RawDescriptionHelpFormatter
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=raw)
    parser.add_argument("folder", nargs="?", type=Path, default=DATA)
    parser.add_argument("--only", nargs="+", default=[], help="sets whose names contain one of these")
    parser.add_argument("--halves", type=int, default=10)
    parser.add_argument("--permutations", type=int, default=20)
    parser.add_argument("--max-poses", type=int, help="of each set, the first ones (all if absent)")
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--json", type=Path, help="write all findings there")
    args = parser.parse_args()
    cases = [c for c in find_sets(args.folder) if not args.only or any(x in c.name for x in args.only)]
    if not cases:
        print(f"{args.folder}: no set (a .csv with an arm table .toml beside it)", file=sys.stderr)
        return 2
    outcomes: list[Outcome] = []
    try:
        for case in cases:
            outcomes.append(run_set(case, args))
            print(line(outcomes[-1]), flush=True)
            if args.json:
                args.json.write_text(json.dumps([asdict(o) for o in outcomes], indent=1) + "\n")
    except KeyboardInterrupt:
        return INTERRUPTED
    return 1 if any(o.failed for o in outcomes) else 0


if __name__ == "__main__":
    sys.exit(main())
