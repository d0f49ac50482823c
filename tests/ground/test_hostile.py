"""Logs and arrays that somebody else wrote: whatever they hold, only errors for people come out, and soon."""

import contextlib
import io
import json
import struct
import time
import zipfile

import lcm
import numpy as np
import pytest
from commands import shell
from places import BIN
from rich.console import Console
from samples import event, proposal, write_log

import kcm
from kincal import link, review
from kincal.cli.errors import EXIT_INPUT
from kincal.cli.text import log as log_text
from kincal.cli.text import review as review_text
from kincal.flight import event_action, event_line
from kincal.link.eventfile import MOST_BYTES, SYNC, EventFile
from kincal.review.status import proposals_in, status
from kincal.workbench.data.readers import arrays, read_measurements
from kincal_shared.errors import BadInput, KincalError

HEADER = struct.Struct(">4sqqii")
NUMBERS = (float("nan"), float("inf"), -float("inf"), 1e300, -1e300, 0.0, 1e9, -1.0)
WHOLE = (-1, 0, 1, 65, 2**15, 10**9, 2**31 - 1, -(2**31))


def measurement(pose):
    """One that can be used."""
    m = kcm.meas_t()
    rng = np.random.default_rng(pose)
    m.session, m.pose, m.n_joints, m.n_tags = 3, pose, 7, 2
    m.q_rad = [*rng.uniform(-1, 1, 7), *[0.0] * (len(m.q_rad) - 7)]
    m.p_m, m.q_wxyz, m.q_cam_wxyz = list(rng.uniform(0, 1, 3)), [1.0, 0.0, 0.0, 0.0], [1.0, 0.0, 0.0, 0.0]
    m.cov = list((np.eye(6) * 1e-6)[np.triu_indices(6)])
    return m


def record(path, *messages):
    """A log of (channel, message or bytes)."""
    log = lcm.EventLog(str(path), "w", overwrite=True)
    for t, (channel, message) in enumerate(messages):
        log.write_event(t, channel, message if isinstance(message, bytes) else message.encode())
    log.close()
    return path


def looked_at(path):
    """What the commands on logs do with one, without pictures."""
    out = Console(file=io.StringIO(), width=200)
    log = link.read_log(path)
    log_text.show(out, log, debug=True)
    json.dumps(log.as_dict())
    review_text.proposals(out, [proposals_in(path)])
    for do in (lambda: read_measurements(path, 7), lambda: show(out, path, log)):
        try:
            do()
        except KincalError as error:
            out.print(str(error), markup=False)
    return out.file.getvalue()


def show(out, path, log):
    found = review.find(path, None, BIN)
    review_text.show(out, found, review.warnings(found), status(log, found))


def with_header(event_bytes, **what):
    """The bytes of an event with other lengths."""
    _, number, t, n_channel, n_data = HEADER.unpack_from(event_bytes)
    values = {"number": number, "t": t, "n_channel": n_channel, "n_data": n_data, **what}
    return HEADER.pack(SYNC, *values.values()) + event_bytes[HEADER.size :]


# ------------------------------------------------------------------------ the file


LENGTHS = [
    *({"n_data": n} for n in (-1, 2**31 - 1, -(2**31), MOST_BYTES + 1, 10**6)),
    *({"n_channel": n} for n in (-1, 0, 64, 2**31 - 1, -(2**31))),
]


@pytest.mark.parametrize("what", LENGTHS, ids=str)
def test_an_event_with_a_wrong_length_is_passed_over_and_said(tmp_path, what):
    good = record(tmp_path / "good", ("KC_EVENT", event(1, 0, 1, 1))).read_bytes()
    path = tmp_path / "bad.lcmlog"
    path.write_bytes(good + with_header(good, **what) + good)
    log = link.read_log(path)
    assert (log.n_messages, log.damaged) == (2, 1)
    assert "1 damaged place of the file was passed over" in looked_at(path)


def test_a_log_that_was_cut_is_read_up_to_there(tmp_path):
    path = tmp_path / "run.lcmlog"
    write_log(path)
    whole = link.read_log(path)
    assert whole.damaged == 0
    path.write_bytes(path.read_bytes()[:-1])
    log = link.read_log(path)
    assert (log.n_messages, log.damaged) == (whole.n_messages - 1, 1)


def test_a_recording_that_goes_on_is_not_damaged(tmp_path):
    """`kincal log` and `kincal review show --live` read the file that `kincal record` writes to."""
    path = record(tmp_path / "growing", ("KC_EVENT", event(1, 0, 1, 1)), ("KC_EVENT", event(1, 1, 1, 1)))
    more, file, n = path.read_bytes(), EventFile(path), 0
    for _ in file:
        n += 1
        with path.open("ab") as growing:
            growing.write(more)
    assert (n, file.damaged) == (2, 0)


def test_events_of_a_flight_on_the_real_clock_are_listed_in_utc(tmp_path):
    path = record(tmp_path / "live", ("KC_EVENT", event(1_795_622_818_900_000, 0, 1, 1)))
    assert "2026-11-25T16:06:58Z" in looked_at(path)
    path = record(tmp_path / "simulated", ("KC_EVENT", event(12_300_000, 0, 1, 1)))
    assert " 12.3 " in looked_at(path) and "1970" not in looked_at(path)
    for wrong_us in (-(2**63), 2**63 - 1, 0):
        assert "UTC" not in looked_at(record(tmp_path / "wrong", ("KC_EVENT", event(wrong_us, 0, 1, 1))))


def test_events_that_begin_at_any_byte_are_found_again(tmp_path):
    """The sync word may lie across two of the pieces that are looked through."""
    path = tmp_path / "x"
    good = record(tmp_path / "good", ("KC_EVENT", event(1, 0, 1, 1))).read_bytes()
    for gap in ((1 << 20) + k for k in range(-6, 6)):
        path.write_bytes(good + b"\xed" * gap + good)
        file = EventFile(path)
        assert len(list(file)) == 2 and file.damaged == 1


@pytest.mark.parametrize("name", [b"\xff\xfe\x00", b"[/]", b"[red]KC", b"\x1b[2J", "KC_HK\u00fc".encode()])
def test_a_channel_that_is_no_name_is_shown_as_it_is(tmp_path, name):
    path = tmp_path / "x.lcmlog"
    path.write_bytes(HEADER.pack(SYNC, 0, 0, len(name), 2) + name + b"ab")
    assert sum(link.read_log(path).counts.values()) == 1
    shown = looked_at(path)
    assert "\x1b" not in shown
    assert name.decode("ascii", "replace").strip("\x00\x1b\ufffd") in shown
    run = shell("log", path)
    assert run.exit_code == 0, run.exception


# ------------------------------------------------------------------------ the fields


@pytest.mark.parametrize("n_coef", [-1, 65, 10**9, -(2**31)])
def test_a_proposal_that_counts_more_than_it_holds_is_damaged(tmp_path, n_coef):
    p = proposal()
    p.n_coef = n_coef
    path = record(tmp_path / "x.lcmlog", ("KC_PROPOSAL", p))
    begun = time.monotonic()
    assert link.read_log(path).undecodable == {"KC_PROPOSAL": 1}
    for command in (["review", "list"], ["review", "show"], ["log"]):
        run = shell(*command, path)
        assert run.exception is None or isinstance(run.exception, SystemExit), run.exc_info
    assert time.monotonic() - begun < 10.0


NAN, INF = float("nan"), float("inf")
NO_NUMBERS = [
    {"p_fit": NAN}, {"pred_pos_m": INF}, {"value": [NAN] * 64}, {"sigma": [INF] * 64}, {"cov": [NAN] * 2080},
]  # fmt: skip


@pytest.mark.parametrize("change", NO_NUMBERS, ids=lambda change: next(iter(change)))
def test_a_proposal_with_numbers_that_are_none_is_not_reviewed(tmp_path, change):
    p = proposal()
    for key, value in change.items():
        setattr(p, key, value)
    path = record(tmp_path / "x.lcmlog", ("KC_PROPOSAL", p))
    (field,) = change
    for command in (["show", str(path)], ["show", str(path), "--by", "me"]):
        run = shell("review", *command, "--tables", BIN)
        assert run.exit_code == EXIT_INPUT, run.output
        assert f"no finite numbers: {field}" in run.output
    assert "fedcba98" in shell("review", "list", path).output


@pytest.mark.parametrize("number", [-1, 10**9, 2**31 - 1, -(2**31), 65535, 0])
def test_an_event_of_no_known_number_has_a_line(number):
    assert event_line(number, 0, float("nan"), float("inf")).startswith("UNKNOWN")
    assert event_action(number) == ""


@pytest.mark.parametrize(
    ("change", "word"),
    [
        ({"p_m": [float("nan"), 0.0, 0.0]}, "p_m"),
        ({"q_rad": [1e12, *[0.0] * 7]}, "q_rad"),
        ({"p_m": [1e300, 0.0, 0.0]}, "p_m"),
        ({"q_wxyz": [0.0] * 4}, "q_wxyz (norm 0)"),
        ({"cov": [0.0] * 21}, "cov (not positive definite)"),
        ({"cov": list((np.eye(6) * 1e-40)[np.triu_indices(6)])}, "cov (a variance of no instrument)"),
        ({"payload_kg": -2.0}, "payload_kg is -2 kg"),
        ({"n_joints": 6}, "6 joints"),
    ],
)
def test_a_measurement_that_cannot_be_used_is_named(tmp_path, change, word):
    messages = [measurement(pose) for pose in range(1, 5)]
    path = record(tmp_path / "good.lcmlog", *[("KC_MEAS", m) for m in messages])
    assert read_measurements(path, 7).n == 4
    for key, value in change.items():
        value = [*value, *[0.0] * 8][: len(getattr(messages[2], key))] if isinstance(value, list) else value
        setattr(messages[2], key, value)
    path = record(tmp_path / "bad.lcmlog", *[("KC_MEAS", m) for m in messages])
    with pytest.raises(BadInput) as refused:
        read_measurements(path, 7)
    assert word in str(refused.value)
    assert "pose 3" in str(refused.value) or word == "6 joints"


# ------------------------------------------------------------------------ anything


def fields_of(message):
    return [name for name in message.__slots__ if isinstance(getattr(message, name), (int, float, list))]


def with_other_field(message, rng):
    """The message with one of its fields, or an entry of one, something that it may not be."""
    name = fields_of(message)[rng.integers(len(fields_of(message)))]
    old = getattr(message, name)
    sample = old[0] if isinstance(old, list) else old
    new = (
        NUMBERS[rng.integers(len(NUMBERS))]
        if isinstance(sample, float)
        else int(WHOLE[rng.integers(len(WHOLE))])
    )
    if isinstance(old, list):
        old = [*old]
        old[rng.integers(len(old))] = new
        new = old
    setattr(message, name, new)
    try:
        return message.encode()
    except struct.error:  # does not fit the field
        return b""


def messages(rng):
    hk, ack, cmd = kcm.hk_t(), kcm.ack_t(), kcm.cmd_t()
    lost = event(1, 0, 64, 2, got=24.0, index=11)
    made = [("KC_EVENT", lost), ("KC_HK", hk), ("KC_ACK", ack), ("KC_CMD", cmd), ("KC_PROPOSAL", proposal()),
            *[("KC_MEAS", measurement(k)) for k in range(1, 6)]]  # fmt: skip
    k = int(rng.integers(len(made)))
    made[k] = (made[k][0], with_other_field(made[k][1], rng))
    return made


def damaged(data, rng):
    """A few bytes changed, taken out or put in, the lengths of events among them."""
    data = bytearray(data)
    starts = [k for k in range(len(data)) if data[k : k + 4] == SYNC]
    for _ in range(int(rng.integers(1, 5))):
        near = starts[rng.integers(len(starts))] + int(rng.integers(0, 60))
        at = min(near if rng.random() < 0.7 else int(rng.integers(len(data))), len(data) - 1)
        kind = rng.integers(3)
        if kind == 0:
            data[at] = int(rng.integers(256))
        elif kind == 1:
            del data[at : at + int(rng.integers(1, 40))]
        else:
            data[at:at] = rng.bytes(int(rng.integers(1, 40)))
    return bytes(data)


def test_of_fields_that_may_be_anything_only_errors_for_people_come_out(tmp_path):
    path, rng, slowest = tmp_path / "x.lcmlog", np.random.default_rng(23), 0.0
    for _ in range(30):
        record(path, *messages(rng))
        begun = time.process_time()
        looked_at(path)
        slowest = max(slowest, time.process_time() - begun)
    assert slowest < 2.0


def test_of_a_file_of_any_bytes_only_errors_for_people_come_out(tmp_path):
    path, rng = tmp_path / "x.lcmlog", np.random.default_rng(24)
    whole = record(path, *messages(rng)).read_bytes()
    read = 0
    for _ in range(30):
        path.write_bytes(damaged(whole, rng))
        try:
            looked_at(path)
            read += 1
        except KincalError:
            pass
    assert read > 20  # what is left of it is still read


# ------------------------------------------------------------------------ arrays


def test_an_npz_that_unpacks_to_gigabytes_is_refused_before_it_is_unpacked(tmp_path):
    path = tmp_path / "bomb.npz"
    header = io.BytesIO()
    shape = {"descr": "<f8", "fortran_order": False, "shape": (40, 1_000_000)}
    np.lib.format.write_array_header_1_0(header, shape)
    with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED) as archive, archive.open("q.npy", "w") as file:
        file.write(header.getvalue())
        for _ in range(40):
            file.write(bytes(8_000_000))
    assert path.stat().st_size < 1_000_000
    with pytest.raises(BadInput, match=r"unpacked it needs 305 MiB, up to 256 MiB are read"):
        read_measurements(path, 7)


def test_a_header_that_claims_more_than_the_file_holds_is_believed(tmp_path):
    path, header = tmp_path / "claim.npz", io.BytesIO()
    np.lib.format.write_array_header_1_0(header, {"descr": "<f8", "fortran_order": False, "shape": (10**12,)})
    with zipfile.ZipFile(path, "w") as archive:
        archive.writestr("q.npy", header.getvalue())
    with pytest.raises(BadInput, match="unpacked it needs"):
        read_measurements(path, 7)


def test_a_damaged_npz_gives_an_error_for_people(tmp_path):
    path = tmp_path / "x.npz"
    np.savez_compressed(path, q=np.zeros((20, 7)), p=np.zeros((20, 3)))
    whole, rng = path.read_bytes(), np.random.default_rng(25)
    for _ in range(80):
        data = bytearray(whole)
        for _ in range(int(rng.integers(1, 6))):
            data[rng.integers(4, len(data))] = rng.integers(256)
        path.write_bytes(bytes(data))
        with contextlib.suppress(KincalError):
            read_measurements(path, 7)


def test_a_parquet_that_unpacks_to_gigabytes_is_refused(tmp_path, monkeypatch):
    pyarrow = pytest.importorskip("pyarrow")
    from pyarrow import parquet

    path = tmp_path / "x.parquet"
    names = [*(f"q{j}" for j in range(1, 8)), "px", "py", "pz"]
    parquet.write_table(pyarrow.table({name: np.zeros(1000) for name in names}), path)
    assert path.stat().st_size < 8 * 1000 * len(names) / 4
    monkeypatch.setattr(arrays, "MOST_BYTES", 8 * 1000 * len(names) - 1)
    with pytest.raises(BadInput, match="unpacked it needs"):
        read_measurements(path, 7)
