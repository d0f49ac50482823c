"""Long work about search spaces in a process of its own, `python -m kincal.console.spacework` (work): build
and check."""

from __future__ import annotations

import shutil
import sys
from pathlib import Path
from typing import Any

from kincal import space
from kincal.api import spaces
from kincal.link import write_image
from kincal.pages import space as pages
from kincal.pages.page import Grid, Page, Provenance, Section, Tile
from kincal.results import summed

from . import work
from .document import document

TABLE, DESCRIPTION = "space.tbl", "space.toml"
Plain = dict[str, Any]


def build(spec: Plain) -> Plain:
    """The SPACE table of a description, as `kincal space build`. Leaves the table and a copy of its
    description. Errors as kincal.space.build."""
    out, source, tables_dir = Path(spec["out"]), Path(spec["description"]), Path(spec["tables"])
    shutil.copy(source, out / DESCRIPTION)
    built = space.build(space.read_description(source), tables_dir, work.progress, spec["processes"])
    write_image(built.image, out / TABLE)
    origin = Provenance(spec["date"], {"space": built.image.crc_text})
    made, _, _ = pages.of_built(built, tables_dir, origin)
    why = Grid.of("samples|<rejected because", [[str(n), reason] for n, reason in summed(built.rejected)])
    page = Page(made.kind, made.title, made.subtitle, origin,
                (*made.sections, Section("why", "Why samples were rejected", grid=why)))  # fmt: skip
    text = f"{built.table.n_candidates} candidates from {built.n_samples} samples"
    return {"page": document(page), "crc": built.image.crc_text, "text": text}


def check(spec: Plain) -> Plain:
    """A table verified again, as `kincal space check`."""
    tables_dir = Path(spec["tables"])
    image, table = spaces.load(Path(spec["table"]), tables_dir)
    asked = spaces.checks(Path(spec["description"]), tables_dir)
    with space.WorkerPool(asked, spec["processes"]) as pool:
        found = space.recheck(asked, pool, table, work.progress)
    problems = [("table", what) for what in found.node_problems]
    problems += [(f"candidate {i}", what) for i, what in found.problems]
    share = found.contacts / max(found.sampled, 1)
    tiles = [
        Tile("problems", str(len(problems)), "bad" if problems else "good"),
        Tile("candidates verified", str(table.n_candidates)),
        Tile("postures that touch", f"{share:.2%}", about=f"{found.contacts} of {found.sampled} sampled"),
    ]
    verdict = _verdict(found.ok, share)
    sections = [Section("problems", "What does not hold", grid=Grid.of("<of|<what", problems))]
    about = f"{spec['of']}; servo bounds sampled with other random numbers than the search used"
    page = Page("Search space", f"Table {image.crc_text} verified again", about,
                Provenance(spec["date"]), sections if problems else (), tiles, verdict=verdict)  # fmt: skip
    return {"page": document(page), "crc": image.crc_text, "good": found.ok, "text": verdict}


def _verdict(ok: bool, share: float) -> str:
    """In words. share: of the postures inside servo bounds that touch something."""
    if not ok:
        return "It does not hold: do not send it"
    rest = f"; {share:.2%} of the postures inside servo bounds touch, and flight's guard has to refuse them"
    return "It holds" + (rest if share > 0.0 else "")


def _answer(spec: Plain) -> Plain:
    return build(spec) if spec["what"] == "build" else check(spec)


if __name__ == "__main__":
    sys.exit(work.perform(_answer))
