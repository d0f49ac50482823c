"""The summary of a log as text."""

from __future__ import annotations

from rich.console import Console
from rich.markup import escape

from kincal.cli.text.layout import grid
from kincal.cli.text.run import POSE_HEAD, pose_line
from kincal.link import LogSummary, Session, crc_text, names
from kincal.operate.snapshot import utc_text
from kincal.results import PoseLine, length_text

_REAL_CLOCK_US = range(10**15, 10**16)  # mission time that is the real clock: from 2001 to 2286


def _damaged(s: LogSummary, channel: str) -> str:
    """How many messages of a channel are damaged, and which."""
    n, at = s.undecodable[channel], s.undecodable_at.get(channel, [])
    if not n:
        return ""
    more = ", ..." if n > len(at) else ""
    return f" ({n} damaged: event{'s' if n > 1 else ''} {', '.join(map(str, at))}{more})"


def show(out: Console, s: LogSummary, debug: bool) -> None:
    """Print what a log holds: channels, sessions, events; debug events if asked for."""
    out.print(f"[bold]{escape(str(s.path))}[/]: {s.n_messages} messages, {s.mission_s:.1f} s of mission time")
    rows = grid("", "channel", "messages", right=(1,))
    for name, n in sorted(s.counts.items()):
        rows.add_row(escape(name), f"{n}{_damaged(s, name)}")
    out.print(rows)
    if s.damaged:
        places = "place of the file was" if s.damaged == 1 else "places of the file were"
        out.print(f"[yellow]{s.damaged} damaged {places} passed over[/]")
    for session in s.sessions.values():
        _session(out, session)
    real = all(e.t_us in _REAL_CLOCK_US for e in s.events)
    rows = grid("\nEvents", "UTC" if real else "time [s]", "severity", "text", right=(0,))
    for e in s.events:
        if e.severity != "debug" or debug:
            when = utc_text(e.t_us * 1e-6)[:19] + "Z" if real else f"{e.t_us * 1e-6:.1f}"
            rows.add_row(when, e.severity, escape(e.text))
    out.print(rows)
    refused = [a for a in s.acks if a.status != 0]
    out.print(f"\n{len(s.commands)} commands, {len(s.acks)} answers, {len(refused)} refused")
    if s.hk is not None:
        out.print(
            f"last state {names.state_name(s.hk.state)}, kinematics table "
            f"{crc_text(s.hk.table_crc[4])}, boots {s.hk.boot_count}"
        )


def _session(out: Console, session: Session) -> None:
    out.print(f"\n[bold]calibration {session.number}[/]: {len(session.progress)} poses")
    if session.progress:
        out.print(POSE_HEAD.removesuffix("     held-out"))
    for p in session.progress:
        out.print(pose_line(PoseLine.of(p), p.n_goal))
    if (proposal := session.proposal) is not None:
        out.print(
            f"proposal {crc_text(proposal.crc)}: {names.verdict_name(proposal.verdict)}, rank "
            f"{proposal.rank} of {proposal.n_free}, p of the fit {proposal.p_fit:.3f}, residual "
            f"{length_text(proposal.before_pos_m)} -> {length_text(proposal.fit_pos_m)}"
        )
