"""The live link and logs at their limits: stamps, numbers, time-outs, lengths in a file."""

import os
import struct
import time

import pytest
from direct_flight import DirectFlight
from places import BIN
from samples import event, progress, proposal

import kcm
from kincal import link
from kincal.flight import library
from kincal.flight import tables as codec
from kincal.link import LogSummary, channels, former, names
from kincal.link import connection as live
from kincal.link.eventfile import _AT_ONCE, MOST_BYTES, MOST_CHANNEL, SYNC, EventFile
from kincal_shared import keys
from kincal_shared.errors import BadInput, CommandFailed
from kincal_sim.ports import private_port, private_url

FLIGHT = library("flight")
IMAGE, _ = codec.decode((BIN / "kin.tbl").read_bytes())


@pytest.fixture
def flight(key_file):
    return DirectFlight(keys.signer_of(key_file), first_seq=0)


# ------------------------------------------------------------------------ what is sent


def test_chunks_are_stamped_with_the_newest_time_of_flight_and_signed(flight):
    """Flight compares the stamp with its clock: a chunk without one is too old."""
    link.upload(flight, IMAGE)
    assert {c.t_us for c in flight.chunks} == {flight.hk.t_us} == {5_000_000}
    assert {c.key_id for c in flight.chunks} == {flight.signer.key.id}
    unsigned = DirectFlight()
    unsigned.send_chunk(kcm.table_chunk_t())
    assert (unsigned.chunks[0].key_id, unsigned.chunks[0].source) == (0, FLIGHT.lib.KC_SRC_GROUND)


def test_numbers_of_a_later_link_are_above_those_of_an_earlier_one(monkeypatch):
    """Four commands a second for all links together, and room in 32 bits for decades."""
    now = [1.75e9]
    monkeypatch.setattr(live.time, "time", lambda: now[0])
    first = DirectFlight()
    sent = [first.send("NOOP") for _ in range(4)]
    now[0] += 1.0
    assert sent == list(range(sent[0], sent[0] + 4))
    assert DirectFlight().send("NOOP") == sent[-1] + 1
    now[0] += 15 * 365 * 86400.0
    assert 0 < DirectFlight().send("NOOP") < 2**31
    new = DirectFlight(first_seq=6)
    assert new.send("NOOP") == 7
    assert new.commands[0].t_us == 0, "nothing was heard of flight's clock yet"


@pytest.mark.parametrize("given", [(), (1,), (1, 2, 3, 4)])
def test_a_command_has_four_whole_numbers(flight, given):
    flight.send("NOOP", given)
    assert list(flight.commands[0].arg_i) == [*given, *[0] * (4 - len(given))]
    assert flight.commands[0].arg_u64 == 0
    flight.commands[0].encode()


# ------------------------------------------------------------------------ how long it waits


@pytest.mark.parametrize(
    ("act", "seconds"),
    [
        (lambda f: f.command("NOOP"), 10.0),
        (lambda f: link.upload(f, IMAGE), 30.0),
        (lambda f: link.dump(f, "kin"), 60.0),
    ],
    ids=["command", "upload", "dump"],
)
def test_without_a_limit_it_waits_ten_seconds_for_an_answer_longer_for_tables(act, seconds):
    class Silent(DirectFlight):
        def next(self, timeout_s):
            self.now_s += min(timeout_s, 0.25)

    silent = Silent()
    with pytest.raises(CommandFailed, match=f"did not come within {seconds:g} s"):
        act(silent)
    assert silent.now_s == seconds


def test_a_message_that_waits_for_nobody_is_let_go_and_the_last_moment_counts(flight):
    flight.answer("KC_EVENT", event(1, 0, 1, 1))
    flight.answer("KC_ACK", kcm.ack_t())
    assert flight.wait_hk(lambda hk: hk.t_us == 5_000_000, 0.75, "it").t_us == 5_000_000
    assert flight.now_s == 0.75


def test_a_dump_that_stops_says_after_how_many_bytes():
    class Half(DirectFlight):
        def publish(self, channel, message):
            super().publish(channel, message)
            m = kcm.table_chunk_t()
            m.kind, m.total_bytes, m.offset, m.n = codec.kind_number("kin"), len(IMAGE.data), 0, 10
            m.data = IMAGE.data[:10].ljust(1024, b"\0")
            self.answer("KC_TABLE_DOWN", m)

        def next(self, timeout_s):
            return super().next(timeout_s) if timeout_s > 0.0 else None

    half = Half()
    with pytest.raises(CommandFailed, match="dump stopped after 10 bytes") as error:
        link.dump(half, "kin", 3.0)
    assert error.value.where == "direct" and 3.0 <= half.now_s <= 3.5


def test_a_link_over_lcm_sends_receives_in_order_and_ends_at_once():
    with link.Link("memq://", listen=("KC_HK", "KC_ACK")) as up:
        assert (up.bad_messages, up.url, up.signer) == (0, "memq://", None)
        for k in range(40):
            hk = kcm.hk_t()
            hk.t_us = k
            up.publish("KC_HK", hk)
        up.publish("KC_EVENT", kcm.event_t())  # it does not listen to this
        assert [up.next(5.0).message.t_us for _ in range(40)] == list(range(40))
        assert up.next(0.0) is None and up.last_t_us == 39
        begun = time.monotonic()
    assert not up._thread.is_alive() and time.monotonic() - begun < 1.5


# ------------------------------------------------------------------------ messages


def test_a_former_message_is_one_of_its_own_type_only():
    head, row = next((h, r) for h, r in former.FORMER.items() if r.type == "hk_t")
    hk = kcm.hk_t()
    hk.state, hk.proposal_verdict, hk.approval_left_us = 4, 1, 7
    data = head + hk.encode()[8 : -row.more_bytes]
    old = channels.decode("KC_HK", data)
    assert (old.state, old.proposal_verdict, old.approval_left_us) == (4, 0, 0)
    for channel, wrong in (("KC_ACK", data), ("KC_HK", hk.encode()[:-1])):
        with pytest.raises(Exception):  # noqa: B017, PT011 generated decoders raise anything
            channels.decode(channel, wrong)


@pytest.mark.parametrize(
    ("channel", "count", "array"),
    [
        ("KC_ARM_CMD", "n_joints", "q_rad"), ("KC_ARM_STATE", "n_joints", "q_rad"),
        ("KC_DETECTION", "n_tags", "tag_id"), ("KC_MEAS", "n_joints", "q_rad"),
        ("KC_MEAS", "n_tags", "tag_id"), ("KC_TABLE_UP", "n", "data"),
    ],
)  # fmt: skip
def test_every_count_of_a_message_is_inside_its_array(channel, count, array):
    message = channels.message_type(channels.BY_NAME[channel].type)()
    if channel == "KC_TABLE_UP":
        message.data = bytes(1024)
    room = len(getattr(message, array))
    for n, good in ((0, True), (room, True), (-1, False), (room + 1, False)):
        setattr(message, count, n)
        if good:
            assert getattr(channels.decode(channel, message.encode()), count) == n
        else:
            with pytest.raises(ValueError, match=f"{channel}: {count} is {n}, "):
                channels.decode(channel, message.encode())


def test_numbers_without_a_name_are_shown_as_they_are():
    shown = [f(99) for f in (names.state_name, names.verdict_key, names.verdict_name, names.frame_name)]
    assert shown == ["?99"] * 4
    assert [names.frame_name(n) for n in (0, 1)] == ["camera", "lander"]
    assert names.severity_name(99) == names.acquisition_name(99) == names.coef_status_name(99) == "?99"


def test_each_message_of_a_summary_goes_where_it_belongs():
    log = LogSummary(link)
    for k, message in enumerate((event(1_000_000, 0, 48, 0), event(9_000_000, 1, 64, 2))):
        log.add("KC_EVENT", message)
        assert len(log.events) == k + 1
    log.add("KC_MEAS", kcm.meas_t())
    assert log.mission_s == 8.0, "of events, not of measurements"
    log.add("KC_ACK", kcm.ack_t())
    log.add("KC_CMD", kcm.cmd_t())
    log.add("KC_PROGRESS", progress(8))
    assert (len(log.acks), len(log.commands), log.hk, log.mission_s) == (1, 1, None, 8.0)
    doc = log.as_dict()
    assert (doc["refused"], doc["commands"], doc["state"], doc["table_crc"]) == (0, 1, None, {})
    assert doc["events"][1] == {
        "t_us": 9_000_000, "severity": "warning", "id": 64, "text": log.events[1].text,
    }  # fmt: skip
    p = proposal()
    log.add("KC_PROPOSAL", p)
    said = log.session(3).as_dict()["proposal"]
    assert (said["verdict"], said["rank"], said["n_free"], said["p_fit"]) == ("change proposed", 27, 28, 0.57)
    hk = kcm.hk_t()
    hk.table_crc[2], hk.state = -1, 0
    log.add("KC_HK", hk)
    assert (log.as_dict()["table_crc"], log.as_dict()["state"]) == ({2: "ffffffff"}, names.state_name(0))


# ------------------------------------------------------------------------ files


def head(n_channel, n_data):
    return struct.pack(">4sqqii", SYNC, 0, 0, n_channel, n_data)


LAST = head(4, 4) + b"LASTdata"


@pytest.mark.parametrize(("n_data", "good"), [(MOST_BYTES, True), (MOST_BYTES + 1, False)])
def test_a_message_is_64_megabytes_at_most(tmp_path, n_data, good):
    """The file has a hole in its place, and the message is not wanted: nothing is read of it."""
    path = tmp_path / "x"
    with path.open("wb") as file:
        file.write(head(8, n_data) + b"KC_IMAGE")
        file.seek(n_data, 1)
        file.write(LAST)
    found = EventFile(path, frozenset({"KC_IMAGE"}))
    assert MOST_BYTES == 1 << 26
    assert [e.channel for e in found] == [*(["KC_IMAGE"] if good else []), "LAST"]
    assert found.damaged == (not good)


@pytest.mark.parametrize("offset", range(-len(SYNC) - 1, 2))
def test_the_next_event_is_found_wherever_reading_pauses(tmp_path, offset):
    path = tmp_path / "x"
    path.write_bytes(b"\1" * (_AT_ONCE + offset + 1) + LAST + LAST)  # looked through from byte 1 on
    found = EventFile(path)
    assert [e.channel for e in found] == ["LAST", "LAST"] and found.damaged == 1


def test_names_of_channels_are_printable(tmp_path):
    path = tmp_path / "x"
    name = bytes([31, 32, 65, 126, 127, 255])
    path.write_bytes(head(len(name), 1) + name + b"d")
    (found,) = EventFile(path)
    assert (found.channel, found.data) == ("\\x1f A~\\x7f\\xff", b"d")
    path.write_bytes(head(MOST_CHANNEL, 0) + b"c" * MOST_CHANNEL)
    assert [len(e.channel) for e in EventFile(path)] == [63]


def test_damage_between_and_after_events_is_counted_for_each_place(tmp_path):
    path = tmp_path / "x"
    for content, events, damaged in (
        (LAST, 1, 0), (LAST + b"?" * 30 + LAST, 2, 1), (b"?" * 30 + LAST + b"?" * 40 + LAST + b"??", 2, 3),
        (LAST + LAST[:-1], 1, 1), (SYNC, 0, 1), (b"", 0, 0), (LAST + SYNC * 9, 1, 1),
    ):  # fmt: skip
        path.write_bytes(content)
        file = EventFile(path)
        assert (len(list(file)), file.damaged) == (events, damaged), content


def test_a_file_that_is_not_there_or_a_folder_is_said(tmp_path):
    for path in (tmp_path / "none", tmp_path):
        with pytest.raises(BadInput, match="no such log file"):
            list(EventFile(path))
    path = tmp_path / "two" / "folders" / "kin.tbl"
    for _ in range(2):
        link.write_image(IMAGE, path)
        assert path.read_bytes() == IMAGE.data


def test_a_closed_link_leaves_no_socket_open():
    """LCM waits by select: beyond 1024 open files it would write beyond its set."""
    port, lock = private_port()
    with link.Link(private_url(port), live.LISTEN):
        before = len(os.listdir("/proc/self/fd"))
    for _ in range(5):
        with link.Link(private_url(port), live.LISTEN):
            pass
    assert len(os.listdir("/proc/self/fd")) <= before
    lock.close()
