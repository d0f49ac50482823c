"""Where the measurements of real arms are."""

from pathlib import Path

DATA = Path(__file__).resolve().parents[2] / "docs" / "data"
