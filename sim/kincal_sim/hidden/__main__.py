"""Commands of the hidden-effect generator; see the package's own text."""

from __future__ import annotations

import argparse
import json
import sys
from pathlib import Path

import numpy as np

from ..arm import load_spec
from . import case, kinds


def _orders(args) -> list[case.Order]:
    if args.plan:
        return [
            case.Order(**{**row, "effects": tuple(row["effects"])})
            for row in json.loads(args.plan.read_text())
        ]
    texts = list(kinds.KINDS) if args.cases == ["all"] else args.cases
    return [
        case.Order(
            id=f"c{i:03d}",
            effects=() if text == "none" else tuple(text.split("+")),
            n=args.n,
            seed=args.seed + i,
            size=args.size,
            noise=args.noise,
            outliers=args.outliers,
            order="sorted" if args.sorted else "shuffled",
            fixed_head=args.fixed_head,
        )
        for i, text in enumerate(texts)
    ]


def _make(args) -> int:
    orders = _orders(args)
    for order in orders:  # a slip of the pen shows before anything is written
        for text in order.effects:
            kinds.parse(text, order.size, np.random.default_rng(0))
    args.out.mkdir(parents=True, exist_ok=True)
    (args.out / "arm.toml").write_text(case.arm_toml(load_spec()), encoding="utf-8")
    manifest = [case.make(order, args.out / order.id) for order in orders]
    (args.out / "manifest.json").write_text(json.dumps(manifest, indent=1) + "\n", encoding="utf-8")
    print(f"{len(manifest)} sealed case(s) in {args.out}")
    return 0


def _kinds(_args) -> int:
    for kind in kinds.KINDS.values():
        sizes = ", ".join(f"{s:g}" for s in kind.sigma)
        print(f"{kind.name:18} {kind.about}; sigma {sizes}" + (f"; at {kind.places}" if kind.places else ""))
    return 0


def _open(args) -> int:
    answer = case.unseal(json.loads(args.file.read_text(encoding="utf-8")))
    del answer["unseen"]
    print(json.dumps(answer, indent=1))
    return 0


def main() -> int:
    parser = argparse.ArgumentParser(prog="python -m kincal_sim.hidden", description=__doc__)
    sub = parser.add_subparsers(required=True)
    make = sub.add_parser("make", help="make sealed cases")
    make.add_argument("--out", type=Path, required=True)
    each = "none, all, or effects joined by +: kind, kind[joint] or kind[all], with @sigmas"
    make.add_argument("--cases", nargs="+", default=["none"], metavar="CASE", help=each)
    make.add_argument("--plan", type=Path, help="JSON list of cases instead (fields of case.Order)")
    make.add_argument("--n", type=int, default=100)
    make.add_argument("--seed", type=int, default=1)
    make.add_argument("--size", type=float, default=1.5, help="prior sigmas")
    make.add_argument("--noise", type=float, default=1.0, help="true noise over stated noise")
    make.add_argument("--outliers", type=float, default=0.0, help="share of gross errors")
    make.add_argument("--sorted", action="store_true", help="region by region, approach as it comes")
    make.add_argument("--fixed-head", action="store_true", help="the camera never turns")
    make.set_defaults(run=_make)
    sub.add_parser("kinds", help="list what can be hidden").set_defaults(run=_kinds)
    opened = sub.add_parser("open", help="break a seal")
    opened.add_argument("file", type=Path)
    opened.set_defaults(run=_open)
    args = parser.parse_args()
    try:
        return args.run(args)
    except (kinds.UnknownKind, case.BrokenSeal) as error:
        print(f"error: {error}", file=sys.stderr)
        return 2


if __name__ == "__main__":
    sys.exit(main())
