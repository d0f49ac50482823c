"""Long work of the workbench in a process of its own: `python -m kincal.console.job` (work)."""

from __future__ import annotations

import sys
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from kincal.api import case as cases
from kincal.api.fitted import Fitted, fit
from kincal.api.inputs import Arm, Data, checked
from kincal.export.files import Format
from kincal.pages import diagnosis as diagnosis_pages
from kincal.pages import diagnosis_figures, diagnosis_grids
from kincal.pages.page import Grid, Page, Provenance, Section, Tile
from kincal.workbench.diagnosis import Diagnosis
from kincal.workbench.model.effects import Library
from kincal.workbench.numerics.background import second_process
from kincal.workbench.prediction.measurable import Limits
from kincal.workbench.prediction.nextposes import poses_csv
from kincal.workbench.report import explain
from kincal.workbench.report.answers import comparison_text, fit_text, poses_text
from kincal.workbench.report.headline import big_numbers, reachable_number
from kincal_shared.errors import CannotAnswer, KincalError

from . import work
from .document import document

MODEL, POSES = "M.toml", "next_poses.csv"
NEXT = 8  # poses, as `kincal model next`
EXPORTS: tuple[tuple[Format, str], ...] = (
    ("python", "calibrated_arm.py"), ("c", "calibrated_arm.c"), ("dh", "calibrated_dh.toml"),
    ("json", "calibrated_arm.json"), ("urdf", "calibrated_arm.urdf"),
)  # fmt: skip
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
    libraries: tuple[Path, ...] = ()
    alternatives: tuple[str, ...] = ()

    @classmethod
    def of(cls, d: Plain) -> Task:
        """From what standard input says."""
        files = tuple(map(Path, d["data"]))
        return cls(d["what"], d["arm"], files, tuple(d["effects"]), Path(d["out"]), d["date"],
                   tuple(map(Path, d["libraries"])), tuple(d["alternatives"]))  # fmt: skip


def perform(task: Task) -> Plain:
    """The answer. Errors as the functions of kincal.api."""
    arm, data = Arm.load(task.arm), Data.load(*task.data)
    if task.what == "fit":
        return _fit(task, arm, data)
    library = Library.load(*task.libraries)
    case = cases.Case(arm.table, checked(arm, data, force=False), task.effects, library=library)
    if task.what == "next":
        return _next(task, case)
    with second_process() as begin:
        if task.what == "compare":
            found = case.compare(begin)
            tiles = [Tile(n.label, n.text.replace(", ", "\n"), about=n.about) for n in big_numbers(found)]
            origin = Provenance.of_file(task.date, task.data)
            about = f"{found.poses} poses of {found.source}"
            page = Page("Comparison", f"Model against measurements: {found.arm}", about, origin, (), tiles)
            return {"page": document(page), "text": comparison_text(found)}
        diagnosis = case.diagnose(work.progress, begin)
        poses = case.advise(diagnosis)
        content = case.report(diagnosis, poses, work.progress)
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
            "gain": explain.smooth_gain(d.novel),
            "confounded": [],
        }


def _fit(task: Task, arm: Arm, data: Data) -> Plain:
    fitted = fit(arm, data, task.effects, progress=work.progress, effect_files=task.libraries)
    r = fitted.result
    fitted.save(task.out / MODEL)
    files, notes = [MODEL], []
    for form, name in EXPORTS:
        try:
            made = fitted.export(form, task.out / name)
        except (CannotAnswer, KincalError) as error:
            notes.append(f"{name} was not exported: {error}")
            continue
        files += [path.name for path in made.files]
        if made.left_out:
            notes.append(f"{name} does not hold {', '.join(x.effect for x in made.left_out)}.")
    note = " ".join(notes)
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


def _next(task: Task, case: cases.Case) -> Plain:
    """The poses that separate alternatives best, as `kincal model next`."""
    poses = case.separating_poses(task.alternatives, count=NEXT, limits=Limits())
    (task.out / POSES).write_text(poses_csv(poses, case.data.sums), "utf-8")
    rows = [
        [str(k), ", ".join(f"{x:.3f}" for x in p.q), " ".join(f"{x:+d}" for x in p.direction or ()) or "any",
         ", ".join(f"{x:.3f}" for x in p.tool_m), f"{p.power:.2f}"]
        for k, p in enumerate(poses, 1)
    ]  # fmt: skip
    grid = Grid.of("pose|<joints [rad or m]|<approach|<tool [m]|power with the poses above", rows)
    sections = (Section("poses", "Poses to measure", grid=grid),)
    about = f"poses that separate {', '.join(task.alternatives)}"
    page = Page("Next poses", f"{len(poses)} poses to measure next", about,
                Provenance.of_file(task.date, task.data), sections)  # fmt: skip
    return {"page": document(page), "text": poses_text(poses), "files": [POSES]}


def _values(fitted: Fitted) -> Grid:
    rows = [
        [name, f"{value:.6g}", f"{sigma:.2g}", unit]
        for name, (value, sigma, unit) in fitted.parameters.items()
    ]
    return Grid.of("<coefficient|value|1 sigma|<unit", rows)


if __name__ == "__main__":
    sys.exit(work.perform(lambda spec: perform(Task.of(spec))))
