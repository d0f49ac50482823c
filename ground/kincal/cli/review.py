"""`kincal review`: see a proposed correction, question it, approve or reject it."""

from __future__ import annotations

import json
import os
import shlex
import tempfile
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeVar, Unpack

import click

from kincal import link
from kincal.cli.options import EXISTS, FILE, PATH, TABLES
from kincal.cli.outputs import FILE_OUT, PICTURE, REPORT
from kincal.cli.provenance import say_files, table_crcs, today
from kincal.cli.terminal import console, say
from kincal.cli.text import review as text
from kincal.cli.wire import JOURNAL, KEYS, TIMEOUT, URL, Recorded, operator
from kincal.link import crc_text
from kincal.review import journal as journals
from kincal_shared.errors import BadInput, CommandFailed
from kincal_shared.keys import DEFAULT, RUN_KEYS, Signer, file_of, signer_of

if TYPE_CHECKING:
    from kincal.api.operate import Unmet
    from kincal.review import Review
    from kincal.review.decisions import Operator

BY = click.option("--by", required=True, help="Who decides.")
WHY = click.option("--why", required=True, help="Reason, for the record.")
Command = TypeVar("Command", bound=Callable[..., Any])


@click.group()
def review() -> None:
    """See a proposed correction, question it, approve or reject it.

    The order is: `list --live` (what waits), `show LOG --by NAME` (see it), then `arm` and `go`, or `reject`.

    \b
    Example:
        kincal review show out/paper/run.lcmlog
    """


@review.command("list")
@click.argument("logs", nargs=-1, type=FILE)
@click.option("--live", is_flag=True, help="Also ask the flight process at --url what waits there.")
@URL
@TIMEOUT
@KEYS
@JOURNAL
def review_list(
    logs: tuple[Path, ...], live: bool, url: str, timeout_s: float, key_file: Path, journal: Path | None
) -> None:
    """List proposals in logs and what became of them, what waits on board and what can be done about it, and
    past decisions.

    Decisions are those of the journal and of the journals beside the logs.

    \b
    Examples:
        kincal review list out/*/run.lcmlog
        kincal review list --live
    """
    from kincal.api.reviews import absent, known, proposals, read_journals, refuse_broken
    from kincal.review import decisions

    out, found = console(), read_journals(logs, journal, key_file, journals.inspect)
    text.proposals(out, proposals(logs, found))
    if live:
        with link.Link(url) as up:
            signing = _signing_options(key_file, journal)
            waits = decisions.on_board(up, timeout_s)
            options = signing + _option("--url", url, link.DEFAULT_URL)
            text.on_board(out, waits, options, known(found, waits.crc, waits.verdict, waits.armed))
    for one in found:
        text.decisions(out, one)
    text.absent(out, absent(logs, found))
    refuse_broken(found)


@review.command("show")
@click.argument("file", type=FILE, required=False)
@click.option("--live", is_flag=True, help="The correction that waits at --url, from a recording of it.")
@click.option(
    "--recordings",
    type=PATH,
    default=None,
    show_default="~/.kincal/recordings",
    help="Where `kincal record` writes.",
)
@URL
@TIMEOUT
@click.option("--crc", default=None, help="Which proposal of the log, by CRC.  [default: the last]")
@click.option(
    "--picture",
    type=PICTURE,
    default=None,
    help="Picture to write (.png or .svg); the page (.html) lies beside it.  [default: next to the log]",
)
@click.option(
    "--by",
    default=None,
    help="Who looks at it: goes into the journal, and has to be there before `arm` and `go` by this name.",
)
@click.option(
    "--before",
    multiple=True,
    type=EXISTS,
    help="Log, KIN table or folder with the table in force, if the log and --tables do not have it.",
)
@click.option(
    "--space",
    type=EXISTS,
    default=None,
    help="Description of the SPACE table, for clearance and reach.  [default: beside the tables]",
)
@click.option("--json", "as_json", is_flag=True, help="Print as JSON; no page is written.")
@TABLES
@KEYS
@JOURNAL
def review_show(
    file: Path | None,
    live: bool,
    recordings: Path | None,
    url: str,
    timeout_s: float,
    crc: str | None,
    picture: Path | None,
    by: str | None,
    before: tuple[Path, ...],
    space: Path | None,
    as_json: bool,
    tables_dir: Path,
    key_file: Path,
    journal: Path | None,
) -> None:
    """Show a proposal of a log with all its numbers and their thresholds, what became of it, what can be
    decided, and which poses were rejected: as text, as a page (HTML) and as a picture.

    Clearance and reach are those of the arm as the new table has it, against the table in force: least
    distance to itself and to keep-out volumes on the verified segments, at park pose, seeds and candidates,
    and the poses that are lost (docs/GROUND.md; needs kincal[sim]).

    With --by the journal gets a line that this person has seen this correction, with verdict and numbers.

    With --live it is the correction that waits on board, if `kincal record` has recorded its proposal. If
    not, flight is asked for it: what changes, clearance and reach are shown, and where each of them comes
    from. Tables of --tables that are not those in force are read back. It is not enough to approve it.

    \b
    Examples:
    kincal review show --live --by "A. Reviewer"
    kincal review show out/paper/run.lcmlog --crc 1a2b3c4d
    kincal review show out/paper/run.lcmlog --by "A. Reviewer" --keys out/paper/store.keys
    """
    from kincal.api import reviews
    from kincal.pages import review as pages
    from kincal.pages.page import Provenance
    from kincal.review.status import to_decide

    if by is not None:
        _check_words(by, "seen")
    if live:
        who = operator(
            {
                "by": by or os.environ.get("USER", "operator"),
                "why": "review show --live: its proposal was not recorded",
                "url": url,
                "key_file": key_file,
                "timeout_s": timeout_s,
                "journal": journal,
            }
        )
        crc, file = _waiting(url, who, recordings, key_file, tables_dir, before, space, as_json)
    if file is None:
        raise BadInput("no log", todo="name one, or --live for what waits on board")
    read = reviews.read_journals((file,), journal, key_file, journals.inspect)
    shown = reviews.show(file, crc, tables_dir, read, before, space)
    found, warnings, about, limits = shown.review, shown.warnings, shown.about, shown.limits
    changes, clearance = shown.changes, shown.corrected or shown.why_not
    if as_json:
        click.echo(json.dumps(shown.as_dict(), indent=1))
        if by is not None:
            _see(found, by, file, key_file, journal, warnings, len(read[0].entries), err=True)
        reviews.refuse_broken(read)
        return
    picture = picture or file.with_name(f"review-{found.crc_text}.png")
    options = _keys_option(key_file, file) + (_option("--url", url, link.DEFAULT_URL) if live else "")
    decide = to_decide(found, about, shlex.quote(str(file)), options, seen=by is not None)
    text.broken(console(), read)
    text.show(console(), found, warnings, about, limits, decide, changes, shown.residuals, clearance)
    text.absent(console(), reviews.absent((file,), read))
    provenance = Provenance.of_file(today(), file, tables=table_crcs(tables_dir, ("terms",)))
    made = pages.write_all(
        found, warnings, picture, provenance, about, limits, decide, changes, shown.residuals, clearance
    )
    say_files("page", *made)
    if by is not None:
        _see(found, by, file, key_file, journal, warnings, len(read[0].entries))
    reviews.refuse_broken(read)


def _waiting(
    url: str,
    who: Operator,
    recordings: Path | None,
    key_file: Path,
    tables_dir: Path,
    before: tuple[Path, ...],
    space: Path | None,
    as_json: bool,
) -> tuple[str, Path]:
    """CRC of what waits on board, and the recording that holds its proposal. If none does, what flight holds
    is shown: CommandFailed, it is not enough for an approval."""
    from kincal.api import previews, reviews
    from kincal.review import decisions

    with link.Link(url, signer=_signer_or_none(key_file)) as up:
        waits = decisions.on_board(up, who.timeout_s)
        if not waits.crc:
            raise CommandFailed("no correction waits on board", url, "`kincal status` shows the state")
        if (file := reviews.recorded(waits.crc, recordings)) is not None:
            return f"{waits.crc:08x}", file
        with tempfile.TemporaryDirectory() as folder:
            found = previews.asked_for(up, waits, tables_dir, Path(folder), who, before, space)
    if as_json:
        click.echo(json.dumps(found.as_dict(), indent=1))
    else:
        text.asked(console(), found)
    raise CommandFailed(
        f"the proposal of correction {found.crc} was not recorded: no covariance, fit or residuals at hand",
        url,
        "it cannot be approved from this; give a log that holds it, or reject it and measure again with "
        "`kincal record` running",
    )


def _signer_or_none(key_file: Path) -> Signer | None:
    """Looking needs no key; asking flight for a table does."""
    try:
        return signer_of(file_of(key_file))
    except BadInput:
        return None


def _keys_option(key_file: Path, log: Path) -> str:
    """The option that a command about this log needs: the key file that was named, else that of the run,
    which lies beside its log."""
    beside = log.with_name(RUN_KEYS)
    if key_file == DEFAULT and beside.is_file():
        key_file = beside
    return _option("--keys", key_file, DEFAULT)


def _signing_options(key_file: Path, journal: Path | None) -> str:
    """The options of these that are not the default, as words of another command."""
    return _option("--keys", key_file, DEFAULT) + _option("--journal", journal, None)


def _check_words(by: str, text: str) -> None:
    """BadInput for a name or comment that the journal will not take; neither of them is a decision."""
    from kincal.review import check_words

    if not by.strip():
        raise BadInput("the name is empty", todo="give it by --by NAME")
    if not text.strip():
        raise BadInput("the comment is empty", todo="write what there is to say")
    check_words(by, text)


def _option(name: str, value: object, default: object) -> str:
    return "" if value == default else f" {name} {shlex.quote(str(value))}"


def _see(
    found: Review,
    by: str,
    log: Path,
    key_file: Path,
    journal: Path | None,
    stood_out: Sequence[str],
    shown_with: int,
    err: bool = False,
) -> None:
    """Write down who has seen the proposal, after it was shown with so many lines of the journal."""
    from kincal.review.decisions import see

    keys = file_of(key_file)
    path = FILE_OUT.convert(journals.place(journal, keys), None, None)
    see(path, found, by, log, signer_of(keys), stood_out, shown_with)
    say(f"recorded in {path}: {by} has seen correction {found.crc_text}", err=err)


class Decision(Recorded):
    """What every decision is given besides the CRC."""

    dry_run: bool


def decision_options(command: Command) -> Command:
    """Options of a decision."""
    dry = click.option("--dry-run", is_flag=True, help="Send nothing; name what flight would refuse.")
    for option in (JOURNAL, TIMEOUT, KEYS, URL, dry, WHY, BY, click.argument("crc")):
        command = option(command)
    return command


def override_option(more: str) -> Callable[[Command], Command]:
    """The option of a reason; more: what it is for, or what becomes of it."""
    words = f"Why it is approved in spite of the reasons to reject it, in at least three words: {more}."
    return click.option("--override", default="", metavar="REASON", help=words)


@review.command("arm")
@decision_options
@override_option("signed, and kept in the journal")
def review_arm(crc: str, override: str, **given: Unpack[Decision]) -> None:
    """Approve the correction that waits on board, first step: flight is armed for this CRC, for the time that
    CONFIG says (ten minutes as shipped). Nothing is in force before `kincal review go`.

    It is refused if the person named by --by has not seen the correction: `kincal review show --live --by
    NAME` shows it and writes that into the journal. If there are reasons to reject it, as with a poor fit,
    they are named, and --override has to say why it is approved all the same; flight refuses a poor fit
    without it.

    \b
    Examples:
        kincal review arm 1a2b3c4d --by "A. Reviewer" --why "residuals clean, rank full"
        kincal review arm 1a2b3c4d --by "A. Reviewer" --why "sample at risk" --override "2 mm will do"
    """
    from kincal.review import decisions

    if given["dry_run"]:
        _dry_run("arm", crc, given, override)
        return
    with link.Link(given["url"], signer=signer_of(file_of(given["key_file"]))) as up:
        decisions.arm(up, crc, _operator(given), override)


@review.command("go")
@decision_options
@override_option("for a first step that is in another journal")
def review_go(crc: str, override: str, **given: Unpack[Decision]) -> None:
    """Approve the correction that waits on board, second step: it comes in force.

    It is refused if the approval is not armed or has expired (`kincal review arm`), or if the person named by
    --by has not seen the correction. That may be another person than the one who armed it; where CONFIG asks
    for two persons (go_by_other_key), it has to be, with a key file of his own. If there are reasons to
    reject it, the first step has to override them; if that is in another journal, --override says why here.

    \b
    Examples:
        kincal review go 1a2b3c4d --by "B. Second" --why "agree with A. Reviewer"
        kincal review go 1a2b3c4d --keys second.keys --by "B. Second" --why "agree with A. Reviewer"
    """
    from kincal.review import decisions

    if given["dry_run"]:
        _dry_run("go", crc, given, override)
        return
    with link.Link(given["url"], signer=signer_of(file_of(given["key_file"]))) as up:
        decisions.go(up, crc, _operator(given), override=override)


@review.command("reject")
@decision_options
def review_reject(crc: str, **given: Unpack[Decision]) -> None:
    """Reject the correction that waits on board, armed or not; the table in force stays. Nobody has to have
    seen it for that.

    \b
    Example:
        kincal review reject 1a2b3c4d --by "A. Reviewer" --why "pose 7 looks blurred"
    """
    from kincal.review import decisions

    if given["dry_run"]:
        _dry_run("reject", crc, given)
        return
    with link.Link(given["url"], signer=signer_of(file_of(given["key_file"]))) as up:
        decisions.reject(up, crc, _operator(given))


def _operator(given: Decision) -> Operator:
    """Who decides, with a journal that can be written; the verifiers of what is sent are printed."""
    from kincal.api import operate
    from kincal.cli.text import operate as steps
    from kincal.review.decisions import Operator

    out = console()
    journal = FILE_OUT.convert(journals.place(given["journal"], file_of(given["key_file"])), None, None)
    command = operate.verified(operate.Snapshot(), lambda step: steps.step(out, step))
    return Operator(given["by"], given["why"], journal, given["timeout_s"], say, command)


def _unseen(read: Sequence[journals.Journal], crc: str, by: str) -> list[Unmet]:
    """What a person would be refused for by the journal: not seen, or not since others wrote of it."""
    from kincal.api import operate
    from kincal.review.decisions import remarks_since

    seen = read[0].seen_by(by, crc)
    todo = f'`kincal review show --live --by "{by}"`'
    if seen is None:
        return [operate.Unmet(f"correction {crc} seen by {by}", "no line of the journal says so", todo)]
    new = remarks_since(read[0], seen, by)
    return [operate.Unmet("all that was written about it seen", "; ".join(new), todo)] if new else []


def _dry_run(verb: str, crc: str, given: Decision, override: str = "") -> None:
    """What flight would refuse by the last telemetry, and what the journal says against it."""
    from kincal.api import operate, reviews
    from kincal.cli.text import operate as text
    from kincal.review import parse_crc
    from kincal.review.decisions import check_words_of_override

    number = parse_crc(crc)
    if override:
        check_words_of_override(override)
    make = {
        "arm": lambda: operate.approve_arm(number, bool(override)),
        "go": lambda: operate.approve_go(number),
        "reject": lambda: operate.reject(number),
    }
    request, snapshot = make[verb](), operate.Snapshot()
    with link.Link(given["url"], operate.LISTEN) as up:
        operate.listen(up, snapshot, min(given["timeout_s"], 3.0), lambda s: s.hk is not None)
        now_s = up.clock_s()
    signer = _signer_or_none(given["key_file"])
    found = operate.unmet(request, snapshot, now_s, signer.key.id if signer else 0)
    age = snapshot.freshness("KC_HK", now_s)
    waits = snapshot.waiting(now_s)
    if verb != "reject" and waits.crc == crc_text(number):
        read = reviews.read_journals((), given["journal"], given["key_file"], journals.inspect)
        known = reviews.known(read, number, waits.verdict, waits.armed)
        text.known(console(), known)
        found = (*found, *_unseen(read, waits.crc, given["by"]))
        if verb == "arm" and known.reasons and not override:
            todo = f"`kincal review reject {waits.crc}`; in an emergency --override REASON"
            found = (*found, operate.Unmet("an override", "none, but there are reasons to reject it", todo))
    text.unmet(console(), request.opcode, found, age, snapshot.state)
    if found:
        raise SystemExit(1)


@review.command("comment")
@click.argument("text")
@click.option("--crc", default="", help="Which correction.  [default: it is about the mission]")
@click.option("--question", is_flag=True, help="It is a question that somebody has to answer.")
@click.option(
    "--answers",
    type=click.IntRange(1),
    default=None,
    metavar="LINE",
    help="It answers the question in this line of the journal, about the same correction.",
)
@BY
@KEYS
@JOURNAL
def review_comment(
    text: str, crc: str, question: bool, answers: int | None, by: str, key_file: Path, journal: Path | None
) -> None:
    """Write a comment or a question about a correction into the journal; without CRC, about the mission.
    `list` and the page show it.

    A question about a correction is open until a comment answers it. `show`, `list --live`, `kincal status`,
    `arm` and `go` name open ones with their line. `arm` and `go` are refused to a person who has seen the
    correction before somebody else wrote a comment or a question about it.

    \b
    Examples:
    kincal review comment "pose 7 was in shadow" --crc 1a2b3c4d --by "B. Second"
    kincal review comment "why is J3.a_m at its bound?" --question --crc 1a2b3c4d --by "B. Second"
    kincal review comment "its prior is too narrow, known" --answers 12 --by "A. Reviewer"
    """
    from kincal.api.reviews import answered
    from kincal.review import parse_crc, record

    _check_words(by, text)
    keys = file_of(key_file)
    path = FILE_OUT.convert(journals.place(journal, keys), None, None)
    what = journals.QUESTION if question else journals.COMMENT
    number, signer = parse_crc(crc) if crc else 0, signer_of(keys)
    if answers is not None:
        number = answered(path, signer, answers, number, question)
    text_of = f"{number:08x}" if number else ""
    known = not number or any(e.crc == text_of for e in journals.inspect(path, signer.known).entries)
    record(path, what, number, by, text, "", None, signer, answers=answers or 0)
    say(f"recorded in {path}: {what} by {by}")
    if not known:
        say(f"note: it is the first line of this journal about a correction {text_of}; is the CRC right?")


@review.command("history")
@click.argument("logs", nargs=-1, required=True, type=FILE)
@TABLES
@click.option("--report", "report_path", type=REPORT, default=None, help="Also write the page (HTML).")
@KEYS
@JOURNAL
def review_history(
    logs: tuple[Path, ...], tables_dir: Path, report_path: Path | None, key_file: Path, journal: Path | None
) -> None:
    """Say which tables were in force when, and how each coefficient and the monitor went from correction to
    correction.

    Logs are recordings of one mission, in any order. Values have names if their TERMS table is in --tables.

    \b
    Examples:
        kincal review history out/paper/run.lcmlog
        kincal review history ~/.kincal/recordings/*.lcmlog --report out/history.html
    """
    from kincal.api.reviews import history_of, read_journals

    lines = [entry for one in read_journals(logs, journal, key_file) for entry in one.entries]
    found, trends = history_of(logs, tables_dir, lines)
    text.history(console(), found, trends, lines)
    if report_path is not None:
        from kincal.pages import history as pages
        from kincal.pages.page import Provenance, write

        page = pages.page(found, trends, lines, Provenance(today(), table_crcs(tables_dir, ("terms",))))
        say_files("report", [write(page, report_path)], "")


@review.command("watch")
@click.option("--live", is_flag=True, help="Of the flight process at --url; the only source there is.")
@click.option("--forever", is_flag=True, help="Go on when the calibration has ended or a correction waits.")
@click.option("--seconds", type=float, default=None, show_default="until then", help="How long, at most.")
@URL
def review_follow(live: bool, forever: bool, seconds: float | None, url: str) -> None:
    """Watch a calibration: its poses, events with cause and action, and states, as they come.

    It ends when a correction waits for people, or when the calibration has ended.

    \b
    Example:
        kincal review watch --live
    """
    del live
    from kincal.api import operate
    from kincal.cli.text import operate as text

    out, last = console(), ""
    with link.Link(url, operate.LISTEN) as up:
        begun_s = up.clock_s()

        def stop(w: operate.Follower) -> bool:
            nonlocal last
            last = w.ended
            late = seconds is not None and up.clock_s() >= begun_s + seconds
            return late or (bool(w.ended) and not forever)

        for line in operate.follow(up, operate.Snapshot(), stop):
            text.watched(out, line)
    say(last or "nothing has ended")
