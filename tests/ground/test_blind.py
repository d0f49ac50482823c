"""Sealed hidden effects against the workbench, seven of them; `make blind` runs the whole battery."""

import subprocess
import sys
from pathlib import Path

BLIND = Path(__file__).resolve().parent.parent / "bench" / "blind.py"


def test_seven_sealed_cases_meet_the_criteria(tmp_path):
    command = [sys.executable, str(BLIND), "--quick", "--dir", str(tmp_path)]
    done = subprocess.run(command, capture_output=True, text=True, timeout=600)
    print(done.stdout)
    assert done.returncode == 0, done.stdout + done.stderr
