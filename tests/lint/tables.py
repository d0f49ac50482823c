"""tables/bin is what tables/src says: builds the sources again and compares field by field.

    tables.py [--src DIR] [--bin DIR]

Real numbers may differ in the last digits, because numpy's exp does between CPUs; everything else, and the
list of tables, must be equal. Needs the Python environment and the flight core (make core).
"""

import argparse
import sys
import tempfile
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]
REL_TOL = 1e-9
ABS_TOL = 1e-15  # spectral weights run down to where they no longer matter


def same(a: object, b: object) -> bool:
    if isinstance(a, float) and isinstance(b, float):
        return abs(a - b) <= max(ABS_TOL, REL_TOL * max(abs(a), abs(b)))
    return a == b


def main() -> int:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--src", type=Path, default=ROOT / "tables/src")
    parser.add_argument("--bin", type=Path, default=ROOT / "tables/bin")
    args = parser.parse_args()

    from click.testing import CliRunner

    from kincal import tables
    from kincal.cli import main as kincal

    faults = []
    with tempfile.TemporaryDirectory() as fresh:
        built = CliRunner().invoke(kincal, ["table", "build", str(args.src), fresh])
        if built.exit_code:
            print(built.output)
            return 1
        want, have = ({p.name for p in Path(d).glob("*.tbl")} for d in (fresh, args.bin))
        faults += [f"{name}: not built" for name in sorted(want - have)]
        faults += [f"{name}: has no source" for name in sorted(have - want)]
        for name in sorted(want & have):
            off = [c for c in tables.diff(args.bin / name, Path(fresh, name))[2] if not same(c.a, c.b)]
            if off:
                faults.append(
                    f"{name}: {len(off)} fields differ, first {off[0].path}: {off[0].a}, source: {off[0].b}"
                )
    for fault in faults:
        print(f"{args.bin.name}/{fault}: run `make tables`")
    return 1 if faults else 0


if __name__ == "__main__":
    sys.exit(main())
