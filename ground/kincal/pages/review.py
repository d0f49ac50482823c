"""The page of a proposed correction, and its picture."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from kincal.api.corrected import Corrected, Near
from kincal.pages import image, review_figures
from kincal.pages.page import Cell, Command, Grid, Page, Provenance, Section, Tile, write
from kincal.pages.run_figures import MILLI
from kincal.results import angle_text, chance_text, length_text
from kincal.review import NUMBERS, P_FIT_MIN, CoefLine, Review, poor_fit, reasons_to_reject
from kincal.review.changes import Changes, amount
from kincal.review.journal import SEEN
from kincal.review.residuals import PoseResidual
from kincal.review.status import Choice, Status
from kincal.review.thresholds import DOES_NOT_HOLD, SIGMA_DOES_NOT_HOLD, Limits, Threshold, thresholds

COEF_COLUMNS = "<coefficient|value|1 sigma|value/sigma|<unit|<status|<confounded with"


def page(
    review: Review,
    warnings: list[str],
    provenance: Provenance,
    about: Status,
    limits: Limits | None = None,
    decide: Sequence[Choice] = (),
    changes: Changes | None = None,
    left: Sequence[PoseResidual] = (),
    clearance: Corrected | str = "",
) -> Page:
    """The proposal as a page; warnings: what a reviewer should look at; about: what became of it; decide: the
    commands for that; changes: what it changes; left: what is left at each pose; clearance: with
    the new table, or why it is not known."""
    return Page(
        kind="Review",
        title=f"Correction {review.crc_text}",
        subtitle=f"session {review.session}, {review.n_poses} poses, replaces {review.crc_before:08x}; "
        f"to be right in the frame of the {review.frame}{_ended(review)}",
        provenance=provenance,
        verdict=f"{review.verdict[:1].upper()}{review.verdict[1:]}; {about.state}.",
        summary=[
            *([f"{SIGMA_DOES_NOT_HOLD[:1].upper()}{SIGMA_DOES_NOT_HOLD[1:]}."] if poor_fit(review) else []),
            *([f"{changes.headline}."] if changes else []),
            *_waits(review, about),
            *_look_at(review, warnings),
            *_said(about),
        ],
        commands=[Command(choice.what, choice.command) for choice in decide],
        tiles=_tiles(review),
        sections=[
            *(_changes(changes) if changes else []),
            *near(clearance),
            *_sections(review, about, limits),
            *([_left(left)] if left else []),
        ],
    )


def _ended(review: Review) -> str:
    return f"; measuring ended: {review.ended}" if review.ended else ""


def _left(left: Sequence[PoseResidual]) -> Section:
    """Measured minus model at each pose."""
    rows: list[list[str | Cell]] = [
        [
            f"to {p.pose}" if p.extra else f"{p.pose}",
            f"{p.candidate}",
            ", ".join(map(str, p.tags)),
            f"{p.frames}",
            length_text(p.before_pos_m),
            angle_text(p.before_rot_rad),
            length_text(p.after_pos_m),
            angle_text(p.after_rot_rad),
            Cell("rejected", "bad") if p.rejected else "",
        ]
        for p in left
    ]
    columns = "pose|candidate|<tags|frames|before|before, rotation|after|after, rotation|<in the fit"
    note = (
        "Measured tool pose minus the model, with the table in force and with the proposed values. "
        '"to 7": observed on the way to pose 7.'
    )
    return Section("left", "Residual of each pose", grid=Grid.of(columns, rows, note))


def _changes(c: Changes) -> list[Section]:
    """What changes: each value, and where the tool goes."""
    rows: list[list[str | Cell]] = [
        [
            row.name,
            row.old_text,
            row.new_text,
            Cell(row.delta_text, "bad" if row.big else ""),
            row.share_text,
            row.source,
        ]
        for row in c.rows
    ]
    note = "" if c.old_known else "The table in force is not at hand: changes are those from the nominal arm."
    columns = "<coefficient|old|new ± 1 sigma|change|of its bound|<determined by"
    out = [Section("changes", "What changes", grid=Grid.of(columns, rows, note))]
    if c.tool:
        shifts = [
            [t.place, amount(t.pos_m, "m"), amount(t.rot_rad, "rad")]
            + [amount(x, "m", sign=True) for x in t.vector_m]
            for t in c.tool
        ]
        over = ""
        if c.space:
            over = (
                f"Over the search space: {amount(c.space[0], 'm')} RMS, {amount(c.space[1], 'm')} at most; "
                f"{amount(c.space[2], 'rad')} RMS, {amount(c.space[3], 'rad')} at most. The last row is the "
                "candidate with the largest shift."
            )
        grid = Grid.of("<place|moves|turns|x|y|z", shifts, over)
        out.append(Section("tool", "Where the tool goes", grid=grid))
    pairs = [f"{a} and {b} (correlation {rho:+.3f})" for a, b, rho in c.correlations]
    text = []
    if pairs:
        text.append(f"Barely told apart by these poses: {'; '.join(pairs)}.")
    if c.undetermined:
        text.append(f"Not determined by these poses: {', '.join(c.undetermined)}.")
    if text:
        out.append(Section("undetermined", "What the poses do not determine", " ".join(text)))
    if c.reasons:
        against = [[r.what, r.number, r.threshold] for r in c.reasons]
        out.append(
            Section("against", "What speaks against it", grid=Grid.of("<what|value|<has to be", against))
        )
    return out


def near(found: Corrected | str, new: str = "proposed", table: str = "the new table") -> list[Section]:
    """Clearance and reach with the new table, or why they are not known; new, table: what that table is."""
    if isinstance(found, str):
        return [Section("clearance", "Clearance and reach", f"Not known: {found}")] if found else []
    rows: list[list[str | Cell]] = [
        [
            c.what,
            c.before.text,
            Cell(c.after.text, "bad" if _too_near(c.after, found.margin_m) else ""),
            c.after.where,
            c.before.where,
        ]
        for c in found.clear
    ]
    note = (
        "Least distance of the arm, as each table has it, to itself and to keep-out volumes. It has to be at "
        f"least {length_text(found.margin_m)}: what SPACE {found.space} was verified for on arms with errors "
        f"({length_text(found.nominal_m)} on the nominal arm)."
    )
    columns = f"<where|in force|{new}|<nearest, {new}|<nearest, in force"
    clear = Grid.of(columns, rows, " ".join([note, *found.notes]))
    lost: list[list[str | Cell]] = [
        [
            r.what,
            r.want,
            f"{r.of - len(r.before)} of {r.of}",
            Cell(f"{r.of - len(r.after)} of {r.of}", "bad" if r.lost and not r.passed_over else ""),
            r.lost_text or "none",
        ]
        for r in found.reach
    ]
    reach = Grid.of(f"<poses|<which|in force|{new}|<lost", lost)
    return [
        Section("clearance", f"Clearance with {table}", f"{found.headline}.", grid=clear),
        Section("reach", f"Reach and view with {table}", grid=reach),
    ]


def _too_near(near: Near, margin_m: float) -> bool:
    return near.distance_m is not None and near.distance_m < margin_m


def _waits(r: Review, about: Status) -> list[str]:
    """What flight waits for, where it waits."""
    if not about.waits:
        return []
    text = "Flight waits for a decision; the table in force stays until then."
    if reasons_to_reject(r):
        text += " There are reasons to reject this correction: only an override, with a reason, approves it."
    return [text]


def _look_at(r: Review, warnings: list[str]) -> list[str]:
    reasons = reasons_to_reject(r)
    found = [f"Reason to reject: {w}" if w in reasons else f"Look at: {w}" for w in warnings]
    return found or ["Nothing stands out."]


def _said(about: Status) -> list[str]:
    """What the journal has of it."""
    done = {"arm": "Armed", "approve": "Approved", "reject": "Rejected"}
    return [
        f"Seen by {e.by}, {e.time}"
        if e.decision == SEEN
        else f"{done.get(e.decision, e.decision)} by {e.by}, {e.time}: {e.why}"
        + (f"; override: {e.override}" if e.override else "")
        for e in about.decisions
    ]


def _tiles(r: Review) -> list[Tile]:
    n, same = r.numbers, f"of the same {r.n_poses - r.n_outliers} poses: table in force → proposed"
    position = f"{length_text(n['before_pos_m'])} → {length_text(n['fit_pos_m'])}"
    rotation = f"{angle_text(n['before_rot_rad'])} → {angle_text(n['fit_rot_rad'])}"
    rank_mood = "" if n["rank"] == n["n_free"] else "bad"
    poor = poor_fit(r)
    no_change = DOES_NOT_HOLD if poor else "chance of such an improvement"
    return [
        Tile("position residual RMS", position, about=same),
        Tile("rotation residual RMS", rotation, about=same),
        Tile("rank", f"{n['rank']:.0f} of {n['n_free']:.0f}", rank_mood, "free coefficients"),
        Tile("p of the fit", chance_text(n["p_fit"]), "" if n["p_fit"] >= P_FIT_MIN else "bad",
             f"chance of a fit as bad as this; at least {P_FIT_MIN:g}"),
        Tile("p if nothing changed", chance_text(n["p_no_change"]), "bad" if poor else "", no_change),
        Tile("poses rejected", f"{r.n_outliers} of {r.n_poses}", "bad" if r.n_outliers else ""),
    ]  # fmt: skip


def _sections(r: Review, about: Status, limits: Limits | None) -> list[Section]:
    shown = [c for c in r.coefs if not c.idle]
    rest = len(r.coefs) - len(shown)
    note = f"{rest} masked coefficients at zero are not listed." if rest else ""
    coefs = Grid.of(COEF_COLUMNS, [_coef_row(c) for c in shown], note)
    out = [Section("coefficients", "Coefficients", grid=coefs)]
    if r.estimated:
        drawn = Section("corrections", "Corrections", figure=review_figures.corrections(r), grid=coefs)
        out = [
            drawn,
            Section("correlation", "Correlation of the estimates", figure=review_figures.correlation(r)),
        ]
    return [_numbers(r, limits), _rejected(r, about), *out]


def _numbers(r: Review, limits: Limits | None) -> Section:
    """Every number with what it has to be."""
    asked = thresholds(r, limits)
    rows = [
        [key, _number(key, r.numbers[key], unit), *_asked(asked.get(key)), text]
        for key, unit, text in NUMBERS
    ]
    outliers = [
        "n_outliers",
        f"{r.n_outliers}",
        *_asked(asked.get("n_outliers")),
        "poses rejected by the fit",
    ]
    note = "" if limits is not None else "Without a configuration table some thresholds are unknown."
    grid = Grid.of("<number|value|<threshold|<kept|<meaning", [*rows, outliers], note)
    return Section("numbers", "Numbers and their thresholds", grid=grid)


def _asked(threshold: Threshold | None) -> tuple[str, str | Cell]:
    if threshold is None:
        return "for information", ""
    if not threshold.holds:
        return threshold.text, Cell("no", "bad")
    words = {None: Cell(""), True: Cell("yes", "good"), False: Cell("no", "bad")}
    return threshold.text, words[threshold.kept]


def _rejected(r: Review, about: Status) -> Section:
    title = "Rejected poses"
    if not r.n_outliers and not about.rejected:
        return Section("rejected", title, "None: every pose of the session is in the fit.")
    named = ", ".join(map(str, about.rejected)) or "not in this log"
    text = f"{r.n_outliers} of {r.n_poses} poses are not in the fit. Pose: {named}."
    if not about.exact:
        text += (
            " These were rejected at some time; the log does not say which of them the last fit took back."
        )
    return Section("rejected", title, text)


def _number(key: str, value: float, unit: str) -> str:
    if key.startswith("p_"):
        return chance_text(value)
    if unit == "rad":
        return angle_text(value)
    return length_text(value) if unit == "m" else f"{value:.4g}"


def _coef_row(c: CoefLine) -> list[str]:
    scale, unit = (1e3, MILLI[c.unit]) if c.unit in MILLI else (1.0, c.unit)
    fitted = c.sigma > 0.0
    return [
        c.name,
        f"{c.value * scale:.3f}",
        f"{c.sigma * scale:.3f}" if fitted else "-",
        f"{c.z:+.1f}" if fitted else "-",
        unit,
        c.status,
        ", ".join(c.confounded),
    ]


def write_all(
    review: Review,
    warnings: list[str],
    picture: Path,
    provenance: Provenance,
    about: Status,
    limits: Limits | None = None,
    decide: Sequence[Choice] = (),
    changes: Changes | None = None,
    left: Sequence[PoseResidual] = (),
    clearance: Corrected | str = "",
) -> tuple[list[Path], str]:
    """The page beside the picture (.html), and the picture (.png or .svg) where one can be made.

    Returns the files, and why there is no picture ("" if there is one)."""
    made = page(review, warnings, provenance, about, limits, decide, changes, left, clearance)
    return image.beside([write(made, picture.with_suffix(".html"))], {picture: review_figures.sheet(review)})
