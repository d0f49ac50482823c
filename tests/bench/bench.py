"""How fast is KinCal against other software that does the same?

    python tests/bench/bench.py [--only PART ...] [--problems 20] [--write]

Parts, each measured by all programs in turn, in one run, in one thread:

    kernel      flight's kernel of rotations against geometric_kernels, S3 and SO(3)
    design      a design step (n = 20, 1024 candidates) against numpy + geometric_kernels, scikit-learn
    kinematics  pose and Jacobian of 28 errors of a joint vector against Pinocchio's C++ interface
    detector    the tag detector process against libapriltag alone
    fits        fits and diagnose of the real arms in docs/data against scipy, figaroh
    qp          box QPs against seven solvers (qp.py)

BoTorch and GPyTorch are left out: PyPI has PyTorch for Linux only with CUDA, which is gigabytes.

Processor time is taken, medians over rounds, and flight as it is compiled to fly. Before that results are
compared: a part whose results differ by more than rounding (OFF) ends with status 1. No time does.
--write: tables of docs/BENCHMARKS.md and figures in docs/img; of all parts, in one run."""

from __future__ import annotations

import argparse
import logging
import os
import sys
import warnings
from collections.abc import Iterator

for _name in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"):
    os.environ.setdefault(_name, "1")
logging.disable(logging.INFO)
warnings.simplefilter(
    "ignore", RuntimeWarning
)  # spherical harmonics of high degree, which nothing here asks for

import qp  # noqa: E402
from versus import design, detector, fits, kinematics, report  # noqa: E402
from versus.measure import OURS, Growth, Ratio  # noqa: E402

from kincal.pages.image import NoPictures  # noqa: E402

PARTS = ("kernel", "design", "kinematics", "detector", "fits", "qp")
OFF = {"kernel": 1e-10, "design step": 1e-6, "kinematics": 1e-12, "detector": 1e-9}
"""By part: results that differ by more are not of the same work. The candidates' cache of flight's GP is in
single precision."""
ROUNDS, GROWTH_ROUNDS = 7, 2


def measured(parts: list[str]) -> tuple[list[Ratio], list[Growth]]:
    """Ratios and growths of the parts that have them, said as they come."""
    ratios: list[Ratio] = []
    growths: list[Growth] = []
    if "kernel" in parts:
        ratios += said(design.kernel_ratios(ROUNDS))
        growths.append(design.kernel_growth(GROWTH_ROUNDS))
    if "design" in parts:
        ratios += said(design.step_ratios(ROUNDS))
        growths += design.step_growths(GROWTH_ROUNDS)
    if "kinematics" in parts:
        ratios += said(kinematics.ratios(5 * ROUNDS))
        growths.append(kinematics.by_joints(ROUNDS))
    if "detector" in parts:
        ratios += said(detector.ratios(ROUNDS))
        growths.append(detector.by_pixels(GROWTH_ROUNDS))
    return ratios, growths


def said(found: Iterator[Ratio]) -> Iterator[Ratio]:
    """The same, with a line each on the way."""
    for r in found:
        print(f"{r.part}, {r.case}: {r.other} {report.significant(r.ratio)} times as long", flush=True)
        yield r


def summary(rows: list[fits.Row], solved: list[qp.Row]) -> list[Ratio]:
    """What the figure shows of fits and QPs besides: of QPs the quickest other solver, on the kind on which
    it does best."""
    found = []
    for n in qp.SIZES if solved else ():
        row = min((r for r in solved if r.n == n), key=lambda r: min(fastest(r)))
        ratio, name = min(fastest(row))
        found.append(Ratio("box QP", f"{row.kind}, n = {n}", name, ratio, ratio, ratio, row.seconds, 0.0, ""))
    for row in rows:
        ours_s = row.seconds[OURS]
        for name in (fits.FORMULAS, fits.FIGAROH):
            ratio = row.seconds[name] / ours_s
            found.append(Ratio("fit", row.name, name, ratio, ratio, ratio, ours_s, 0.0, ""))
    return found


def fastest(row: qp.Row) -> list[tuple[float, str]]:
    """Ratios and names of the other solvers."""
    return [(ratio, name) for name, ratio in row.ratio.items() if name != OURS]


def show(lines: list[str]) -> None:
    """A table on the terminal."""
    print("\n".join(lines), end="\n\n", flush=True)


def options(argv: list[str] | None) -> argparse.Namespace:
    """The command line."""
    p = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    p.add_argument("--only", nargs="+", choices=PARTS, default=list(PARTS), metavar="PART")
    p.add_argument("--problems", type=int, default=20, help="QPs of each kind")
    p.add_argument("--write", action="store_true", help="docs/BENCHMARKS.md and its figures")
    o = p.parse_args(argv)
    if o.problems < 1:
        p.error(f"argument --problems: is {o.problems}, must be 1 or more")
    return o


def main(argv: list[str] | None = None) -> int:
    """All parts; exit status as above."""
    o = options(argv)
    if o.write and set(o.only) != set(PARTS):
        print("--write needs all parts: tables and figures show one run", file=sys.stderr)
        return 2
    ratios, growths = measured(o.only)
    rows: list[fits.Row] = []
    if "fits" in o.only:
        rows = list(fits.rows(3))
        growths.append(fits.by_poses(GROWTH_ROUNDS))
    solved: list[qp.Row] = []
    if "qp" in o.only:
        solved = list(qp.rows(o.problems, 1))
        growths.append(qp.by_size(max(5, o.problems // 2), 1))
    tables = {
        "ratios": report.ratio_table(ratios) if ratios else [],
        "fits": report.fit_table(rows) if rows else [],
        "box QP": qp.table(solved) if solved else [],
        "growth": report.growth_table(growths) if growths else [],
    }
    for name, lines in tables.items():
        if lines:
            show(lines)
            if o.write:
                report.put(name, lines)
    if o.write:
        try:
            report.save([*ratios, *summary(rows, solved)], growths, rows)
        except NoPictures as error:
            print(f"no figures: {error}", file=sys.stderr)
    bad = [f"{r.part}, {r.other}" for r in ratios if not r.off <= OFF[r.part]]
    bad += [f"box QP, {r.kind} {r.n}" for r in solved if not r.residual["KinCal"] <= qp.TOL]
    if bad:
        print("results that differ: " + "; ".join(bad))
    return 1 if bad else 0


if __name__ == "__main__":
    sys.exit(main())
