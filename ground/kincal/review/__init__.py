"""Ground review of a proposed correction: see it, question it, approve or reject it, and keep a record.

Approval is two commands, both bound to the CRC of the proposed table (decisions.py). Every decision is one
line in an append-only journal (journal.py)."""

from __future__ import annotations

import dataclasses
import datetime
import re
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from kincal.flight import Terms, library
from kincal.flight.tables import decode_as, encode
from kincal.link import crc_text, estimated_sigma, read_log, unpack_covariance, unsigned32
from kincal.link.names import (
    VERDICTS,
    coef_status_name,
    ended_text,
    frame_name,
    tested_early,
    verdict_name,
)
from kincal.tables import unit_of
from kincal_shared.errors import BadInput
from kincal_shared.keys import Key, Signer
from kincal_shared.letters import unseen

from . import journal as journals
from .journal import Entry as Entry

KIN_KIND = 4
_U64 = (1 << 64) - 1
_MOST_NAME, _MOST_WORDS = 200, 20_000  # characters
_SAME_VARIANCE = 1e-6  # of a variance: rounding of its root
_NAMED = 4  # damaged fields that an error names
P_FIT_MIN = 1e-3  # below it the fit does not explain the data


@dataclass(frozen=True)
class CoefLine:
    """One coefficient of a proposal."""

    name: str
    unit: str
    status: str
    value: float
    sigma: float  # 0 where not estimated
    confounded: tuple[str, ...]  # coefficients it cannot be distinguished from

    @property
    def z(self) -> float:
        """Size in sigmas; 0 where not estimated."""
        return self.value / self.sigma if self.sigma > 0.0 else 0.0

    @property
    def idle(self) -> bool:
        """Masked and zero: not worth a line."""
        return self.status == "masked" and self.value == 0.0


@dataclass(frozen=True)
class Review:
    """Everything a reviewer needs of one proposal, as plain values."""

    crc: int
    session: int
    verdict: str
    frame: str  # where it has to be right: "camera", "lander"
    n_poses: int
    n_outliers: int
    coefs: tuple[CoefLine, ...]
    correlation: np.ndarray  # of the estimated coefficients, in order
    numbers: dict[str, float]
    crc_before: int
    ended: str  # why the calibration stopped measuring; "" if flight did not say
    tested_early: bool  # its end says that the table in force may have been tested twice
    crc_arm: int  # tables that it was made with; 0: not known
    crc_terms: int
    against: tuple[str, ...] = ()  # reasons to reject it that its numbers do not show: clearance

    @property
    def crc_text(self) -> str:
        """CRC of the proposed KIN table, eight hex digits."""
        return f"{self.crc:08x}"

    @property
    def changes_something(self) -> bool:
        """Whether flight proposes a change."""
        return self.verdict == VERDICTS["CHANGE"]

    @property
    def estimated(self) -> tuple[CoefLine, ...]:
        """Coefficients that the fit determined."""
        return tuple(c for c in self.coefs if c.sigma > 0.0)


NUMBERS = (
    ("rank", "", "directions that the data determine"),
    ("n_free", "", "coefficients asked for"),
    ("dof", "", "degrees of freedom"),
    ("chi2", "", "chi square of the fit"),
    ("noise_scale", "", "fitted noise over stated noise"),
    ("p_fit", "", "chance of a fit as bad as this"),
    ("p_no_change", "", "chance of so large a change if the active table were right"),
    ("cond", "", "condition of the scaled Jacobian"),
    ("kkt", "", "KKT residual of the last QP"),
    ("before_pos_m", "m", "RMS position residual with the table in force, rejected poses left out"),
    ("before_rot_rad", "rad", "RMS rotation residual with the table in force, rejected poses left out"),
    ("fit_pos_m", "m", "RMS position residual of the same poses with the proposed values"),
    ("fit_rot_rad", "rad", "RMS rotation residual of the same poses with the proposed values"),
    ("pred_pos_m", "m", "predicted position error over the search space, in the frame it has to be right in: "
     "of the noise and of camera, mast and tags as CAMERA states them"),
    ("pred_rot_rad", "rad", "predicted rotation error over the search space, in that frame"),
    ("confidence", "", "probability that the error is within the bounds that follow; 0: they are RMS"),
    ("bound_pos_m", "m", "bound of the position error over the search space, RMS"),
    ("bound_rot_rad", "rad", "bound of the rotation error"),
    ("n_checked", "", "poses in a row that were predicted as well as required; 0: nothing is required"),
    ("pred_camera_pos_m", "m", "position, camera's frame: against where the camera sees the tool"),
    ("pred_camera_rot_rad", "rad", "rotation, camera's frame"),
    ("pred_lander_pos_m", "m", "position, lander's frame: the base frame of the arm"),
    ("pred_lander_rot_rad", "rad", "rotation, lander's frame"),
    ("pred_noise_pos_m", "m", "position, by the noise of the detections alone: the part of pred_pos_m that "
     "each pose reports as predicted sigma"),
    ("pred_noise_rot_rad", "rad", "rotation, by the noise of the detections alone"),
)  # fmt: skip
OF_A_GOOD_FIT = frozenset(
    (
        "p_no_change",
        "confidence",
        "n_checked",
        *(key for key, _u, _t in NUMBERS if key[:5] in ("pred_", "bound")),
    )
)
"""Numbers that are made from the covariance: they hold only where the model explains the data."""


def from_message(p: Any, names: list[str]) -> Review:
    """Plain values of a proposal_t; names: of the coefficients, from the terms table. BadInput if one of them
    is no finite number: flight sends none; or if they are not those of the correction that it names."""
    n = p.n_coef
    if damaged := _not_finite(p):
        raise BadInput(
            f"the proposal is damaged, these are no finite numbers: {', '.join(damaged[:_NAMED])}",
            f"correction {unsigned32(p.crc):08x}",
            "take the log from the recorder again; do not decide by this one",
        )
    if (made := kin_crc(p)) != unsigned32(p.crc):
        raise BadInput(
            f"these are not the values of the correction that it names: they make table {made:08x}",
            f"correction {unsigned32(p.crc):08x}",
            "do not decide by this message: it was changed on the way, or somebody else sends on this "
            "network. `kincal table dump proposal` brings the values that an approval would put in force",
        )
    names = [names[i] if i < len(names) else f"coef[{i}]" for i in range(n)]
    cov = unpack_covariance(p.cov, n)
    sigma = np.array(estimated_sigma(p)[:n])
    on = np.flatnonzero(sigma > 0.0)
    if cov.any() and not np.allclose(np.diag(cov)[on], sigma[on] ** 2, rtol=_SAME_VARIANCE, atol=0.0):
        raise BadInput(
            "its covariance is not that of the standard deviations that the CRC covers",
            f"correction {unsigned32(p.crc):08x}",
            "do not decide by this message: it was changed on the way, or a stranger sends on this network",
        )
    d = np.sqrt(np.maximum(np.diag(cov)[on], 1e-300))
    lines = tuple(
        CoefLine(
            names[i],
            unit_of(names[i]),
            coef_status_name(p.status[i]),
            p.value[i],
            float(sigma[i]),
            tuple(names[k] for k in range(n) if k != i and p.confounded[i] >> k & 1),
        )
        for i in range(n)
    )
    return Review(
        unsigned32(p.crc),
        p.session,
        verdict_name(p.verdict),
        frame_name(p.frame),
        p.n_poses,
        p.n_outliers,
        lines,
        cov[np.ix_(on, on)] / np.outer(d, d),
        {key: getattr(p, key) for key, _u, _t in NUMBERS},
        unsigned32(p.crc_kin_before),
        ended_text(p.ended, p.verdict),
        tested_early(p.ended),
        unsigned32(p.crc_arm),
        unsigned32(p.crc_terms),
    )


def kin_crc(p: Any) -> int:
    """CRC of the kinematics table that a proposal_t describes. An approval names this CRC and nothing else,
    so what was shown is what comes in force only if the two agree: telemetry carries no signature. BadInput
    if it describes none."""
    kin: Any = library("flight").ffi.new("kc_kin_t *")
    kin.n_coef = p.n_coef
    kin.value[0 : p.n_coef], kin.sigma[0 : p.n_coef] = p.value[: p.n_coef], p.sigma[: p.n_coef]
    kin.arm_crc, kin.terms_crc = unsigned32(p.crc_arm), unsigned32(p.crc_terms)
    kin.prev_crc, kin.made_us = unsigned32(p.crc_kin_before), p.t_us & _U64
    kin.session, kin.n_poses = unsigned32(p.session), unsigned32(p.n_poses)
    return encode("kin", kin).crc


def _not_finite(p: Any) -> list[str]:
    """Fields of a proposal_t that are NaN or infinite."""
    n = p.n_coef
    used = {"value": p.value[:n], "sigma": p.sigma[:n], "cov": p.cov[: n * (n + 1) // 2]}
    used |= {key: getattr(p, key) for key, _u, _t in NUMBERS}
    return [key for key, value in used.items() if not np.isfinite(value).all()]


def warnings(review: Review, big: Sequence[str] = ()) -> list[str]:
    """What a reviewer should look at before deciding; empty when nothing stands out. big: large changes, in
    words."""
    out = [*reasons_to_reject(review), *big]
    k = review.numbers
    if k["rank"] < k["n_free"]:
        held = [c.name for c in review.coefs if c.status == "held"]
        out.append(f"rank {k['rank']:.0f} of {k['n_free']:.0f}; held: {', '.join(held) or 'none'}")
    bound = [c.name for c in review.coefs if c.status.startswith("at ")]
    if bound:
        out.append(f"at a bound: {', '.join(bound)}")
    if review.n_outliers:
        out.append(f"{review.n_outliers} of {review.n_poses} poses rejected as outliers")
    return out


def reasons_to_reject(review: Review | Entry) -> list[str]:
    """What an approval has to override; empty when there is nothing. Of a journal's entry: by the verdict,
    the numbers and the clearance that were seen."""
    poor = called_poor(review.numbers) if review.verdict == VERDICTS["POOR"] else ""
    by_numbers = poor, _bad_fit(review.numbers), _larger_residual(review.numbers)
    return [*(text for text in by_numbers if text), *review.against]


def reasons_known(seen: Sequence[Entry], verdict: str) -> list[str]:
    """Reasons to reject what waits, as they were seen last, and clearance as anybody has seen it; verdict:
    that flight states now, "" if it has lost it."""
    lost = [] if verdict else ["flight has lost its verdict"]
    if not seen:
        return ["flight itself calls the fit poor"] if verdict == VERDICTS["POOR"] else lost
    last = max(seen, key=lambda entry: entry.time)
    against = tuple(dict.fromkeys(reason for entry in seen for reason in entry.against))
    last = dataclasses.replace(last, verdict=verdict or last.verdict, against=against)
    return [*reasons_to_reject(last), *lost]


def called_poor(numbers: Mapping[str, float]) -> str:
    """That flight's verdict is POOR, and where to look for the reason if it is not in the numbers."""
    text = "flight itself calls the fit poor"
    if _bad_fit(numbers):
        return text
    return f"{text} (its numbers do not say why: see CAL_CHANGED, CAL_OUTLIER or CAL_EST before it)"


def poor_fit(review: Review) -> bool:
    """Whether the model does not explain the data, by flight's verdict or by p: the covariance does not hold
    then, nor does what is made from it."""
    return review.verdict == VERDICTS["POOR"] or bool(_bad_fit(review.numbers))


def _bad_fit(numbers: Mapping[str, float]) -> str:
    p, scale = numbers["p_fit"], numbers["noise_scale"]
    if p >= P_FIT_MIN:
        return ""
    return f"fit is worse than the stated noise explains: p = {p:.2g}, noise scale {scale:.2f}"


def _larger_residual(numbers: Mapping[str, float]) -> str:
    smaller = numbers["fit_pos_m"] <= numbers["before_pos_m"]  # not if one of them is no number
    return "" if smaller else "residual after the fit is larger than before"


def parse_crc(text: str) -> int:
    """A CRC from its eight hex digits; BadInput if it is none: one with digits left out would be another."""
    if not re.fullmatch(r"(0[xX])?[0-9a-fA-F]{8}", text):
        raise BadInput(
            f"{text!r} is not a CRC", todo="give its eight hex digits as listed: 1a2b3c4d or 0x1a2b3c4d"
        )
    return int(text, 16)


def coef_names(tables_dir: Path, terms_crc: int = 0) -> list[str]:
    """Names of the coefficients from the terms table. BadInput if its CRC is not that of the table that a
    proposal was made with (0: unknown): its values would get the names of others."""
    file = tables_dir / "terms.tbl"
    if not file.is_file():
        raise BadInput("no terms table", str(file), "give --tables DIR with the tables of the run")
    image, terms = decode_as("terms", file.read_bytes(), str(file))
    if terms_crc not in (0, image.crc):
        raise BadInput(
            f"the proposal was made with the terms table {terms_crc:08x}, this one is {image.crc_text}",
            str(file),
            "give --tables DIR with the tables of the run",
        )
    return list(Terms.of_table(terms).names)


def find(path: Path, crc: str | None, tables_dir: Path) -> Review:
    """A proposal of a log by CRC, or the last one."""
    sessions = [s for s in read_log(path, ["KC_PROPOSAL"]).sessions.values() if s.proposal is not None]
    wanted = None if crc is None else parse_crc(crc)
    held = [(s.proposal, s.disputed) for s in sessions if s.proposal is not None]
    held = [(p, disputed) for p, disputed in held if wanted in (None, unsigned32(p.crc))]
    if not held:
        raise BadInput(
            "no such proposal in the log", str(path), "`kincal review list LOG` names what is there"
        )
    proposal, disputed = held[-1]
    if disputed:
        raise two_messages(unsigned32(proposal.crc), str(path))
    return from_message(proposal, coef_names(tables_dir, unsigned32(proposal.crc_terms)))


def two_messages(crc: int, where: str) -> BadInput:
    """The error where messages of one correction differ in what its CRC does not cover."""
    return BadInput(
        f"two messages of correction {crc_text(crc)} say different things of it: flight did not send both",
        where,
        "do not decide by them: find out who else sends on this network. `kincal review reject` and a new "
        "calibration are safe",
    )


# --------------------------------------------------------------------------- journal


def record(
    journal: Path,
    decision: str,
    crc: int,
    by: str,
    why: str,
    url: str,
    review: Review | Entry | None,
    signer: Signer,
    override: str = "",
    command: str = "",
    armed_key: int = 0,
    kind: str = "",
    answers: int = 0,
    check: Callable[[journals.Journal], None] | None = None,
) -> Entry:
    """Append one decision, which the last command of the signer carried out, or what was seen or attempted;
    review: the proposal, or an entry that has its numbers; override: why it was approved in spite of the
    reasons to reject it; command: that was attempted or refused; armed_key: that took the first step of what
    is approved; kind: of the table that the command is about; answers: line of the question that a comment
    answers; check: as for `journal.append`. Refuses when the journal was tampered with."""
    check_words(by, why)
    check_words(by, override.strip() or "-")
    entry = Entry(
        datetime.datetime.now(datetime.UTC).isoformat(timespec="seconds"),
        decision,
        f"{crc:08x}" if crc else "",
        by,
        why,
        review.session if review else None,
        url,
        review.numbers if review else {},
        verdict=review.verdict if review else "",
        override=override,
        command=command,
        armed_key=armed_key,
        against=tuple(review.against) if review else (),
        kind=kind,
        answers=answers,
    )
    return journals.append(journal, entry, signer, check)


def check_journal(journal: Path, keys: Sequence[Key] = ()) -> list[Entry]:
    """All entries; an error names the first line that does not follow from the one before, or that its key
    did not write."""
    return list(journals.read(journal, keys).entries)


def check_words(by: str, why: str) -> None:
    """BadInput if one of the two is empty, or is no text that can stand in the journal: it is never
    rewritten."""
    if not by.strip() or not why.strip():
        raise BadInput("a decision needs a name and a reason", todo="give --by NAME and --why TEXT")
    if len(by) > _MOST_NAME or len(why) > _MOST_WORDS:
        raise BadInput(
            "the name or the reason is too long for the journal",
            todo=f"a name has up to {_MOST_NAME} characters, a reason up to {_MOST_WORDS}",
        )
    if any("\ud800" <= letter <= "\udfff" for letter in by + why):
        raise BadInput("the name or the reason is no text", todo="write it in UTF-8")
    if unseen(by):
        raise BadInput(
            f"the name holds a line break or another character that is not shown: {by!r}",
            todo="write it in one line of letters that are shown",
        )
