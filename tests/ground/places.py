"""Where things are in this tree."""

from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]
BIN = ROOT / "tables" / "bin"
SRC = ROOT / "tables" / "src"
# Measurements of real arms.
DATA = ROOT / "docs" / "data"
