"""What to do: every event with its likely causes, as docs/OPERATIONS.md has them; and what an error tells
somebody at a terminal to type, said as the form of the console that does the same."""

from __future__ import annotations

import re
from functools import cache

from kincal.flight.events import event_cause, event_name, event_todo
from kincal_shared.errors import KincalError

_MOST = 2**10
_FORMS = (
    # the whole advice first, then commands alone
    (r"`kincal review show --live [^`]*` shows it and notes that; .* in place of --live",
     "read the page, then write your name at Seen"),
    (r"then write down by `kincal review comment` what", "then write to the journal what"),
    (r"with `kincal review show`, then decide", "and say so at Seen, then decide"),
    (r"say why in at least (\d+) words: --override REASON", r"ARM with an override of at least \1 words"),
    (r"give --by NAME and --why TEXT", "fill in the name and the reason"),
    (r"leave --override out", "send it without an override"),
    (r"^--override$", "Override"),
    (r"`kincal (?:review|command) arm [^`]*--override REASON`", "ARM with an override"),
    (r"`kincal (?:review|command) arm\b[^`]*`", "ARM"),
    (r"`kincal (?:review|command) go [^`]*--keys FILE`", "GO at a console with their key file"),
    (r"`kincal (?:review|command) go\b[^`]*`", "GO"),
    (r"`kincal (?:review|command) reject\b[^`]*`", "Reject"),
    (r"`kincal review comment TEXT --answers (\d+)[^`]*`", r"Answer line \1"),
    (r"`kincal review comment\b[^`]*`", "Write to the journal"),
    (r"`kincal review (?:list|show) --live[^`]*`", "Corrections"),
    (r"`kincal command start\b[^`]*`", "START in Now"),
    (r"`kincal command abort`", "ABORT"),
    (r"`kincal command rollback [0-9a-f]{8}[^`]*`", "Roll back in Corrections"),
    (r"`kincal command activate\b[^`]*`", "Activate in Tables"),
    (r"`kincal table uplink\b[^`]*`", "Send in Tables"),
    (r"`kincal table dump (?!proposal)[^`]*`", "Read back in Tables"),
    (r"`kincal status`", "Now"),
    (r"`kincal audit log` numbers the lines", "open questions stand in Corrections, with their lines"),
    (r"`kincal audit log`", "History"),
)  # fmt: skip
_COMPILED = tuple((re.compile(pattern), form) for pattern, form in _FORMS)


@cache
def dictionary() -> dict[str, dict[str, str]]:
    """Name of an event -> cause, do."""
    names = {number: event_name(number) for number in range(1, _MOST)}
    return {
        name: {"cause": event_cause(number), "do": event_todo(number)}
        for number, name in names.items()
        if name not in ("", "UNKNOWN")
    }


def of_error(error: KincalError) -> str:
    """What, where and what to do here. What is wrong may quote people, whose words stay."""
    return str(KincalError(error.what, in_forms(error.where), in_forms(error.todo)))


def in_forms(text: str) -> str:
    """The text, with what can be done in the console by the name that it has there. Commands without a form
    stay."""
    for pattern, form in _COMPILED:
        text = pattern.sub(form, text)
    return text
