"""Run the notebooks of docs and put what their cells show into them.

    python ground/gen_notebook.py            run, write outputs

A cell runs in docs, as a reader's does; files that it makes go into a folder of its own."""

from __future__ import annotations

import os
from pathlib import Path

import nbformat
from nbclient import NotebookClient

ROOT = Path(__file__).resolve().parent.parent
NOTEBOOKS = sorted((ROOT / "docs").glob("*.ipynb"))
SECONDS = 600  # for one cell


def executed(path: Path) -> nbformat.NotebookNode:
    """The notebook after a run of all its cells; nbclient's CellExecutionError shows the cell that failed."""
    notebook = nbformat.read(path, as_version=4)
    environment = {**os.environ, "OMP_NUM_THREADS": "1"}
    client = NotebookClient(notebook, timeout=SECONDS, kernel_name="python3")
    client.execute(cwd=str(path.parent), env=environment)
    for number, cell in enumerate(notebook.cells):  # the same run gives the same file
        cell["id"] = f"cell-{number}"
        cell.get("metadata", {}).pop("execution", None)
    notebook.metadata.pop("language_info", None)
    return notebook


def main() -> None:
    """Run every notebook and write its outputs."""
    for path in NOTEBOOKS:
        nbformat.write(executed(path), path)
        print(path.relative_to(ROOT), path.stat().st_size, "bytes")


if __name__ == "__main__":
    main()
