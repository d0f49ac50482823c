"""Commands of the hidden-effect generator; see the package's own text."""

from __future__ import annotations

import argparse
import json
import sys
from pathlib import Path

import numpy as np

from ..mechanics.spec import load_spec
from . import case, files, kinds
from .seal import BrokenSeal, unseal
from .spec import CaseSpec


def _specs(args: argparse.Namespace) -> list[CaseSpec]:
    if args.plan:
        rows = json.loads(args.plan.read_text())
        return [CaseSpec(**{**row, "effects": tuple(row["effects"])}) for row in rows]
    texts = list(kinds.KINDS) if args.cases == ["all"] else args.cases
    return [
        CaseSpec(
            id=f"c{i:03d}",
            effects=() if text == "none" else tuple(text.split("+")),
            n=args.n,
            seed=args.seed + i,
            size=args.size,
            noise=args.noise,
            outliers=args.outliers,
            sequence="sorted" if args.sorted else "shuffled",
            fixed_pantilt=args.fixed_pantilt,
        )
        for i, text in enumerate(texts)
    ]


def _make(args: argparse.Namespace) -> int:
    specs = _specs(args)
    for spec in specs:  # a misspelling shows before anything is written
        for text in spec.effects:
            kinds.parse(text, spec.size, np.random.default_rng(0))
    args.out.mkdir(parents=True, exist_ok=True)
    (args.out / "arm.toml").write_text(files.arm_toml(load_spec()), encoding="utf-8")
    manifest = [case.make(spec, args.out / spec.id) for spec in specs]
    (args.out / "manifest.json").write_text(json.dumps(manifest, indent=1) + "\n", encoding="utf-8")
    print(f"{len(manifest)} sealed case(s) in {args.out}")
    return 0


def _kinds(_args: argparse.Namespace) -> int:
    for kind in kinds.KINDS.values():
        sizes = ", ".join(f"{s:g}" for s in kind.sigma)
        print(f"{kind.name:18} {kind.about}; sigma {sizes}" + (f"; at {kind.places}" if kind.places else ""))
    return 0


def _open(args: argparse.Namespace) -> int:
    answer = unseal(json.loads(args.file.read_text(encoding="utf-8")))
    del answer["unseen"]
    print(json.dumps(answer, indent=1))
    return 0


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(prog="python -m kincal_sim.hidden", description=__doc__)
    sub = parser.add_subparsers(required=True)
    make = sub.add_parser("make", help="make sealed cases")
    make.add_argument("--out", type=Path, required=True)
    each = "none, all, or effects joined by +: kind, kind[joint] or kind[all], with @sigmas"
    make.add_argument("--cases", nargs="+", default=["none"], metavar="CASE", help=each)
    make.add_argument("--plan", type=Path, help="JSON list of cases instead (fields of CaseSpec)")
    make.add_argument("--n", type=int, default=100)
    make.add_argument("--seed", type=int, default=1)
    make.add_argument("--size", type=float, default=1.5, help="prior sigmas")
    make.add_argument("--noise", type=float, default=1.0, help="true noise over stated noise")
    make.add_argument("--outliers", type=float, default=0.0, help="share of gross errors")
    make.add_argument("--sorted", action="store_true", help="region by region, approached as the arm comes")
    make.add_argument("--fixed-pantilt", action="store_true", help="the camera never turns")
    make.set_defaults(run=_make)
    sub.add_parser("kinds", help="list what can be hidden").set_defaults(run=_kinds)
    opened = sub.add_parser("open", help="break a seal")
    opened.add_argument("file", type=Path)
    opened.set_defaults(run=_open)
    return parser


def main() -> int:
    """The command; exit status 2 for an unknown effect or a broken seal."""
    args = _parser().parse_args()
    try:
        return args.run(args)
    except (kinds.UnknownKind, BrokenSeal) as error:
        print(f"error: {error}", file=sys.stderr)
        return 2


if __name__ == "__main__":
    sys.exit(main())
