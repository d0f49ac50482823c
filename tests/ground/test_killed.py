"""A program of the ground is killed at each step of an approval, flight is started again, the link is cut:
nothing is done twice, nothing is lost, and what is offered next is right."""

import contextlib
import gc
import json
import os
import signal
import socket
import threading
import urllib.error
import urllib.request
import warnings

import pytest
import uvicorn
from commands import shell, text_of
from waiting_flight import WaitingFlight

import kcm
from kincal import link as links
from kincal.console.app import Console, make_app
from kincal.console.desk import Desk
from kincal.console.geometry import Geometry
from kincal.console.guard import Access
from kincal.console.picture import Picture
from kincal.console.sources import Live
from kincal.review import decisions, find, journal
from kincal_shared import keys
from kincal_shared.errors import CommandFailed, NoAnswer

ARM, GO = kcm.cmd_t.APPROVE_ARM, kcm.cmd_t.APPROVE_GO
PATIENCE_S = 30.0
pytestmark = pytest.mark.filterwarnings("ignore:.*fork:DeprecationWarning")


@pytest.fixture
def flight(made, tmp_path):
    with WaitingFlight(made, tmp_path) as waiting:
        waiting.journal = tmp_path / "journal.jsonl"
        yield waiting


# ---- where it is killed


def die():
    os.kill(os.getpid(), signal.SIGKILL)


def die_at(where, what):
    """In this process: before or after the line `what` is written, between it and its end mark, or after the
    command `what` was sent."""
    append, write_end, send = journal.append, journal._write_end, links.CommandLink.send

    def appending(path, entry, signer, check=None):
        if (where, what) == ("before", entry.decision):
            die()
        if (where, what) == ("between", entry.decision):
            journal._write_end = lambda *_: die()
        entry = append(path, entry, signer, check)
        if (where, what) == ("after", entry.decision):
            die()
        return entry

    def sending(self, opcode, *args, **more):
        number = send(self, opcode, *args, **more)
        if (where, what) == ("sent", opcode):
            die()
        return number

    journal.append, journal._write_end, links.CommandLink.send = appending, write_end, sending


def forked(work):
    """A process that does this; its number."""
    gc.collect()  # an LCM that is still to be collected would be closed by the child, which lacks its thread
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        child = os.fork()
    if child == 0:
        status = 1
        with contextlib.suppress(BaseException):
            work()
            status = 0
        os._exit(status)
    return child


def killed(child):
    return os.waitstatus_to_exitcode(os.waitpid(child, 0)[1]) == -signal.SIGKILL


# ---- one step of an approval


def operator(flight, by):
    return decisions.Operator(by, "clean", flight.journal, PATIENCE_S)


def see(flight, by, key_file):
    review = find(flight.made.log, flight.made.text, flight.tables)
    decisions.see(flight.journal, review, by, flight.made.log, keys.signer_of(key_file))


def arm(flight):
    with links.Link(flight.url, signer=keys.signer_of(flight.first)) as up:
        decisions.arm(up, flight.made.text, operator(flight, "A"))


def go(flight):
    with links.Link(flight.url, signer=keys.signer_of(flight.second)) as up:
        decisions.go(up, flight.made.text, operator(flight, "B"))


STEPS = {"see": lambda f: see(f, "A", f.first), "arm": arm, "go": go}


def offered(flight):
    """The step that comes next, by flight's state and the journal."""
    with links.Link(flight.url) as up:
        waits = decisions.on_board(up, PATIENCE_S)
    if waits.crc != flight.made.crc:
        return "nothing"
    if waits.armed:
        assert waits.armed_key == 1 and waits.left_s > 0.0 and "key 1" in waits.other_than
        return "go"
    keys_of = keys.read(flight.first)
    return "arm" if journal.read(flight.journal, keys_of).seen_by("A", flight.made.text) else "see"


def audit(flight):
    both = flight.first.with_name("both.keys")
    keys.join(both, (flight.first, flight.second))
    given = ["audit", "verify", "--journal", str(flight.journal), "--keys", str(both)]
    return shell(*given)


def begin(flight, until):
    """Everything before a step."""
    if until == "see":
        return
    see(flight, "A", flight.first)
    see(flight, "B", flight.second)
    if until == "go":
        arm(flight)
        flight.until(lambda: flight.state == "ARMED")


def finish(flight, restarted):
    """The tool goes on where it stands, until the correction is in force; nothing was taken twice."""
    before = flight.in_force
    for _ in range(4):
        step = offered(flight)
        if step == "nothing":
            break
        if step == "see":
            see(flight, "A", flight.first)
        elif step == "arm":
            if not journal.read(flight.journal, keys.read(flight.second)).seen_by("B", flight.made.text):
                see(flight, "B", flight.second)
            arm(flight)
        else:
            go(flight)
    assert flight.in_force == flight.made.crc
    assert flight.taken.count(GO) == 1 and 1 <= flight.taken.count(ARM) <= 1 + restarted
    assert len(flight.commands) == len(flight.taken)  # what was sent was taken, and sent once
    assert flight.hk.proposal_crc == 0 and flight.state == "IDLE"
    rolled = before if before != flight.made.crc else None
    assert rolled is None or rolled != flight.in_force
    assert audit(flight).exit_code == 0, audit(flight).output


# step, where it is killed, what flight has taken of it then, what is offered next, and after a restart. Dying
# just before the line that follows a command is "sent" again: flight and journal are the same, and only the
# program that dies has heard an answer.
DEATHS = [
    ("see", "before", "seen", [], "see", "see"),
    ("see", "between", "seen", [], "arm", "arm"),
    ("arm", "after", "attempt", [], "arm", "arm"),
    ("arm", "sent", "APPROVE_ARM", [ARM], "go", "arm"),
    ("arm", "between", "arm", [ARM], "go", "arm"),
    ("arm", "after", "arm", [ARM], "go", "arm"),
    ("go", "after", "attempt", [], "go", "arm"),
    ("go", "sent", "APPROVE_GO", [GO], "nothing", "nothing"),
    ("go", "between", "approve", [GO], "nothing", "nothing"),
    ("go", "after", "approve", [GO], "nothing", "nothing"),
]
# A restart changes flight, not the journal: one row for each state of flight, not armed, armed by the killed
# program or before it, in force.
RESTARTS = [row for row in DEATHS if row[:2] in {("see", "between"), ("arm", "sent"), ("go", "sent")}]
RESTARTS += [row for row in DEATHS if row[:3] == ("go", "after", "attempt")]
COLUMNS = ("step", "where", "what", "taken", "next_")


@pytest.mark.parametrize(
    (*COLUMNS, "restarted"),
    [(*row[:5], False) for row in DEATHS] + [(*row[:4], row[5], True) for row in RESTARTS],
)
def test_a_killed_program_leaves_what_the_next_one_goes_on_from(
    flight, step, where, what, taken, next_, restarted
):
    begin(flight, step)
    n = len(flight.taken)

    def work():
        die_at(where, what)
        STEPS[step](flight)

    assert killed(forked(work))
    flight.until(lambda: len(flight.taken) == n + len(taken))
    assert flight.taken[n:] == taken
    if restarted:
        flight.restart()
    assert audit(flight).exit_code == 0 or not flight.journal.exists(), audit(flight).output
    assert offered(flight) == next_
    finish(flight, restarted)


def test_what_was_begun_and_never_written_to_its_end_is_named(flight):
    """Flight took GO, the line that says so is missing: the attempt names who sent it, and a log shows it."""
    begin(flight, "go")

    def work():
        die_at("before", "approve")
        go(flight)

    assert killed(forked(work))
    flight.until(lambda: flight.in_force == flight.made.crc)
    found = journal.read(flight.journal, keys.read(flight.second))
    left = journal.unfinished(found.entries)
    assert [(e.command, e.by, e.key_id) for e in left] == [("APPROVE_GO", "B", 101)]
    shown = shell("audit", "log", "--journal", flight.journal, "--keys", flight.second)
    text = text_of(shown)
    assert f"look at: attempt APPROVE_GO {flight.made.text} by B" in text
    assert "nothing says what came of it" in text


def test_nothing_is_left_open_where_every_attempt_has_its_end(flight):
    begin(flight, "go")
    with pytest.raises(CommandFailed, match="another key"):
        decide_wrongly(flight)
    go(flight)
    both = keys.read(flight.first) + keys.read(flight.second)
    assert journal.unfinished(journal.read(flight.journal, both).entries) == []


def decide_wrongly(flight):
    with links.Link(flight.url, signer=keys.signer_of(flight.first)) as up:
        decisions.go(up, flight.made.text, operator(flight, "A"))


# ---- the link is cut


@pytest.mark.parametrize(("step", "opcode"), [("arm", ARM), ("go", GO)])
def test_a_command_on_a_cut_link_is_sent_once_and_again_only_when_somebody_says_so(
    flight, step, opcode, monkeypatch
):
    begin(flight, step)
    sent, send = len(flight.commands), links.CommandLink.send

    def cutting(self, *args, **more):
        flight.cut.set()
        return send(self, *args, **more)

    monkeypatch.setattr(links.CommandLink, "send", cutting)
    who = decisions.Operator("A" if step == "arm" else "B", "clean", flight.journal, 0.5)
    with links.Link(
        flight.url, signer=keys.signer_of(flight.first if step == "arm" else flight.second)
    ) as up:
        up.next(PATIENCE_S)
        who_waits = decisions.Operator(who.by, who.why, who.journal, 2.0)
        with pytest.raises(NoAnswer):
            (decisions.arm if step == "arm" else decisions.go)(up, flight.made.text, who_waits)
    flight.until(lambda: len(flight.commands) == sent + 1)
    assert flight.commands[-1][0] == opcode and opcode not in flight.taken
    found = journal.read(flight.journal, keys.read(flight.first) + keys.read(flight.second))
    assert found.entries[-1].decision == "unanswered"
    monkeypatch.undo()
    flight.cut.clear()
    assert offered(flight) == step
    STEPS[step](flight)
    if step == "arm":
        flight.until(lambda: flight.state == "ARMED")
        go(flight)
    assert flight.in_force == flight.made.crc and flight.taken == [ARM, GO]
    assert len(flight.commands) == 3  # the lost one, and two that were taken
    assert audit(flight).exit_code == 0


# ---- the console's server


class Server:
    """A console in a process of its own, on a port that stays; `death`: where it is killed."""

    def __init__(self, flight, key_file):
        self.flight, self.key_file, self.geometry = flight, key_file, Geometry(flight.tables)
        self.heard = flight.proposal()
        with socket.socket() as s:
            s.bind(("127.0.0.1", 0))
            self.access = Access(s.getsockname()[1])
        self.child = 0

    def start(self, death=None):
        self.child = forked(lambda: self._serve(death))
        wait_for_port(self.access.port)

    def _serve(self, death):
        if death:
            die_at(*death)
        picture = Picture(self.geometry)
        for channel, message in self.heard:
            picture.add(channel, message)
        flight = self.flight
        desk = Desk(flight.url, self.key_file, flight.journal, flight.tables, picture, PATIENCE_S)
        app = make_app(Console(flight.url, self.geometry, picture, desk), self.access)
        with Live(flight.url, picture):
            threading.current_thread()
            uvicorn.Server(uvicorn.Config(app, port=self.access.port, log_level="error")).run()

    def stop(self):
        os.kill(self.child, signal.SIGKILL)
        os.waitpid(self.child, 0)

    def ask(self, path, body=None):
        data = None if body is None else json.dumps(body).encode()
        at = f"http://127.0.0.1:{self.access.port}"
        headers = {"Cookie": f"kincal_{self.access.port}={self.access.token}", "Origin": at,
                   "Content-Type": "application/json"}  # fmt: skip
        with urllib.request.urlopen(
            urllib.request.Request(f"{at}/api/{path}", data, headers), timeout=60
        ) as answer:
            return json.load(answer)


def wait_for_port(port):
    for _ in range(2000):
        with contextlib.suppress(OSError), socket.create_connection(("127.0.0.1", port), timeout=1):
            return
        threading.Event().wait(0.01)
    raise AssertionError("the server does not listen")


SERVER_DEATHS = [row for row in DEATHS if row[1] != "between" and row[:2] != ("arm", "after")]


@pytest.mark.parametrize(COLUMNS, [row[:5] for row in SERVER_DEATHS])
def test_a_killed_server_answers_the_same_request_once_more_and_does_nothing_twice(
    flight, step, where, what, taken, next_
):
    """The browser sends a request again with its number when the answer was lost."""
    begin(flight, step)
    n, crc = len(flight.taken), flight.made.text
    server = Server(flight, flight.second if step == "go" else flight.first)
    server.start((where, what))
    by = "B" if step == "go" else "A"
    path = f"review/{crc}/{'seen' if step == 'see' else step}"
    page = server.ask(f"review/{crc}")
    body = {"number": "the-number", "by": by, "shown": page["shown"], "why": "clean"}
    with pytest.raises((urllib.error.URLError, ConnectionError)) as lost:
        server.ask(path, body)
    assert not isinstance(lost.value, urllib.error.HTTPError), lost.value.read()
    assert killed(server.child)
    flight.until(lambda: len(flight.taken) == n + len(taken))

    server.start()
    flight.until(lambda: server.ask(f"review/{crc}")["waits"] == (next_ != "nothing"))
    assert offered(flight) == next_
    lines = server.ask("journal")
    open_ = [line for line in lines if line["unfinished"]]
    assert [(line["decision"], line["by"]) for line in open_] == (
        [("attempt", by)] if step != "see" and what != "approve" else []
    )
    sent = len(flight.commands)
    try:
        answer = server.ask(path, body)
    except urllib.error.HTTPError as error:
        answer = json.load(error)
    assert answer["ok"] == (not taken)  # what flight has taken is not sent once more: its state says so
    assert len(flight.commands) == sent + (0 if taken or step == "see" else 1)
    server.stop()
    finish(flight, restarted=False)
