"""The notebook of the real arm runs from its first cell to its last, and is small."""

import json
import re
import shutil
from pathlib import Path

import gen_notebook
import pytest
from places import ROOT

pytestmark = pytest.mark.slow
NOTEBOOK = ROOT / "docs" / "WAM.ipynb"


def test_notebook_runs_and_the_effects_predict_poses_that_took_no_part_better(tmp_path):
    """On half of its poses: test_tutorial.py diagnoses all of them."""
    notebook = shutil.copy(NOTEBOOK, tmp_path)
    data = shutil.copytree(NOTEBOOK.parent / "data" / "wam", tmp_path / "data" / "wam") / "wam.csv"
    header, *rows = data.read_text().splitlines(keepends=True)
    data.write_text("".join([header, *rows[::2]]))
    cells = [cell for cell in gen_notebook.executed(Path(notebook)).cells if cell.cell_type == "code"]
    assert all(cell.outputs for cell in cells)
    shown = "".join(output.get("text", "") for cell in cells for output in cell.outputs)
    plain, named = re.search(r"DH alone ([\d.]+) mm, with the effects ([\d.]+) mm", shown).groups()
    assert float(named) < float(plain)
    assert "wam.c wam.h" in shown


def test_notebook_shows_its_outputs_and_is_small():
    assert NOTEBOOK in gen_notebook.NOTEBOOKS
    assert NOTEBOOK.stat().st_size < 200_000
    for cell in json.loads(NOTEBOOK.read_text())["cells"]:
        assert cell["cell_type"] == "markdown" or cell["outputs"]
