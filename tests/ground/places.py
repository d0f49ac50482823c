"""Where things are in this tree."""

import os
import shutil
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]
BIN = ROOT / "tables" / "bin"
SRC = ROOT / "tables" / "src"
# Measurements of real arms.
DATA = ROOT / "docs" / "data"
CHROMIUM = os.environ.get("KINCAL_CHROMIUM") or shutil.which("chromium")
