"""Long work of the workbench in a process of its own: `python -m kincal.console.job`.

The first line of standard input says what to do (JSON). Progress comes as a line of JSON each on standard
output, the answer goes to a file. When standard input ends, the console is gone, and so is this process."""

from __future__ import annotations

import json
import os
import signal
import sys
import threading
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from kincal.api import case as cases
from kincal.api.fitted import Fitted, fit
from kincal.api.inputs import Arm, Data, checked
from kincal.pages import diagnosis as diagnosis_pages
from kincal.pages import diagnosis_figures, diagnosis_grids
from kincal.pages.page import Grid, Page, Provenance, Section, Tile
from kincal.workbench.diagnosis import Diagnosis
from kincal.workbench.numerics.background import second_process
from kincal.workbench.report import explain
from kincal.workbench.report.answers import comparison_text, fit_text
from kincal.workbench.report.headline import big_numbers, reachable_number
from kincal_shared.errors import CannotAnswer, KincalError

from .document import document

MODEL, CODE = "M.toml", "calibrated_arm.py"
Plain = dict[str, Any]


@dataclass(frozen=True)
class Task:
    """what: compare, diagnose, fit; out: folder of the answer; date: ISO day."""

    what: str
    arm: str
    data: tuple[Path, ...]
    effects: tuple[str, ...]
    out: Path
    date: str

    @classmethod
    def of(cls, text: str) -> Task:
        """From the first line of standard input."""
        d = json.loads(text)
        files = tuple(map(Path, d["data"]))
        return cls(d["what"], d["arm"], files, tuple(d["effects"]), Path(d["out"]), d["date"])


def perform(task: Task) -> Plain:
    """The answer. Errors as the functions of kincal.api."""
    arm, data = Arm.load(task.arm), Data.load(*task.data)
    if task.what == "fit":
        return _fit(task, arm, data)
    case = cases.Case(arm.table, checked(arm, data, force=False), task.effects)
    with second_process() as begin:
        if task.what == "compare":
            found = case.compare(begin)
            tiles = [Tile(n.label, n.text.replace(", ", "\n"), about=n.about) for n in big_numbers(found)]
            origin = Provenance.of_file(task.date, task.data)
            about = f"{found.poses} poses of {found.source}"
            page = Page("Comparison", f"Model against measurements: {found.arm}", about, origin, (), tiles)
            return {"page": document(page), "text": comparison_text(found)}
        diagnosis = case.diagnose(_say, begin)
        poses = case.advise(diagnosis)
        content = case.report(diagnosis, poses, _say)
        # inside: what the second process works out is asked for when the page is made
        page = diagnosis_pages.page(content, Provenance.of_file(task.date, task.data))
        return {"page": document(page), "text": page.details, "findings": list(_findings(diagnosis))}


def _findings(d: Diagnosis) -> Iterator[Plain]:
    """What can be added to the model, what the diagnosis itself added first."""
    for e in sorted(d.effects, key=lambda e: (not e.in_model, -e.probability)):
        if e.in_model or e.probability >= 0.02:
            yield {
                "name": e.name,
                "label": e.label,
                "found": e.in_model,
                "probability": round(e.probability, 3),
                "gain": explain.held_gain(e.held),
                "confounded": list(e.confounded_with),
            }
    if d.novel is not None:
        yield {
            "name": d.novel.name,
            "label": d.novel.name,
            "found": True,
            "probability": round(d.novel.probability, 3),
            "gain": explain.held_gain(d.novel.held),
            "confounded": [],
        }


def _fit(task: Task, arm: Arm, data: Data) -> Plain:
    fitted = fit(arm, data, task.effects, progress=_say)
    r = fitted.result
    fitted.save(task.out / MODEL)
    files = [MODEL]
    try:
        fitted.export("python", task.out / CODE)
        files.append(CODE)
    except (CannotAnswer, KincalError) as error:
        note = f"No code was exported: {error}"
    else:
        note = ""
    reachable = reachable_number(r.comparison).pos_m
    sections = (
        Section(
            "models", *diagnosis_pages.HEADINGS["models"],
            diagnosis_figures.nested(r.nested, reachable), diagnosis_grids.models(r.nested),
        ),
        Section("values", "Coefficients", grid=_values(fitted)),
    )  # fmt: skip
    block = r.nested.blocks[0]
    errors = [{"model": m.model, "mm": m.pos_m * 1e3} for m in r.nested.of(block)]
    about = f"effects: {', '.join(task.effects) or 'none, DH errors alone'}"
    page = Page("Fit", f"Fitted model: {arm.name}", about, Provenance.of_file(task.date, task.data), sections)
    return {"page": document(page), "text": fit_text(r), "files": files, "errors": errors, "note": note}


def _values(fitted: Fitted) -> Grid:
    rows = [
        [name, f"{value:.6g}", f"{sigma:.2g}", unit]
        for name, (value, sigma, unit) in fitted.parameters.items()
    ]
    return Grid.of("<coefficient|value|1 sigma|<unit", rows)


def _say(what: str, done: int, of: int) -> None:
    print(json.dumps({"what": what, "done": done, "of": of}), flush=True)


def _end_with_the_console() -> None:
    """Once standard input ends, so does this process, and what it started."""
    while sys.stdin.readline():
        pass
    os.killpg(0, signal.SIGKILL)


def main() -> int:
    """The process."""
    task = Task.of(sys.stdin.readline())
    threading.Thread(target=_end_with_the_console, daemon=True).start()
    task.out.mkdir(parents=True, exist_ok=True)
    try:
        answer = {"ok": True, **perform(task)}
    except KincalError as error:
        answer = {"ok": False, "text": str(error)}
    part = task.out / "answer.part"
    part.write_text(json.dumps(answer), "utf-8")
    part.replace(task.out / "answer.json")
    return 0


if __name__ == "__main__":
    sys.exit(main())
