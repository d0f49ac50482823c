"""`kincal command`: what flight accepts from the ground, with the verifiers of each command."""

from __future__ import annotations

import json
import os
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any, TypeVar, Unpack

import click

from kincal import link as links
from kincal.cli.options import FILE, TABLES
from kincal.cli.review import review_arm, review_go, review_reject
from kincal.cli.table import table_dump
from kincal.cli.terminal import console, say
from kincal.cli.wire import Recorded, operator, recorded
from kincal.review import journal as journals
from kincal_shared.errors import BadInput, CommandFailed
from kincal_shared.keys import Signer, file_of, signer_of
from kincal_shared.schema.names import ACQUISITIONS

F = TypeVar("F", bound=Callable[..., Any])
LISTEN_S = 3.0  # for housekeeping, before a command is sent
RECENT = 5  # recordings that are looked through for old corrections


@click.group()
def command() -> None:
    """Send a command to flight, once, and follow it: sent, received, accepted or refused, done, and the event
    that says so.

    Every command is signed with the key file, and goes into the journal: the attempt before it is sent, and
    what came of it. Without a key file only `abort` and `noop` are sent, unsigned and not written down.
    `--dry-run` sends nothing, and names what flight would refuse by
    the last telemetry. If no answer comes, nothing is sent again: the last line says what is known.

    Exit status: 0 done, 1 refused, not answered, or (--dry-run) it would be refused.

    \b
    Example:
    kincal command start --dry-run
    """


class Given(Recorded):
    """What every command is given."""

    as_json: bool
    dry_run: bool


def options(function: F) -> F:
    """Options of every command."""
    dry = click.option("--dry-run", is_flag=True, help="Send nothing; name what flight would refuse.")
    as_json = click.option("--json", "as_json", is_flag=True, help="Print the result as JSON.")
    for option in (as_json, dry):
        function = option(function)
    return recorded(function)


@command.command("noop")
@options
def command_noop(**given: Unpack[Given]) -> None:
    """Is flight there, and does it take signed commands of this key? Without a key file it asks the first
    alone.

    \b
    Example:
        kincal command noop
    """
    from kincal.api import operate

    _run(lambda _snapshot: operate.noop(), given)


@command.command("start")
@click.option(
    "--acquisition",
    default="table",
    show_default="as CONFIG says",
    metavar="NAME",
    help=f"How poses are chosen: {', '.join(('table', *ACQUISITIONS[:-1]))} or {ACQUISITIONS[-1]}.",
)
@click.option(
    "--poses",
    type=click.IntRange(0),
    default=0,
    show_default="as CONFIG says",
    help="Poses to measure, besides the local initial poses of SPACE.",
)
@click.option("--seed", type=click.IntRange(0), default=1, show_default=True, help="Of the random choices.")
@click.option(
    "--coefficients",
    default="",
    metavar="MASK",
    show_default="as CONFIG says",
    help="Bit for each coefficient to estimate, in hexadecimal.",
)
@click.option(
    "--suspects",
    is_flag=True,
    help="Start from the joints that the monitor names; refused if it names none.",
)
@click.option(
    "--joints",
    default="",
    metavar="J,...",
    show_default="all",
    help="Estimate the coefficients of these joints only, by the TERMS of --tables.",
)
@TABLES
@options
def command_start(
    acquisition: str,
    poses: int,
    seed: int,
    coefficients: str,
    suspects: bool,
    joints: str,
    tables_dir: Path,
    **given: Unpack[Given],
) -> None:
    """Begin a calibration: the arm moves.

    \b
    Examples:
        kincal command start --dry-run
        kincal command start --poses 20 --by "A. Operator" --why "after the landing"
        kincal command start --suspects --why "MON_SEVERAL, joints 2 and 4"
        kincal command start --joints 4 --by "A. Operator" --why "MON_SUSPECT, joint 4"
    """
    from kincal.api import operate

    if joints and coefficients:
        raise BadInput("two choices of coefficients", "--joints, --coefficients", "name one of them")
    number = _acquisition(acquisition)
    mask, terms_crc = _mask(coefficients), ""
    if joints:
        mask, terms_crc, names = operate.of_joints(_joints(joints), tables_dir / "terms.tbl")
        say(f"coefficients {mask:x}: {', '.join(names)}", err=True)

    def make(snapshot: Any) -> Any:
        found = next((t.crc for t in snapshot.tables() if t.kind == "terms"), terms_crc)
        if terms_crc and found != terms_crc:
            raise BadInput(
                f"TERMS {found or 'none'} are in force, these are {terms_crc}: their coefficients may differ",
                str(tables_dir / "terms.tbl"),
                "name the folder of those in force by --tables; `kincal table dump terms OUT` gets them",
            )
        return operate.start(number, poses, seed, mask, suspects)

    _run(make, given)


@command.command("abort")
@options
def command_abort(**given: Unpack[Given]) -> None:
    """Hold the arm and end the calibration, in every state; needs no key. START afterwards begins anew.

    \b
    Example:
        kincal command abort
    """
    from kincal.api import operate

    _run(lambda _snapshot: operate.abort(), given)


@command.command("rollback")
@click.argument("crc", required=False)
@click.option(
    "--from",
    "logs",
    multiple=True,
    type=FILE,
    help="Log or KIN table that holds the corrections, for the preview.  [may be given several times]",
)
@click.option(
    "--space",
    type=FILE,
    default=None,
    help="Description of the SPACE table, for clearance and reach.  [default: beside the tables]",
)
@TABLES
@options
def command_rollback(
    crc: str | None,
    logs: tuple[Path, ...],
    space: Path | None,
    tables_dir: Path,
    **given: Unpack[Given],
) -> None:
    """Bring back the correction before the one in force. CRC: of the one in force, eight hex digits; without
    it the preview is shown and nothing is sent.

    The preview is what changes back, and clearance and reach of the arm as the table before has it, against
    the one in force, as `kincal review show` has them for a proposal. Reasons against it do not stop a
    rollback.

    \b
    Examples:
    kincal command rollback                  # what would change back, and the command to do it
    kincal command rollback 1a2b3c4d --by "A. Operator" --why "tool misses by 3 mm since"
    """
    from kincal.api import operate
    from kincal.review import parse_crc

    wanted = None if crc is None else parse_crc(crc)
    if wanted is None:
        given["dry_run"] = True
    preview = Preview(tuple(logs), tables_dir, space)
    _run(lambda s: operate.rollback(_in_force(s) if wanted is None else wanted), given, preview)


@command.command("validate")
@click.argument("kind")
@click.argument("crc")
@options
def command_validate(kind: str, crc: str, **given: Unpack[Given]) -> None:
    """Let flight check the staged table; `kincal table uplink` does this, and activates it.

    \b
    Example:
        kincal command validate config 1a2b3c4d
    """
    from kincal.api import operate
    from kincal.review import parse_crc

    request = operate.validate(kind, parse_crc(crc))
    _run(lambda _snapshot: request, given)


@command.command("activate")
@click.argument("kind")
@click.argument("crc")
@options
def command_activate(kind: str, crc: str, **given: Unpack[Given]) -> None:
    """Put the staged and checked table in force; `kincal table uplink` does this.

    \b
    Example:
        kincal command activate config 1a2b3c4d
    """
    from kincal.api import operate
    from kincal.review import parse_crc

    request = operate.activate(kind, parse_crc(crc))
    _run(lambda _snapshot: request, given)


@command.command("discard")
@options
def command_discard(**given: Unpack[Given]) -> None:
    """Drop what is staged.

    \b
    Example:
        kincal command discard
    """
    from kincal.api import operate

    _run(lambda _snapshot: operate.discard(), given)


# Decisions about a correction, and a dump, are the same commands as in their own groups.
command.add_command(review_arm, "arm")
command.add_command(review_go, "go")
command.add_command(review_reject, "reject")
command.add_command(table_dump, "dump")


# ---- sending


@dataclass(frozen=True)
class Preview:
    """What the preview of a rollback is made from: logs and KIN tables with the corrections, tables in force,
    description of their SPACE."""

    logs: tuple[Path, ...] = ()
    tables_dir: Path = Path()
    space: Path | None = None


def _run(make: Callable[[Any], Any], given: Given, preview: Preview = Preview()) -> None:  # noqa: B008
    """Listen for the state, then send and follow, or say what speaks against it."""
    from kincal.api import operate
    from kincal.cli.text import operate as text

    out = console()
    signer = _signer(given)
    with links.Link(given["url"], operate.LISTEN, signer=signer) as link:
        snapshot = operate.Snapshot()
        request = make(snapshot)
        if request.opcode != "ABORT":  # which waits for nothing
            operate.listen(link, snapshot, LISTEN_S, lambda s: _enough(s, request.opcode))
            request = make(snapshot)
        if given["dry_run"]:
            _dry_run(request, snapshot, link, given, preview)
            return
        if snapshot.hk is None and request.opcode != "ABORT":
            raise CommandFailed(
                f"nothing was sent: no housekeeping within {LISTEN_S:g} s",
                given["url"],
                "is flight running on this URL? `kincal status`; ABORT is sent all the same",
            )
        if signer is None:
            why = _unsigned(given["key_file"])
            click.echo(f"{why}: {request.opcode} is sent without a signature, which flight takes", err=True)
        tell = (lambda _step: None) if given["as_json"] else (lambda step: text.step(out, step))
        tracked = operate.act(link, request, _operator(given), snapshot, tell)
    if given["as_json"]:
        click.echo(json.dumps(tracked.as_dict(), indent=1))
    else:
        text.last_line(out, tracked)
    if tracked.outcome != operate.DONE:
        raise SystemExit(1)


def _enough(snapshot: Any, opcode: str) -> bool:
    """What the conditions of a command are judged by has come."""
    wanted = ["KC_HK", *(("KC_ARM_STATE", "KC_PANTILT_STATE") if opcode == "START" else ())]
    return all(snapshot.last(channel) is not None for channel in wanted)


def _dry_run(request: Any, snapshot: Any, link: links.Link, given: Given, preview: Preview) -> None:
    from kincal.api import operate
    from kincal.cli.text import operate as text

    now_s = link.clock_s()
    found, age = operate.unmet(request, snapshot, now_s), snapshot.freshness("KC_HK", now_s)
    if link.signer is None and request.opcode not in operate.UNSIGNED:
        found = (operate.Unmet("a key to sign with", why_no_key(given["key_file"]), "`kincal key`"), *found)
    if given["as_json"]:
        said = [{"condition": u.condition, "found": u.found, "todo": u.todo} for u in found]
        back = _rolled_back(snapshot, preview) if request.opcode == "ROLLBACK" else None
        click.echo(json.dumps({
            "command": request.opcode, "state": snapshot.state, "housekeeping": age.status,
            "housekeeping_age_s": age.receive_age_s, "unmet": said, "sent": False,
            **({} if back is None else {"rollback": back if isinstance(back, str) else back.as_dict()}),
        }, indent=1))  # fmt: skip
    else:
        if request.opcode == "ROLLBACK":
            _preview(snapshot, preview)
        text.unmet(console(), request.opcode, found, age, snapshot.state)
        if link.signer is None and request.opcode in operate.UNSIGNED:
            why = _unsigned(given["key_file"])
            say(f"{why}: it would be sent without a signature, which flight takes, and written nowhere")
    if found:
        raise SystemExit(1)


def _preview(snapshot: Any, preview: Preview) -> None:
    """What a rollback brings back, as far as tables and logs here hold it."""
    from kincal.cli.text import review as text

    found = _rolled_back(snapshot, preview)
    if found is None:
        return  # said with the conditions
    if isinstance(found, str):
        say(f"no preview: {found}")
        return
    text.rolled_back(console(), found)
    click.echo(f"to do it: kincal command rollback {_in_force(snapshot):08x} --by NAME --why REASON")


def _rolled_back(snapshot: Any, preview: Preview) -> Any:
    """The preview, or why there is none; None without housekeeping."""
    from kincal.api import previews
    from kincal.operate.recording import recordings

    if snapshot.hk is None:
        return None
    places, before = (*preview.logs, *recordings()[:RECENT]), snapshot.hk.kin_prev_crc
    try:
        return previews.what_rolls_back(
            snapshot.hk.table_crc, before, preview.tables_dir, places, preview.space
        )
    except BadInput as error:
        return str(error)


def _in_force(snapshot: Any) -> int:
    """CRC of the correction in force, 0 if it is not known."""
    return next((int(t.crc, 16) for t in snapshot.tables() if t.kind == "kin" and t.crc), 0)


def _signer(given: Given) -> Signer | None:
    """None if there are no usable keys: ABORT needs none. NOOP needs none either, but with a key file asks
    whether flight takes it: with one that cannot be used there is nothing to ask."""
    try:
        return signer_of(file_of(given["key_file"]))
    except BadInput:
        name = click.get_current_context().info_name
        if no_key_file(given["key_file"]) if name == "noop" else name == "abort" or given["dry_run"]:
            return None
        raise


def no_key_file(named: Path) -> bool:
    """Whether there is no key file, rather than one that cannot be used."""
    try:
        return not os.path.lexists(file_of(named))
    except BadInput:
        return False


def _unsigned(named: Path) -> str:
    return "no key file" if no_key_file(named) else why_no_key(named)


def why_no_key(key_file: Path) -> str:
    """Why nothing can be signed with a key file; empty if it can."""
    try:
        signer_of(file_of(key_file))
    except BadInput as error:
        return f"{error.what} ({error.where})"
    return ""


def _operator(given: Given) -> Any:
    if click.get_current_context().info_name != "abort":
        return operator(given)
    from kincal.review.decisions import Operator

    journal = journals.place(given["journal"], file_of(given["key_file"]))
    return Operator(given["by"], given["why"], journal, given["timeout_s"], lambda said: say(said, err=True))


def _acquisition(name: str) -> int:
    from kincal.flight import library

    known = {"table": -1} | {
        key.lower(): number
        for key, number in library("flight").enum("kc_acq_t", "KC_ACQ_").items()
        if key != "COUNT"
    }
    if name.lower() not in known:
        raise BadInput(f"{name!r} is no acquisition", "--acquisition", f"one of {', '.join(known)}")
    return known[name.lower()]


def _joints(text: str) -> tuple[int, ...]:
    try:
        return tuple(int(joint) for joint in text.split(","))
    except ValueError:
        raise BadInput(f"{text!r} are no joints", "--joints", "numbers from 1, by comma: 2,4") from None


def _mask(text: str) -> int:
    try:
        mask = int(text, 16) if text else 0
    except ValueError:
        mask = -1
    if not 0 <= mask < 1 << 63:
        raise BadInput(f"{text!r} is no mask of coefficients", "--coefficients", "hexadecimal digits, as 1f")
    return mask
