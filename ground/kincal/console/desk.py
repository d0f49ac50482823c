"""What an operator does from the console: commands and decisions, by the functions that the command line has.

Whatever the browser sends carries a number of its own choice. A request that comes twice, because the answer
to the first was lost, is answered again and carried out once."""

from __future__ import annotations

import hashlib
import math
import tempfile
import threading
import time
from collections import Counter, OrderedDict
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

from kincal.api import corrected, operate, previews
from kincal.api.reviews import answered, of_flight, with_clearance
from kincal.link import Link, crc_text, unsigned32
from kincal.link.connection import LISTEN
from kincal.link.eventfile import event_bytes
from kincal.link.names import state_name
from kincal.pages import review as review_pages
from kincal.pages.page import Grid, Provenance
from kincal.review import (
    KIN_KIND,
    Review,
    changes,
    check_words,
    coef_names,
    decisions,
    from_message,
    journal,
    parse_crc,
    reasons_to_reject,
    record,
    two_messages,
)
from kincal.review.residuals import PoseResidual, residuals
from kincal.review.status import Status, status
from kincal.review.thresholds import Limits, read_limits
from kincal_shared.errors import BadInput, CommandFailed, KincalError
from kincal_shared.keys import Signer, file_of, holder, other_than, signer_of
from kincal_shared.keys import read as read_keys

from . import remarks
from .clearances import Clearances, Found
from .dictionary import in_forms
from .document import document, plain_grid, section
from .picture import Picture

_REMEMBERED = 500
_MOST_NUMBER = 100  # characters
_ABORT_WAIT_S = 5.0
_LISTEN_S = 3.0
_CHECK_AGAIN_S = 20.0  # recordings are large
Plain = dict[str, Any]


@dataclass(frozen=True)
class Words:
    """Who asks and why."""

    by: str
    why: str


@dataclass
class Desk:
    """url: of the network; key_file: that signs; journal: of decisions; picture: what is known of flight;
    timeout_s: longest wait for an answer; clearances: of corrections, None: they are not computed; elsewhere:
    where kinematics tables may lie besides `tables_dir`, which holds the one in force alone."""

    url: str
    key_file: Path | None
    journal_file: Path | None
    tables_dir: Path
    picture: Picture
    timeout_s: float = 10.0
    clearances: Clearances | None = None
    elsewhere: Callable[[], Sequence[Path]] = tuple
    _values_by_crc: dict[int, changes.KinValues] = field(default_factory=dict)
    _missed_s: dict[int, float] = field(default_factory=dict)  # when a table was looked for in vain
    _done: OrderedDict[str, tuple[str, Plain | Exception]] = field(default_factory=OrderedDict)
    _turns: Counter[str] = field(default_factory=Counter)  # requests carried out, by what they act on
    _accepted: dict[int, int] = field(default_factory=dict)  # by key: highest counter that flight accepted
    missing: str = ""  # what `journal_missing` found
    _noted: bool = False
    _one: threading.Lock = field(default_factory=threading.Lock)

    # ---- keys and journal

    @property
    def why_no_key(self) -> str:
        """Why nothing can be signed; empty if it can."""
        try:
            self._signer()
        except KincalError as error:
            return str(error)
        return ""

    def may_go(self) -> Plain:
        """The key that signs here (0: none), and why flight would not take the second step from it, by the
        last housekeeping; empty if it would."""
        hk = self.picture.newest("KC_HK")
        key = 0 if self.why_no_key else self._signer().key.id
        mine = hk is not None and hk.armed_key and hk.go_by_other_key and holder(key) == holder(hk.armed_key)
        return {"key": key, "why_not": f"GO has to be given with {other_than(hk.armed_key)}" if mine else ""}

    def _signer(self) -> Signer:
        return signer_of(file_of(self.key_file))

    def link(self, *, signed: bool) -> Link:
        """A link of its own, to be used as a context."""
        signer = self._signer() if signed else None
        return Link(self.url, LISTEN, signer=signer)

    @property
    def journal_path(self) -> Path:
        """Where decisions are written."""
        return journal.place(self.journal_file, file_of(self.key_file))

    def inspect(self) -> journal.Journal:
        """The journal, to be shown: one that was changed says so."""
        keys = file_of(self.key_file)
        return journal.inspect(self.journal_path, read_keys(keys) if keys.exists() else ())

    def _sound(self) -> journal.Journal:
        """The journal. BadInput if it was changed."""
        keys = file_of(self.key_file)
        return journal.read(self.journal_path, read_keys(keys) if keys.exists() else ())

    def entries(self) -> tuple[journal.Entry, ...]:
        """The lines of the journal. BadInput if it was changed."""
        return self._sound().entries

    def journal_version(self) -> Plain:
        """Changes whenever somebody writes into the journal, here or by another program."""
        try:
            found = self.journal_path.stat()
        except OSError:
            return {"version": ""}
        return {"version": f"{found.st_ino} {found.st_mtime_ns} {found.st_size}"}

    def journal_missing(self) -> str:
        """Why a journal without a line is not that of a first start, with what to do: flight is asked once
        for this key. Empty if all is well, or if it cannot be asked (yet)."""
        with self._one:
            if self.why_no_key or self.picture.newest("KC_HK") is None:
                return ""
            try:
                if self.entries():
                    return ""
                signer = self._signer()
                if signer.key.id not in self._accepted:
                    with Link(self.url, operate.LISTEN, signer=signer) as link:
                        self._accepted[signer.key.id] = operate.accepted_counter(link, self.timeout_s)
                found = journal.Journal(self.journal_path)
                why = journal.missing(found, signer.key.id, self._accepted[signer.key.id])
            except KincalError:
                return ""  # of a journal that is not sound, the list of its lines says so
        if why and not self._noted:
            self._noted = True
            self.picture.note("error", "JOURNAL_MISSING", in_forms(f"{why}. To do: {journal.MISSING_TODO}"))
        self.missing = in_forms(f"{why}. {journal.MISSING_TODO}.") if why else ""
        return self.missing

    # ---- once

    def once(self, number: str, what: Callable[[], Plain], asked: str = "", about: str = "") -> Plain:
        """The answer, or the error, of a request with this number, which is carried out the first time only.
        One after the other: two signed commands at once would overtake each other. asked: what the request
        says; about: what it acts on, empty: it may wait for others. CommandFailed if another one had this
        number (the answer to that is none to this one), or if one about the same was under way when this one
        came: whoever asks has not seen what came of that."""
        if not number or len(number) > _MOST_NUMBER:
            raise BadInput("the request has no number, or one that is too long")
        digest = hashlib.sha256(asked.encode("utf-8", "surrogatepass")).hexdigest()
        turn = self._turns[about]
        with self._one:
            if number in self._done:
                of, before = self._done[number]
                if of != digest:
                    raise CommandFailed(
                        "another request had this number: nothing was sent",
                        todo="look at the state, then send it with a number of its own",
                    )
                if isinstance(before, Exception):
                    raise before
                return {**before, "again": True}
            try:
                if about and self._turns[about] != turn:
                    raise CommandFailed(
                        "another request about the same was under way when this one came: nothing was sent",
                        todo="look at what came of that one, then decide again",
                    )
                answer = what()
            except (KincalError, OSError) as error:
                self._remember(number, digest, error)
                raise
            finally:
                self._turns[about] += 1
            self._remember(number, digest, answer)
            return answer

    def _remember(self, number: str, digest: str, answer: Plain | Exception) -> None:
        self._done[number] = digest, answer
        while len(self._done) > _REMEMBERED:
            self._done.popitem(last=False)

    # ---- commands

    def abort(self) -> Plain:
        """Stop the arm, at once and past everything else; no key, no reason and no state needed."""
        signer = None if self.why_no_key else self._signer()
        with Link(self.url, operate.LISTEN, signer=signer) as link:
            link.last_t_us = self.picture.t_us
            self.picture.note("warning", "ABORT", "ABORT sent from this console")
            who = self.operator(Words("console", "ABORT at the console"), timeout_s=_ABORT_WAIT_S)
            tracked = operate.act(link, operate.abort(), who, operate.Snapshot(), self._verifier("ABORT"))
        return _outcome(tracked)

    def start(self, poses: int, words: Words) -> Plain:
        """Begin a calibration with the settings of CONFIG; poses: 0: as CONFIG says."""
        return self.command(lambda _s: operate.start(poses=poses), words)

    def rollback(self, crc: str, words: Words) -> Plain:
        """Bring back the kinematics table before the one in force; crc: of the one in force, as it was
        shown."""
        return self.command(lambda _s: operate.rollback(parse_crc(crc)), words)

    def rollback_preview(self) -> Plain:
        """What a rollback would change back. BadInput if the values are not at hand."""
        hk = self.picture.newest("KC_HK")
        if hk is None:
            raise BadInput("no housekeeping was heard yet")
        if not hk.kin_prev_crc:
            raise BadInput("flight holds no table before the one in force: ROLLBACK would be refused")
        now = self._values(unsigned32(hk.table_crc[KIN_KIND]))
        previous = self._values(unsigned32(hk.kin_prev_crc))
        if now is None or previous is None:
            raise BadInput(
                "the values of the table in force or of the one before it are not known to this console",
                todo="`kincal command rollback --from LOG` shows what changes back",
            )
        wanted = corrected.in_force(hk.table_crc)
        clear = self._near(f"{previous.crc:08x}", now.values, previous.values, wanted)
        known, why = (clear.corrected, clear.why) if clear else (None, "")
        found = previews.rolled_back(now, previous, self.tables_dir, wanted, known, why)
        rows = [[c.name, c.old_text, c.new_text, c.delta_text] for c in found.changes.rows]
        grid = Grid.of("<coefficient|in force|rolled back|change", rows)
        return {
            "crc": crc_text(now.crc),
            "to": crc_text(previous.crc),
            "headline": found.changes.headline,
            "grid": plain_grid(grid),
            "against": [reason.text for reason in found.changes.reasons],
            "near": [section(s) for s in review_pages.near(known or why, "rolled back", "the table before")],
            "clearance": clear.as_dict() if clear else None,
        }

    def _near(
        self, crc: str, before: Sequence[float] | None, after: Sequence[float], wanted: Mapping[str, int]
    ) -> Found | None:
        """Clearance and reach; None: they are not computed here."""
        if self.clearances is None:
            return None
        return self.clearances.ask(crc, before, after, self.tables_dir, wanted)

    def _changes(self, found: Review, limits: Limits | None) -> changes.Changes:
        """What a correction changes against the table that it replaces."""
        flown = changes.flown(self.tables_dir)
        return changes.of_review(found, self._values(found.crc_before), flown, limits)

    def _left(self, found: Review, about: Status) -> tuple[PoseResidual, ...]:
        """What is left at each pose; empty unless every measurement of the session was heard."""
        flown, session = changes.flown(self.tables_dir), self.picture.summary().sessions.get(found.session)
        heard = session.measurements if session else []
        whole = [m.observation for m in heard] == list(range(1, len(heard) + 1))
        if flown is None or session is None or not whole or len(session.at_poses) != found.n_poses:
            return ()
        old = self._values(found.crc_before)
        before, after = old.values if old else None, [c.value for c in found.coefs]
        with tempfile.TemporaryDirectory() as folder:
            log = Path(folder) / "session.lcmlog"
            log.write_bytes(
                b"".join(event_bytes(m.observation, m.t_us, "KC_MEAS", m.encode()) for m in heard)
            )
            out = about.rejected, about.rejected_extra
            return residuals(log, found.session, before, after, flown, *out)

    def _values(self, crc: int) -> changes.KinValues | None:
        """Values of a kinematics table, from the corrections that were heard, tables and recordings."""
        if (p := self.picture.proposal(crc_text(crc))) is not None:
            return changes.KinValues(crc, tuple(p.value[: p.n_coef]), "heard")
        if crc in self._values_by_crc:
            return self._values_by_crc[crc]
        if time.monotonic() < self._missed_s.get(crc, -math.inf) + _CHECK_AGAIN_S:
            return None
        found = changes.kin_values(crc, (self.tables_dir, *self.elsewhere()))
        if found is None:
            self._missed_s[crc] = time.monotonic()
        else:
            self._values_by_crc[crc] = found
        return found

    def command(self, make: Callable[[operate.Snapshot], operate.Request], words: Words) -> Plain:
        """A signed command with its verifiers. CommandFailed, before it is sent, if flight would refuse it by
        the last telemetry."""
        check_words(words.by, words.why)
        operate.refuse_several("the command", self.picture.several(), self.url)
        snapshot = operate.Snapshot()
        with Link(self.url, operate.LISTEN, signer=self._signer()) as link:
            operate.listen(link, snapshot, _listen_s(self.timeout_s), _heard)
            request = make(snapshot)
            if found := operate.unmet(request, snapshot, link.clock_s()):
                raise CommandFailed(
                    f"{request.opcode} was not sent, flight would refuse it: {found[0].condition}",
                    found[0].found,
                    found[0].todo,
                )
            who = self.operator(words)
            tracked = operate.act(link, request, who, snapshot, self._verifier(request.opcode))
        return _outcome(tracked)

    def operator(
        self, words: Words, say: Callable[[str], None] | None = None, timeout_s: float | None = None
    ) -> decisions.Operator:
        """Who acts; what is done, and each verifier, goes into the list of events."""
        return decisions.Operator(
            words.by.strip(),
            words.why.strip(),
            self.journal_path,
            self.timeout_s if timeout_s is None else timeout_s,
            say or (lambda text: self.picture.note("info", "DESK", in_forms(text))),
            operate.verified(operate.Snapshot(), self._verifier("decision")),
        )

    def _verifier(self, name: str) -> Callable[[operate.Step], None]:
        """Puts each verifier into the list of events as it is reached."""

        def say(step: operate.Step) -> None:
            severity = "error" if step.stage == operate.REFUSED else "info"
            self.picture.note(severity, step.stage.upper(), in_forms(f"{name}: {step.evidence}"))

        return say

    # ---- corrections

    def review(self, crc: str) -> Plain:
        """A correction as its page shows it, and what can be decided."""
        found, limits = self._found(crc), read_limits(self.tables_dir)
        kept = self.inspect()
        lines = [e for e in kept.entries if e.crc == crc]
        about = status(self.picture.summary(), found, lines)
        clear = self._clearance(found)
        known, why = (clear.corrected, clear.why) if clear else (None, "")
        found, changed, stands_out = with_clearance(found, self._changes(found, limits), known, why)
        said = remarks.listed(kept, crc)
        stands_out = [*_not_sound(kept), *_stands_out(stands_out, kept, crc)]
        lines_seen = [e for e in lines if e.decision == journal.SEEN]
        reasons = self._reasons(found, lines_seen)
        page = review_pages.page(
            found,
            stands_out,
            Provenance(_today()),
            about,
            limits,
            changes=changed,
            left=self._left(found, about),
            clearance=known or why,
        )
        hk = self.picture.newest("KC_HK")
        return {
            "page": document(page),
            "reasons": reasons,
            "look_at": [text for text in stands_out if text not in reasons],
            "waits": hk is not None and crc_text(hk.proposal_crc) == crc,
            "seen_by": _seen_by(kept, lines_seen, found.against),
            "lines": [_line(e) for e in lines],
            "go": {**self.may_go(), "override": self._go_needs_override(crc, kept, reasons)},
            "remarks": said,
            "shown": remarks.stamp(stands_out, said),
            "clearance": clear.as_dict() if clear else None,
        }

    def clearance(self, crc: str) -> Plain:
        """How far clearance and reach of a correction have come."""
        clear = self._clearance(self._found(crc))
        return clear.as_dict() if clear else {"status": "not known"}

    def _clearance(self, found: Review) -> Found | None:
        old, hk = self._values(found.crc_before), self.picture.newest("KC_HK")
        before, after = old.values if old else None, [c.value for c in found.coefs]
        return self._near(found.crc_text, before, after, of_flight(found, hk))

    def _found(self, crc: str) -> Review:
        message = self.picture.proposal(crc)
        if message is None:
            raise BadInput(
                f"correction {crc} was not heard by this console",
                todo="`kincal serve --log FILE` shows its recording; it can be rejected in the inbox",
            )
        if unsigned32(message.crc) in self.picture.disputed:
            raise two_messages(unsigned32(message.crc), self.url)
        return from_message(message, coef_names(self.tables_dir, unsigned32(message.crc_terms)))

    def _reasons(self, found: Review, seen: Sequence[journal.Entry]) -> list[str]:
        """To reject it, also what was seen when clearance was known, and that flight no longer knows its
        verdict."""
        hk, of_journal = self.picture.newest("KC_HK"), [text for e in seen for text in e.against]
        reasons = list(dict.fromkeys([*reasons_to_reject(found), *of_journal]))
        waits = hk is not None and unsigned32(hk.proposal_crc) == found.crc
        return [*reasons, "flight has lost its verdict"] if waits and not hk.proposal_verdict else reasons

    def _go_needs_override(self, crc: str, kept: journal.Journal, reasons: Sequence[str]) -> bool:
        """Whether the second step has to say why, because the journal of the first one is not this one."""
        hk = self.picture.newest("KC_HK")
        armed = hk is not None and state_name(hk.state) == "ARMED" and crc_text(hk.proposal_crc) == crc
        return bool(armed and reasons) and decisions.first_step(kept.entries, crc, hk.armed_key) is None

    def remark(self, crc: str, by: str, text: str, what: str, answers: int = 0) -> Plain:
        """Write a comment or a question about a correction into the journal; answers: line of the question
        that a comment answers, 0 if it answers none."""
        if what not in journal.REMARKS:
            raise BadInput(f"no such remark: {what}")
        number, signer = parse_crc(crc), self._signer()
        if answers:
            answered(self.journal_path, signer, answers, number, what == journal.QUESTION)
        record(self.journal_path, what, number, by.strip(), text.strip(), "", None, signer, answers=answers)
        return {"ok": True, "text": f"{what} by {by.strip()} stands in the journal"}

    def see(self, crc: str, by: str, shown: str | None = None) -> Plain:
        """Write down that this person was shown the correction. shown: `shown` of the page that they looked
        at, None if it is the page as it is now. CommandFailed if it says something else by now."""
        check_words(by, "seen")
        found, clear = self._found(crc), self._clearance(self._found(crc))
        _refuse_computing(crc, clear)
        known, why = (clear.corrected, clear.why) if clear else (None, "")
        limits = read_limits(self.tables_dir)
        found, _, stands_out = with_clearance(found, self._changes(found, limits), known, why)
        kept, found_out = self._sound(), tuple(stands_out)

        def check(now: journal.Journal) -> None:
            page = remarks.stamp(_stands_out(found_out, now, crc), remarks.listed(now, crc))
            if shown not in (None, page):
                raise CommandFailed(
                    f"the page of correction {crc} says more than the one that {by.strip()} was shown",
                    todo="it is drawn again: read what is new, above all questions and reasons to reject it, "
                    "then say that you have seen it",
                )

        check(kept)
        stands_out = _stands_out(found_out, kept, crc)
        mine = kept.seen_by(by, crc)
        if mine and mine.against == found.against and not decisions.remarks_since(kept, mine, by):
            return {"ok": True, "text": f"{by} has seen correction {crc}"}
        why = decisions.seen_text(stands_out)
        signer = self._signer()
        record(
            self.journal_path, journal.SEEN, found.crc, by.strip(), why, self.url, found, signer, check=check
        )  # fmt: skip
        return {"ok": True, "text": f"{by} has seen correction {crc}"}

    def decide(self, what: str, crc: str, words: Words, override: str = "") -> Plain:
        """arm, go or reject."""
        said: list[str] = []
        note = lambda text: said.append(in_forms(text))  # noqa: E731
        operate.refuse_several("the decision", self.picture.several(), self.url)
        if what == "arm" and self.picture.proposal(crc) is not None:
            _refuse_computing(crc, self._clearance(self._found(crc)))
        who, against = self.operator(words, note), self._against(crc)
        with Link(self.url, signer=self._signer()) as link:
            if what == "arm":
                decisions.arm(link, crc, who, override.strip(), against)
            elif what == "go":
                decisions.go(link, crc, who, against, override.strip())
            elif what == "reject":
                decisions.reject(link, crc, who)
            else:
                raise BadInput(f"no such decision: {what}")
        self.picture.note("info", what.upper(), f"correction {crc}: {what} by {who.by}: {who.why}")
        return {"ok": True, "text": said[-1] if said else what, "said": said}

    def _against(self, crc: str) -> tuple[str, ...]:
        """Reasons to reject a correction that clearance gives, as far as they are known by now."""
        if self.clearances is None or self.picture.proposal(crc) is None:
            return ()
        clear = self._clearance(self._found(crc))
        return clear.corrected.against if clear and clear.corrected else ()

    def log(self) -> list[Plain]:
        """The journal, newest first."""
        entries = self.entries()
        open_ = journal.unfinished(entries)
        return [{**_line(e), "unfinished": any(e is one for one in open_)} for e in reversed(entries)]


def _refuse_computing(crc: str, clear: Found | None) -> None:
    """CommandFailed while there may be a reason to reject a correction in a few seconds."""
    if clear is not None and clear.status in ("running", "waiting"):
        raise CommandFailed(
            f"clearance and reach of correction {crc} are still being computed: nobody has seen them",
            todo="wait until they stand on the page",
        )


def _listen_s(timeout_s: float) -> float:
    """How long telemetry is listened to before a command: three times its period."""
    return min(timeout_s, _LISTEN_S)


def _heard(snapshot: operate.Snapshot) -> bool:
    """All that conditions are judged by."""
    return all(snapshot.last(channel) for channel in ("KC_HK", "KC_ARM_STATE", "KC_PANTILT_STATE"))


def _outcome(tracked: operate.Tracked) -> Plain:
    return {
        "ok": tracked.outcome == operate.DONE,
        "text": in_forms(tracked.last_line),
        "steps": tracked.as_dict()["verifiers"],
    }


def _seen_by(kept: journal.Journal, seen: Sequence[journal.Entry], against: Sequence[str]) -> list[str]:
    """Who has seen a correction with these reasons against it, and all that others wrote of it."""
    last = {e.by.strip().casefold(): e for e in seen}.values()
    whole = [e for e in last if set(against) <= set(e.against)]
    return sorted(e.by for e in whole if not decisions.remarks_since(kept, e, e.by))


def _stands_out(found: Sequence[str], kept: journal.Journal, crc: str) -> list[str]:
    """What stands out, with the open questions."""
    return [*found, *(remarks.open_text(n, e) for n, e in kept.open_questions(crc).items())]


def _not_sound(kept: journal.Journal) -> list[str]:
    """That a journal does not verify."""
    return [] if kept.broken is None else [f"the journal does not verify: {kept.broken.what}"]


def _line(e: journal.Entry) -> Plain:
    return {
        "time": e.time,
        "decision": e.decision,
        "text": e.words,
        "crc": e.crc,
        "by": e.by,
        "why": e.why,
        "override": e.override,
        "verdict": e.verdict,
        "key": e.key_id,
        "armed_key": e.armed_key,
    }


def _today() -> str:
    return datetime.now(UTC).date().isoformat()
