"""Tables that are sent or read back stand in the journal, as every signed command: the attempt before, what
came of it after; on the command line, in the console, and where the journal is checked."""

import pytest
from commands import shell, text_of
from direct_flight import DirectFlight
from fake_flight import FakeFlight
from places import BIN
from samples import signed
from test_journal import log_of

import kcm
from kincal import tables
from kincal.api import operate
from kincal.flight.tables import kind_number
from kincal.pages import history as pages
from kincal.pages.page import Provenance
from kincal.review import decisions, history, journal
from kincal_shared.errors import BadInput, CommandFailed, NoAnswer
from kincal_shared.keys import signer_of

CONFIG = tables.load(BIN / "config.tbl")[0]
NUMBER = kind_number("config")
CMD = kcm.cmd_t


@pytest.fixture
def who(tmp_path):
    return decisions.Operator("A. Operator", "fewer poses", tmp_path / "review.jsonl", 2.0)


@pytest.fixture
def flight(own_key_file):
    one = DirectFlight(signer_of(own_key_file))
    one.hk.table_crc[NUMBER] = signed(0xABCD1234)
    return one


def lines(who, key_file):
    return journal.read(who.journal, signer_of(key_file).known).entries


def test_an_uplink_is_written_before_and_after(flight, who, own_key_file):
    operate.uplink(flight, CONFIG, who, 5.0)
    written = lines(who, own_key_file)
    assert [(e.decision, e.command, e.kind, e.crc, e.by, e.why) for e in written] == [
        ("attempt", "TABLE_ACTIVATE", "CONFIG", CONFIG.crc_text, "A. Operator", "fewer poses"),
        ("table_activate", "TABLE_ACTIVATE", "CONFIG", CONFIG.crc_text, "A. Operator", "fewer poses"),
    ]
    assert [e.words for e in written] == [
        "attempt: put the CONFIG table in force",
        "CONFIG table put in force",
    ]
    assert written[0].counter < flight.chunks[0].counter < written[1].counter == flight.commands[-1].counter
    assert journal.unfinished(written) == []


@pytest.mark.parametrize("opcode", [CMD.TABLE_VALIDATE, CMD.TABLE_ACTIVATE])
def test_a_refused_uplink_is_written_as_refused_with_the_reason(flight, who, own_key_file, opcode):
    flight.refuse[opcode] = (-8, 31)
    with pytest.raises(CommandFailed):
        operate.uplink(flight, CONFIG, who, 5.0)
    last = lines(who, own_key_file)[-1]
    assert last.words == "refused: put the CONFIG table in force" and "TBL_BUSY" in last.why
    assert journal.unfinished(lines(who, own_key_file)) == []


def test_what_flight_has_taken_is_written_though_its_crc_is_not_seen(flight, who, own_key_file):
    flight.ignores.add(CMD.TABLE_ACTIVATE)
    with pytest.raises(NoAnswer, match="the new CRC"):
        operate.uplink(flight, CONFIG, who, 5.0)
    assert lines(who, own_key_file)[-1].decision == "table_activate"


def test_without_a_journal_nothing_is_sent(flight, who):
    who.journal.mkdir()
    for call in (
        lambda: operate.uplink(flight, CONFIG, who, 5.0),
        lambda: operate.read_back(flight, "config", who, 5.0),
    ):
        with pytest.raises(BadInput, match="journal"):
            call()
    assert (flight.commands, flight.chunks) == ([], [])


def test_a_table_that_flight_took_but_nobody_wrote_down_is_said(flight, who, monkeypatch):
    real = operate.uplink.__globals__["record"]

    def once(journal_file, what, *args, **kwargs):
        if what == "table_activate":
            raise BadInput("no space left")
        return real(journal_file, what, *args, **kwargs)

    monkeypatch.setitem(operate.uplink.__globals__, "record", once)
    with pytest.raises(
        CommandFailed, match="flight took TABLE_ACTIVATE, but the journal has only the attempt"
    ):
        operate.uplink(flight, CONFIG, who, 5.0)


def test_a_read_back_is_written_with_the_crc_in_force(flight, who, own_key_file):
    flight.holds = {NUMBER: CONFIG.data}
    assert operate.read_back(flight, "config", who, 5.0).data == CONFIG.data
    written = lines(who, own_key_file)
    assert [(e.words, e.crc) for e in written] == [
        ("attempt: read back the CONFIG table", "abcd1234"),
        ("CONFIG table read back", "abcd1234"),
    ]
    flight.holds = {1: b""}
    with pytest.raises(CommandFailed, match="TABLE_DUMP refused"):
        operate.read_back(flight, "config", who, 5.0)
    flight.holds = {NUMBER: CONFIG.data[:1500]}
    with pytest.raises(NoAnswer, match="dump"):  # not all of it came
        flight.dump = lambda *_: None
        operate.read_back(flight, "config", who, 5.0)
    assert [e.words.split(":")[0] for e in lines(who, own_key_file)[2:]] == [
        "attempt", "refused", "attempt", "unanswered"]  # fmt: skip


def test_the_command_line_writes_who_and_why(tmp_path, own_key_file):
    named = ("--keys", own_key_file, "--by", "A. Operator", "--why", "new plan")
    with FakeFlight() as flight:
        to = ("--url", flight.url, *named)
        assert shell("table", "uplink", BIN / "config.tbl", *to).exit_code == 0
        assert shell("table", "dump", "config", tmp_path / "back.tbl", *to).exit_code == 0
    with FakeFlight(refuse=(CMD.TABLE_VALIDATE,)) as flight:
        assert shell("table", "uplink", BIN / "config.tbl", "--url", flight.url, *named).exit_code == 1
    listed = " ".join(shell("audit", "log", "--keys", own_key_file).output.split())
    put = "put the CONFIG table in force"
    said = (f"attempt: {put}", "CONFIG table put in force", "CONFIG table read back", f"refused: {put}")
    for words in (*said, "A. Operator", "new plan"):
        assert words in listed
    verified = shell("audit", "verify", "--keys", own_key_file)
    assert verified.exit_code == 0 and "2 decisions and commands in 6 lines" in " ".join(
        verified.output.split()
    )


@pytest.mark.parametrize(
    ("opcode", "args", "said"),
    [
        (CMD.TABLE_ACTIVATE, (NUMBER, 0x1234ABCD), "CONFIG table put in force (1234abcd)"),
        (CMD.TABLE_DUMP, (NUMBER,), "CONFIG table read back"),
        (CMD.TABLE_DUMP, (16,), "proposed KIN table read back"),
        (CMD.ROLLBACK, (0x1234ABCD,), "rollback of 1234abcd"),
        (CMD.START, (0,), "start"),
    ],
)
def test_what_flight_took_and_the_journal_lacks_is_named(own_key_file, tmp_path, opcode, args, said):
    m = CMD()
    m.source, m.opcode, m.seq = m.SRC_GROUND, opcode, 7
    m.arg_i = [signed(a) for a in args] + [0] * (4 - len(args))
    log = log_of(tmp_path / "run.lcmlog", [signer_of(own_key_file).command(m)])
    found = shell("audit", "verify", log, "--keys", own_key_file)
    assert found.exit_code == 1 and f"{said} (key 1, counter" in text_of(found)


def test_the_history_lists_what_was_sent_in_words(flight, who, own_key_file):
    operate.uplink(flight, CONFIG, who, 5.0)
    flight.holds = {NUMBER: CONFIG.data}
    operate.read_back(flight, "config", who, 5.0)
    entries = lines(who, own_key_file)
    page = pages.page(history.History(), [], entries[:-1], Provenance("2026-01-01"))
    (section,) = [s for s in page.sections if s.key == "journal"]
    rows = [[c.text for c in row] for row in section.grid.rows]
    assert [row[1] for row in rows] == [
        "attempt: read back the CONFIG table",
        "CONFIG table put in force",
        "attempt: put the CONFIG table in force",
    ]
    assert "Nothing says what came of it" in rows[0][5] and rows[1][2:] == [
        CONFIG.crc_text, "A. Operator", "1", "fewer poses"]  # fmt: skip
    empty = pages.page(history.History(), [], [], Provenance("2026-01-01"))
    assert "no line" in next(s for s in empty.sections if s.key == "journal").text
