"""The console while something else is wrong: clocks that are set, two flights, two consoles, threads that all
wait, requests that are none."""

import json
import re
import resource
import socket
import subprocess
import sys
import threading
import time
import urllib.parse
import urllib.request
from contextlib import suppress
from pathlib import Path

import pytest
from fake_flight import FakeFlight
from samples import CRC, event, progress, proposal
from starlette.testclient import TestClient
from test_console import ACCESS, BIN, GOOD, JSON, ORIGIN, hk, next_of, wait_for
from test_console import feed as feed_of

import kcm
from kincal.console.app import Console, make_app
from kincal.console.desk import Desk
from kincal.console.memory import Memory
from kincal.console.picture import Clock, Cursor, Picture
from kincal.console.sources import Recording
from kincal.operate.recording import Recorder
from kincal_shared.errors import BadInput, NoAnswer
from kincal_sim.ports import private_port, private_url


@pytest.fixture
def client(picture, own_key_file):
    desk = Desk("memq://", own_key_file, None, BIN, picture, timeout_s=0.2)
    return TestClient(make_app(Console("memq://", picture.geometry, picture, desk), ACCESS), base_url=ORIGIN)


class Machine:
    """Two clocks of a machine: one that is set, one that only goes forward."""

    def __init__(self):
        self.wall_s, self.steady_s = 1_795_000_000.0, 500.0

    def passes(self, seconds):
        self.wall_s += seconds
        self.steady_s += seconds

    def clock(self):
        return Clock(lambda: self.wall_s, lambda: self.steady_s)


def ages(message):
    return {name: round(message["now_s"] - v["received_s"], 3) for name, v in message["values"].items()}


# ---- clocks


@pytest.mark.parametrize("jump_s", [-3600.0, 3600.0, -5.0])
def test_ages_stay_right_when_the_clock_of_the_machine_is_set(geometry, jump_s):
    """An hour back, and what was heard last was fresh for an hour; an hour on, and all was stale."""
    machine = Machine()
    picture = Picture(geometry, machine.clock())
    picture.add("KC_HK", hk())
    picture.add("KC_PROGRESS", progress(0))
    message, cursor = picture.snapshot()
    machine.passes(10.0)
    machine.wall_s += jump_s
    change = picture.changes(cursor)
    assert ages(change)["KC_HK"] == ages(change)["poses"] == 10.0
    assert change["now_s"] == machine.wall_s
    assert [(r["name"], r["text"].split(" s;")[0]) for r in change["rows"]] == [
        ("CLOCK_SET", f"the clock of this machine was set by {jump_s:+.0f}")
    ]
    assert picture.changes(cursor) is None
    assert ages(picture.snapshot()[0])["KC_HK"] == 10.0
    assert message["values"]


# ---- two of something


def housekeeping(t_s, boot_count, state):
    m = hk(state)
    m.t_us, m.boot_count = int(t_s * 1e6), boot_count
    return m


def test_two_flights_on_one_network_are_said_and_no_state_passes_for_known(geometry):
    machine = Machine()
    picture, cursor = Picture(geometry, machine.clock()), Cursor()
    for k in range(8):
        picture.add("KC_HK", housekeeping(1000.0 + k, 4, 0) if k % 2 else housekeeping(10.0 + k, 3, 9))
        machine.passes(0.5)
    change = picture.changes(cursor)
    assert [r["name"] for r in change["rows"]] == ["TWO_SENDERS"]
    assert "To do: End the other sender" in change["rows"][0]["text"]
    shown = change["values"]["KC_HK"]["data"]
    assert (
        shown["text"].startswith("NOT KNOWN: two senders of housekeeping")
        and shown["waits_for"] == "operator"
    )
    assert shown["several"].startswith("two senders")  # the header says it in every view
    for k in range(12):
        machine.passes(1.0)
        picture.add("KC_HK", housekeeping(1010.0 + k, 4, 0))
    now = picture.changes(cursor)["values"]["KC_HK"]["data"]
    assert now["text"] == "No calibration runs." and "several" not in now


def test_what_two_consoles_have_kept_is_there_once(geometry, tmp_path):
    """Events came twice after a restart, and of the poses some were missing."""
    memories = [Memory(tmp_path, "url") for _ in range(2)]
    for k in range(5):
        for late, memory in enumerate(memories):
            memory.keep("KC_PROGRESS", progress(k), 100.0 + k + 0.01 * late)
            memory.keep("KC_EVENT", event(k, k, 48, 0), 100.0 + k + 0.01 * late)
    picture = Picture(geometry)
    assert Memory(tmp_path, "url").recall(picture) == 10
    found = picture.snapshot()[0]
    assert [p["pose"] for p in found["values"]["poses"]["data"]] == [1, 2, 3, 4, 5]
    assert len(found["rows"]) == 5


# ---- telemetry that somebody else sends


def test_a_proposal_with_other_values_does_not_stand_in_for_the_one_that_waits(picture):
    """The newest message under a CRC was shown, whatever its values: the approval put others in force."""
    true, forged = proposal(), proposal()
    forged.value = [0.0] * 64
    none = proposal()
    none.n_coef = 0
    for message in (true, forged, none):
        picture.add("KC_PROPOSAL", message)
    assert picture.proposal(f"{CRC:08x}") is true
    assert [r["name"] for r in picture.rows] == ["WRONG_PROPOSAL"] * 2
    assert len(picture.snapshot()[0]["values"]["inbox"]["data"]) == 1


def test_of_two_proposals_that_differ_beside_their_crc_none_is_decided_by(picture):
    """A copy with a better p of the fit took the reasons to reject away."""
    true, again, forged = proposal(), proposal(), proposal()
    forged.p_fit = true.p_fit + 0.5
    for message in (true, again):
        picture.add("KC_PROPOSAL", message)
    assert not picture.rows and not picture.disputed
    picture.add("KC_PROPOSAL", forged)
    assert picture.proposal(f"{CRC:08x}").p_fit == true.p_fit
    assert [r["name"] for r in picture.rows] == ["WRONG_PROPOSAL"]
    with pytest.raises(BadInput, match="two messages of correction .* say different things"):
        Desk("memq://", None, None, BIN, picture).see(f"{CRC:08x}", "A")


# ---- ABORT


def test_an_abort_goes_out_while_every_other_request_waits(geometry, own_key_file):
    """All threads of the server were taken by requests that wait for one another."""
    with FakeFlight() as flight:
        picture = Picture(geometry)
        desk = Desk(flight.url, own_key_file, None, BIN, picture, timeout_s=3.0)
        app = make_app(Console(flight.url, geometry, picture, desk), ACCESS)
        with TestClient(app, base_url=ORIGIN) as client:

            def ask(path):
                thread = threading.Thread(
                    target=lambda: client.post(path, headers=JSON, json={"number": "1"}), daemon=True
                )
                thread.start()
                return thread

            with desk._one:
                threads = [ask("/api/start") for _ in range(45)]
                time.sleep(0.5)  # until they hold all threads
                threads.append(ask("/api/abort"))
                wait_for(lambda: kcm.cmd_t.ABORT in [o for o, _ in flight.commands])
            for thread in threads:
                thread.join()


def test_a_request_that_failed_and_comes_again_is_not_carried_out_again(geometry, own_key_file):
    """Its answer was lost, and what it had failed by was not remembered."""
    desk, calls = Desk("memq://", own_key_file, None, BIN, Picture(geometry)), []

    def fails():
        calls.append(1)
        raise NoAnswer("APPROVE_GO not answered")

    for _ in range(2):
        with pytest.raises(NoAnswer, match="APPROVE_GO not answered"):
            desk.once("1", fails)
    assert calls == [1]


# ---- requests that are none


@pytest.mark.parametrize(
    "poses", [b'"many"', b"1e400", b"null", b"true", b"9" * 5000, b"[" * 100_000, b'"' + b"9" * 5000 + b'"']
)
def test_a_number_that_is_none_is_a_bad_request(client, poses):
    body = b'{"number": "1", "poses": ' + poses + b"}"
    assert client.post("/api/start", headers=JSON, content=body).status_code == 400


@pytest.mark.parametrize("before", ["abc", "-", "9" * 5000, "1e3"])
def test_rows_before_what_is_no_number_are_a_bad_request(client, before):
    assert client.get(f"/api/rows?before={before}", headers=GOOD).status_code == 400


def test_a_length_of_thousands_of_digits_is_too_much(client):
    headers = {**JSON, "content-length": "9" * 5000}
    assert client.post("/api/abort", headers=headers, content=b"{}").status_code == 413


def test_a_recording_stays_where_it_is_if_the_browser_asks_for_no_time(geometry, picture, tmp_path):
    recorder = Recorder(tmp_path)
    for k in range(3):
        recorder.take("KC_HK", housekeeping(10.0 + k, 1, 0).encode(), 1_000_000 * k, float(k))
    recorder.take("KC_PROPOSAL", proposal().encode(), 9_000_000, 9.0)
    recorder.close()
    recording = Recording.read(recorder.files[0])
    app = make_app(Console("x", geometry, picture, None, recording), ACCESS)
    with TestClient(app, base_url=ORIGIN) as client, feed_of(client) as ws:
        first = next_of(ws, "snapshot")
        for nonsense in ("x", "[]", "{}", '{"seek_us": "later"}', '{"seek_us": 1e999}', "[" * 20_000):
            ws.send_text(nonsense)
            assert next_of(ws, "snapshot")["now_s"] == first["now_s"]
        ws.send_text(json.dumps({"seek_us": 10_000_000}))
        assert next_of(ws, "snapshot")["now_s"] == 10.0


# ---- connections of programs that have no token


def test_connections_without_a_request_do_not_keep_anybody_out(tmp_path):
    """1100 of them kept every file descriptor: no page, no ABORT. Where more descriptors are allowed, the
    ABORT ended the console: LCM waits by select()."""
    most = resource.getrlimit(resource.RLIMIT_NOFILE)[1]
    port, lock = private_port()
    command = [sys.executable, "-m", "kincal", "serve", "--port", "0", "--url", private_url(port)]
    command += ["--no-record", "--keys", tmp_path / "none", "--folder", tmp_path / "kept"]
    process = subprocess.Popen(
        command, stdout=subprocess.PIPE, text=True,
        preexec_fn=lambda: resource.setrlimit(resource.RLIMIT_NOFILE, (most, most)),
    )  # fmt: skip
    idle = []
    try:
        process.stdout.readline()
        base, token = process.stdout.readline().strip().split("/?token=")
        at = urllib.parse.urlsplit(base)
        limits = Path(f"/proc/{process.pid}/limits").read_text()
        assert int(re.search(r"Max open files +(\d+)", limits)[1]) <= 1024
        for k in range(400):
            idle.append(socket.create_connection((at.hostname, at.port), timeout=20.0))
            idle[-1].sendall(b"GET / HTTP/1.1\r\nHost: x" if k % 2 else b"")
        headers = {"Cookie": f"kincal_{at.port}={token}", "Origin": base, "Content-Type": "application/json"}
        for path, body in (("about", None), ("abort", b"{}")):
            request = urllib.request.Request(f"{base}/api/{path}", body, headers)
            with urllib.request.urlopen(request, timeout=20.0) as answer:
                assert answer.status == 200
        for one in idle:
            with suppress(ConnectionResetError):
                assert one.recv(100) == b""
        with socket.create_connection((at.hostname, at.port), timeout=20.0) as refused:
            refused.sendall(b"GET / HTTP/1.1\r\nHost: x\r\n\r\nGET / HTTP/1.1\r\n")
            assert b"421" in refused.recv(20)
            while refused.recv(4096):
                pass
    finally:
        for one in idle:
            one.close()
        process.kill()
        process.wait()
        process.stdout.close()
        lock.close()
