"""Uplink to the last detail: what is sent, in which order, what is waited for, and what is refused before."""

import shutil
import struct
from pathlib import Path

import poses
import pytest
from commands import good
from commands import shell as kincal
from direct_flight import DirectFlight
from places import BIN
from samples import CRC, event, progress, proposal, signed, write_log

import kcm
from kincal import link
from kincal import workbench as wb
from kincal.cli.errors import EXIT_INPUT
from kincal.flight import library
from kincal.flight import tables as codec
from kincal.flight.bounds import Flown, place_text, shared_bounds, tightest
from kincal.link import LogSummary, channels, read_log
from kincal.link.connection import Received, check_ack, is_ack
from kincal.link.eventfile import MOST_CHANNEL, SYNC, EventFile
from kincal.link.log import LogEvent, unpack_covariance
from kincal.workbench.model import uplink
from kincal.workbench.model.effects import Hypothesis, Parameter, Term
from kincal_shared import keys
from kincal_shared.errors import BadInput, CommandFailed

FLIGHT = library("flight")
SPACE, _ = codec.decode((BIN / "space.tbl").read_bytes())
CONFIG, _ = codec.decode((BIN / "config.tbl").read_bytes())


@pytest.fixture
def flight(key_file):
    return DirectFlight(keys.signer_of(key_file), first_seq=40)


@pytest.fixture(scope="module")
def arm():
    return wb.read_arm("wam")


@pytest.fixture(scope="module")
def effects():
    return wb.Library.load()


# ------------------------------------------------------------------------ commands


def test_a_command_carries_number_source_arguments_time_and_signature(flight):
    flight.wait_hk(lambda _hk: True, 1.0, "housekeeping")
    assert flight.send("TABLE_VALIDATE", (5, CRC), arg_u64=7) == 41
    (c,) = flight.commands
    assert (c.seq, c.opcode, c.t_us, c.arg_u64) == (41, c.TABLE_VALIDATE, 5_000_000, 7)
    assert c.source == FLIGHT.lib.KC_SRC_GROUND
    assert (list(c.arg_i), list(c.arg_d)) == ([5, signed(CRC), 0, 0], [0.0] * 4)
    assert keys.signed_by(c, flight.signer.key)
    assert flight.send("NOOP", t_us=9) == 42
    assert flight.commands[1].t_us == 9
    unsigned = DirectFlight()
    unsigned.send("NOOP")
    assert unsigned.commands[0].key_id == 0


def test_only_the_answer_of_the_ground_to_this_number_is_its_answer():
    a = kcm.ack_t()
    a.source, a.seq = FLIGHT.lib.KC_SRC_GROUND, 41
    assert is_ack(Received("KC_ACK", a), 41)
    assert not is_ack(Received("KC_HK", a), 41)
    assert not is_ack(Received("KC_ACK", a), 42)
    a.source += 1
    assert not is_ack(Received("KC_ACK", a), 41)


def test_a_refusal_says_opcode_status_event_and_advice():
    a = kcm.ack_t()
    assert check_ack(a, "REJECT", "url") is a
    a.status, a.event_id = -8, 13
    with pytest.raises(CommandFailed, match=r"^REJECT refused: \w+ \(\w+\)") as error:
        check_ack(a, "REJECT", "url")
    assert error.value.todo.startswith("nothing was changed on board. ")
    a.event_id = 0
    with pytest.raises(CommandFailed, match=r"^REJECT refused: \w+\n") as error:
        check_ack(a, "REJECT", "url")
    assert "review list --live" in error.value.todo


def test_waiting_ends_with_its_time_and_not_before(flight):
    seen = []

    def last(hk):
        seen.append(hk)
        return len(seen) == 7

    flight.wait_hk(last, 1.76, "seventh")
    assert flight.now_s == 1.75
    with pytest.raises(CommandFailed, match="never did not come within 2 s"):
        flight.wait_hk(lambda _hk: False, 2.0, "never")
    assert flight.now_s == 3.75


def test_a_link_keeps_the_last_housekeeping_and_the_time_of_any_message(flight):
    """A later time, of before or of a stranger, does not stay: flight would refuse what is stamped by it."""
    hk, other = kcm.hk_t(), kcm.event_t()
    hk.t_us, other.t_us = 2**62, 3
    flight.note("KC_HK", hk)
    assert (flight.last_hk, flight.last_t_us) == (hk, 2**62)
    flight.note("KC_EVENT", other)
    assert (flight.last_hk, flight.last_t_us) == (hk, 3)
    flight.send("NOOP")
    assert flight.commands[0].t_us == 3


# ------------------------------------------------------------------------ tables up and down


@pytest.mark.parametrize("image", [CONFIG, SPACE], ids=["config", "space"])
def test_a_table_goes_up_in_whole_chunks_then_is_validated_and_activated(flight, image):
    link.upload(flight, image, 60.0)
    kind, room = codec.kind_number(image.kind), FLIGHT.lib.KC_CHUNK_BYTES
    assert b"".join(bytes(c.data[: c.n]) for c in flight.chunks) == image.data
    assert [c.offset for c in flight.chunks] == list(range(0, len(image.data), room))
    assert all(c.n == room for c in flight.chunks[:-1]) and all(len(c.data) == room for c in flight.chunks)
    assert {(c.kind, c.total_bytes, c.source) for c in flight.chunks} == {
        (kind, len(image.data), FLIGHT.lib.KC_SRC_GROUND)
    }
    assert [(c.opcode, *c.arg_i[:2]) for c in flight.commands] == [
        (kcm.cmd_t.TABLE_VALIDATE, kind, signed(image.crc)),
        (kcm.cmd_t.TABLE_ACTIVATE, kind, signed(image.crc)),
    ]
    assert all(m.key_id == flight.signer.key.id for m in (*flight.chunks, *flight.commands))


def test_not_more_chunks_are_sent_than_flight_has_room_for(flight):
    """Four at once; the next when housekeeping says that they have arrived."""
    sent = []

    class Late(DirectFlight):
        def wait_hk(self, what, timeout_s, name):
            sent.append(len(self.chunks))
            return super().wait_hk(what, timeout_s, name)

    late = Late(flight.signer)
    link.upload(late, SPACE, 60.0)
    steps = [b - a for a, b in zip(sent, sent[1:], strict=False)]
    assert sent[0] == 0 and max(steps) == 4 and set(steps[:-2]) == {4}


def test_staging_that_stops_is_a_failure_that_says_where_and_nothing_is_activated(flight):
    class Stuck(DirectFlight):
        def publish(self, channel, message):
            super().publish(channel, message)
            self.hk.staged_kind, self.hk.staged_bytes = 3, 77

    stuck = Stuck(flight.signer)
    with pytest.raises(CommandFailed, match="did not take the table") as error:
        link.upload(stuck, CONFIG, 1.0)
    assert error.value.where == "staged 77 bytes of kind 3"
    assert stuck.commands == []


@pytest.mark.parametrize("opcode", ["TABLE_VALIDATE", "TABLE_ACTIVATE"])
def test_a_refused_table_ends_the_uplink(flight, opcode):
    flight.refuse = {getattr(kcm.cmd_t, opcode): (-8, 13)}
    with pytest.raises(CommandFailed, match=f"{opcode} refused"):
        link.upload(flight, CONFIG, 5.0)
    flight.refuse, flight.ignores = {}, {kcm.cmd_t.TABLE_ACTIVATE}
    with pytest.raises(CommandFailed, match="new CRC in housekeeping"):
        link.upload(flight, CONFIG, 5.0)


def down(flight, image, *, lose=None, kind=None, chunk=1024):
    """Chunks of a dump wait to be received."""
    number = codec.kind_number(image.kind)
    for offset in range(0, len(image.data), chunk):
        if offset != lose:
            m = kcm.table_chunk_t()
            part = image.data[offset : offset + chunk]
            m.kind, m.total_bytes, m.offset, m.n = kind or number, len(image.data), offset, len(part)
            m.data = part.ljust(1024, b"\0")
            flight.answer("KC_TABLE_DOWN", m)


class Dumps(DirectFlight):
    """Sends what `tail` says after a TABLE_DUMP."""

    def __init__(self, signer, tail):
        super().__init__(signer)
        self.tail = tail

    def next(self, timeout_s):
        return super().next(timeout_s) if timeout_s > 0.0 else None

    def publish(self, channel, message):
        super().publish(channel, message)
        self.tail(self)


def test_a_dump_brings_the_bytes_of_its_kind_only(flight):
    other, _ = codec.decode((BIN / "arm.tbl").read_bytes())

    def tail(one):
        down(one, other)
        down(one, CONFIG, chunk=500)

    one = Dumps(flight.signer, tail)
    assert link.dump(one, "config", 30.0).data == CONFIG.data
    assert (one.commands[0].opcode, one.commands[0].arg_i[0]) == (
        kcm.cmd_t.TABLE_DUMP,
        codec.kinds()["config"],
    )


def test_a_dump_with_a_gap_an_end_too_early_or_damage_is_refused(flight):
    with pytest.raises(CommandFailed, match="lost a chunk at byte 100"):
        link.dump(Dumps(flight.signer, lambda one: down(one, CONFIG, lose=100, chunk=100)), "config", 30.0)
    damaged = codec.Image("config", 2, 0, CONFIG.data[:-1] + b"\x99")
    with pytest.raises(BadInput):
        link.dump(Dumps(flight.signer, lambda one: down(one, damaged)), "config", 30.0)
    refusing = DirectFlight(flight.signer)
    refusing.refuse = {kcm.cmd_t.TABLE_DUMP: (-8, 13)}
    with pytest.raises(CommandFailed, match="TABLE_DUMP refused"):
        link.dump(refusing, "config", 3.0)


# ------------------------------------------------------------------------ messages and logs


def test_crcs_travel_signed():
    for value, carried in ((0, 0), (0x7FFFFFFF, 0x7FFFFFFF), (0x80000000, -0x80000000), (0xFFFFFFFF, -1)):
        assert (channels.signed32(value), channels.unsigned32(carried)) == (carried, value)
    assert channels.crc_text(-1) == "ffffffff" and channels.crc_text(1) == "00000001"


@pytest.mark.parametrize(("n", "good"), [(0, True), (64, True), (-1, False), (65, False)])
def test_a_message_counts_no_more_than_its_arrays_hold(n, good):
    p = proposal()
    p.n_coef = n
    if good:
        assert channels.decode("KC_PROPOSAL", p.encode()).n_coef == n
    else:
        with pytest.raises(ValueError, match=f"n_coef is {n}, value has room for 64"):
            channels.decode("KC_PROPOSAL", p.encode())


def test_a_covariance_is_unpacked_row_by_row():
    full = unpack_covariance([1.0, 2.0, 3.0, 4.0, 5.0, 6.0, 99.0], 3)
    assert full.tolist() == [[1.0, 2.0, 3.0], [2.0, 4.0, 5.0], [3.0, 5.0, 6.0]]


def test_a_summary_keeps_first_and_last_time_and_what_belongs_to_each_session():
    log = LogSummary(Path("x"))
    assert (log.mission_s, log.last_session.number) == (0.0, 0)
    hk = kcm.hk_t()
    for t_us in (2_000_000, 3_000_000, 7_500_000):
        hk.t_us = t_us
        log.add("KC_HK", hk)
    assert log.mission_s == 5.5
    meas, p = kcm.meas_t(), proposal()
    meas.session, p.session = 4, 9
    log.add("KC_MEAS", meas)
    log.add("KC_PROGRESS", progress(0))
    log.add("KC_PROGRESS", progress(1))
    log.add("KC_PROPOSAL", p)
    assert (log.last_session.number, log.last_session.proposal) == (9, p)
    assert [s.as_dict()["poses"] for s in log.sessions.values()] == [0, 2, 0]
    assert [s.as_dict()["measurements"] for s in log.sessions.values()] == [1, 0, 0]
    assert log.session(3).as_dict()["last_pred_pos_m"] == log.session(3).progress[-1].pred_pos_m
    log.session(3).progress[-1].pred_pos_m = 0.5
    assert log.session(3).as_dict()["last_pred_pos_m"] == 0.5
    assert log.session(9).as_dict()["last_pred_pos_m"] is None
    assert log.session(9).as_dict()["proposal"]["crc"] == f"{CRC:08x}"


def test_a_summary_of_a_file_counts_messages_refusals_and_damage(tmp_path):
    path = tmp_path / "x.lcmlog"
    write_log(path)
    doc = read_log(path).as_dict()
    assert (doc["messages"], doc["commands"], doc["refused"], doc["damaged"]) == (14, 1, 1, 0)
    assert doc["undecodable"] == {"KC_HK": 1}
    assert doc["table_crc"] == {4: f"{CRC:08x}"}
    one = LogEvent.of(event(5, 0, 64, 2, got=24.0, index=11))
    assert (one.t_us, one.id, one.index, one.got) == (5, 64, 11, 24.0)
    assert (LogEvent(1, "", 2, "").index, LogEvent(1, "", 2, "").got) == (-1, 0.0)


def packet(channel=b"KC_HK", data=b"x", **wrong):
    head = {"sync": SYNC, "n_channel": len(channel), "n_data": len(data), **wrong}
    return struct.pack(">4sqqii", head["sync"], 0, 0, head["n_channel"], head["n_data"]) + channel + data


@pytest.mark.parametrize(
    ("first", "events", "damaged"),
    [
        (packet(), 2, 0), (packet(b"c" * MOST_CHANNEL), 2, 0), (packet(b"c" * (MOST_CHANNEL + 1)), 1, 1),
        (packet(b""), 1, 1), (packet(data=b""), 2, 0), (packet(n_data=-1), 1, 1),
        (packet(n_data=1 << 30), 1, 1),
        (packet(sync=b"noun"), 1, 1), (b"\0" * 9, 1, 1), (packet(n_data=-1) * 3, 1, 1),
    ],
)  # fmt: skip
def test_a_damaged_place_is_counted_once_and_passed(tmp_path, first, events, damaged):
    path = tmp_path / "x"
    path.write_bytes(first + packet(b"LAST", b"data"))
    file = EventFile(path)
    found = list(file)
    assert (len(found), file.damaged) == (events, damaged)
    assert (found[-1].channel, found[-1].data) == ("LAST", b"data")


def test_an_event_that_is_cut_off_is_damage(tmp_path):
    path, whole = tmp_path / "x", packet(data=b"12345678")
    for cut in (1, 9, len(whole) - 1):
        path.write_bytes(whole + whole[:cut])
        file = EventFile(path)
        assert (len(list(file)), file.damaged) == (1, 1), cut
    path.write_bytes(whole)
    assert [e.data for e in EventFile(path, frozenset({"KC_HK"}))] == [b""]


def test_a_link_counts_what_it_cannot_decode():
    up = link.Link("memq://")
    try:
        up._on_message("KC_HK", b"nonsense")
        up._on_message("KC_HK", kcm.hk_t().encode())
        assert (up.bad_messages, up.received.qsize()) == (1, 1)
        assert up.next(0.01).channel == "KC_HK" and up.next(0.01) is None
    finally:
        up.close()
    assert not up._thread.is_alive()
    with pytest.raises(BadInput, match="cannot open LCM"):
        link.Link("nonsense://")


# ------------------------------------------------------------------------ what a model makes of it


def hypothesis(name, *terms):
    return Hypothesis(name, name, tuple(Parameter(f"c{k}", "rad", 1e-3, (t,)) for k, t in enumerate(terms)))


def constant(frame, comp):
    return Term(frame, comp, 1.0, ())


def test_effects_of_one_name_on_board_are_refused(arm):
    long = "x" * 30
    twice = [hypothesis(f"{long}_a[1]", constant(1, 0)), hypothesis(f"{long}_b[1]", constant(1, 0))]
    with pytest.raises(BadInput, match="two coefficients would be called"):
        uplink.coefficients(arm, twice)
    rows = uplink.coefficients(arm, twice[:1])
    assert rows[-1].name == "x" * (FLIGHT.lib.KC_NAME_LEN - 1 - 3) + "[1]"
    assert (rows[-1].prior_sigma, rows[-1].scale, rows[-1].bound) == (3e-3, 1e-3, pytest.approx(0.03))
    assert len(rows) == 4 * arm.n + 1


def test_unnamed_effects_keep_their_place_and_drivers():
    names = {
        "unnamed[link 3 tilt: q1, dir3]": "L3r:q1,dir3.p", "unnamed[joint 2: q2]": "J2:q2.p",
        "unnamed[link 1 translation: temp]": "L1t:temp.p",
    }  # fmt: skip
    assert {name: uplink.flight_name(name, "p", False) for name in names} == names


def test_bounds_are_symmetric_and_a_table_names_its_arm(arm, effects):
    (h,) = effects.find("backlash[1]", arm, None)
    table = uplink.term_table(arm, [h], poses.flown())
    assert all(row.lb == -row.ub and row.enabled == (row.ub > 0.0) for row in table.coef[0 : table.n_coef])
    flown = codec.decode_as("terms", uplink.term_image(arm, [h], poses.flown()).data)[1]
    assert flown.kinematics_crc == table.kinematics_crc != 0


def test_what_flight_would_refuse_is_not_made(arm, monkeypatch):
    class Refusing:
        def __getattr__(self, name):
            return (lambda *_: -3) if name == "kc_terms_validate" else getattr(FLIGHT.lib, name)

    class Flight:
        lib = Refusing()

        def __getattr__(self, name):
            return getattr(FLIGHT, name)

    made = uplink.term_table(arm, [], poses.flown())
    monkeypatch.setattr(uplink, "term_table", lambda *_: made)
    with monkeypatch.context() as patch:
        patch.setattr(uplink, "library", lambda _name: Flight())
        with pytest.raises(BadInput, match="flight would refuse the term table: .*entry 0, value 0"):
            uplink.term_image(arm, [], poses.flown())
    made.coef[0].ub = made.coef[0].ub * 3.0
    with pytest.raises(BadInput, match="flight would refuse the term table: with J1.phi_rad"):
        uplink.term_image(arm, [], poses.flown())


def test_a_space_for_another_number_of_joints_is_refused(arm):
    flown = poses.flown()
    flown.space.n_joints -= 1
    with pytest.raises(BadInput, match="has 7 joints, the search space is for 6"):
        uplink.term_table(arm, [], flown)


def test_what_flight_has_no_room_for_is_said_with_both_numbers(arm):
    many = hypothesis("many[1]", *(constant(1, 0) for _ in range(37)))
    with pytest.raises(
        BadInput, match=r"needs 65 coefficients \(28 of DH errors, 37 of effects\) and 65 terms"
    ):
        uplink.term_table(arm, [many], poses.flown())
    fits = hypothesis("many[1]", *(constant(7, 0) for _ in range(36)))
    assert uplink.term_table(arm, [fits], poses.flown()).n_coef == 64


def test_effects_are_left_out_by_name_or_by_joint(arm, effects):
    found = [*effects.find("backlash[1,2]", arm, None), *effects.find("encoder_gain[3]", arm, None)]
    names = [h.name for h in found]
    assert [h.name for h in uplink.dropped(found, ["encoder_gain"])] == [n for n in names if "gain" in n]
    assert [h.name for h in uplink.dropped(found, ["backlash[2]"])] == ["backlash[2]"]
    assert [h.name for h in uplink.dropped(found, ["backlash[1]", "encoder_gain"])] == [names[0], names[2]]
    with pytest.raises(BadInput, match=r"nothing is not in the model; it holds backlash\[1\], "):
        uplink.dropped(found, ["backlash[1]", "nothing"])


def test_the_arm_of_the_tables_has_to_be_that_of_the_model(arm, tmp_path):
    assert uplink.refuse_other_arm(arm, BIN) == f"the arm is that of {BIN / 'arm.tbl'}"
    assert "was not checked" in uplink.refuse_other_arm(arm, tmp_path)
    other = codec.decode_as("arm", (BIN / "arm.tbl").read_bytes())[1]
    other.joint[2].d_m += 0.01
    (tmp_path / "arm.tbl").write_bytes(codec.encode("arm", other).data)
    with pytest.raises(BadInput, match="with other DH parameters"):
        uplink.refuse_other_arm(arm, tmp_path)


def test_tables_to_fly_with_are_those_there_with_new_terms_and_no_correction(arm, tmp_path):
    terms = uplink.term_image(arm, [], poses.flown())
    out = tmp_path / "a" / "b"
    written = uplink.flight_tables(BIN, out, terms)
    assert sorted(p.name for p in written) == sorted(p.name for p in BIN.glob("*.tbl"))
    assert (out / "terms.tbl").read_bytes() == terms.data
    assert (out / "arm.tbl").read_bytes() == (BIN / "arm.tbl").read_bytes()
    kin = codec.decode_as("kin", (out / "kin.tbl").read_bytes())[1]
    assert (kin.n_coef, max(kin.value[0:28])) == (28, 0.0)
    with pytest.raises(BadInput, match="name another directory"):
        uplink.flight_tables(out, tmp_path / "a" / "." / "b", terms)
    with pytest.raises(BadInput, match="no table image"):
        uplink.flight_tables(tmp_path, tmp_path / "c", terms)
    uplink.flight_tables(BIN, out, terms)  # again
    (tmp_path / "others").mkdir()
    (tmp_path / "others" / "kin.tbl").write_bytes(b"in force")
    with pytest.raises(BadInput, match="holds kin.tbl, which would be replaced"):
        uplink.flight_tables(BIN, tmp_path / "others", terms)
    assert [path.read_bytes() for path in (tmp_path / "others").iterdir()] == [b"in force"]


# ------------------------------------------------------------------------ bounds


@pytest.mark.parametrize("missing", ["arm", "space"])
def test_a_folder_needs_arm_and_space_of_each_other(tmp_path, missing):
    for kind in {"arm", "space"} - {missing}:
        shutil.copy(BIN / f"{kind}.tbl", tmp_path)
    with pytest.raises(BadInput, match=f"holds no {missing}.tbl"):
        Flown.read(tmp_path)
    shutil.copy(BIN / f"{missing}.tbl", tmp_path)
    assert Flown.read(tmp_path).arm.n_joints == 7
    arm = codec.decode_as("arm", (BIN / "arm.tbl").read_bytes())[1]
    arm.joint[0].mass_kg += 1.0
    (tmp_path / "arm.tbl").write_bytes(codec.encode("arm", arm).data)
    with pytest.raises(BadInput, match="was built for the ARM table"):
        Flown.read(tmp_path)


def test_places_are_named_with_their_dh_parameter():
    rx, rz, tx, ty = (FLIGHT.enum("kc_comp_t", "KC_")[x] for x in ("RX", "RZ", "TX", "TY"))
    special = {x: FLIGHT.constant(f"KC_FRAME_{x}") for x in ("TOOL", "CAMERA", "MEAS")}
    assert place_text((3, rz)) == "rad about z of frame 3 (J4.phi_rad)"
    assert place_text((3, rx)) == "rad about x of frame 3 (J3.alpha_rad)"
    assert place_text((1, tx)) == "m along x of frame 1 (J1.a_m)"
    assert place_text((0, tx)) == "m along x of frame 0"
    assert place_text((3, ty)) == "m along y of frame 3"
    assert place_text((special["TOOL"], ty)) == "m along y of the tool frame"
    assert place_text((special["MEAS"], rx)) == "rad about x of the measured pose"


def test_effects_share_their_half_in_proportion_and_dh_errors_the_rest():
    flown, table = poses.flown_of(wb.read_arm("wam"), 0.1), codec.new("terms")
    rz = FLIGHT.enum("kc_comp_t", "KC_")["RZ"]
    for k in range(3):
        table.term[k].coef, table.term[k].frame, table.term[k].comp, table.term[k].gain = k, 2, rz, 1.0
    table.n_term, table.n_coef = 3, 4
    allowed = flown.allowed((2, rz))
    assert allowed == pytest.approx(0.11)
    assert shared_bounds(flown, table, {1: 0.01, 2: 0.02}) == pytest.approx([allowed - 0.03, 0.01, 0.02, 0.0])
    wide = shared_bounds(flown, table, {1: 0.1, 2: 0.2})
    assert wide == pytest.approx([allowed / 2, allowed / 6, allowed / 3, 0.0])
    alone = shared_bounds(flown, table, {0: 0.1, 1: 0.1, 2: 0.2})
    assert alone == pytest.approx([allowed / 4, allowed / 4, allowed / 2, 0.0])
    assert shared_bounds(flown, table, {2: 0.01}) == pytest.approx([(allowed - 0.01) / 2] * 2 + [0.01, 0.0])
    place, does, room = tightest(flown, table, 1, -0.3)
    assert (place, does, room) == ((2, rz), pytest.approx(0.3), pytest.approx(allowed))


# ------------------------------------------------------------------------ commands of the shell


def test_check_ends_with_the_status_of_bad_input_and_counts_what_is_refused(tmp_path):
    bad = tmp_path / "bad.tbl"
    data = (BIN / "arm.tbl").read_bytes()
    bad.write_bytes(data[:-1] + bytes([data[-1] ^ 1]))
    done = kincal("table", "check", BIN / "kin.tbl", bad)
    assert done.exit_code == EXIT_INPUT
    assert "1 of 2 refused" in done.stderr and "TBL_CRC" in done.stderr and "ok    " in done.stdout
    good("table", "check", BIN / "kin.tbl")


def test_build_of_a_folder_builds_each_source_there(tmp_path):
    source = tmp_path / "src"
    source.mkdir()
    for kind in ("kin", "config"):
        shutil.copy(BIN.parent / "src" / f"{kind}.toml", source)
    good("table", "build", source, tmp_path / "out")
    for kind in ("kin", "config"):
        assert (tmp_path / "out" / f"{kind}.tbl").read_bytes() == (BIN / f"{kind}.tbl").read_bytes()
    good("table", "diff", tmp_path / "out" / "kin.tbl", BIN / "kin.tbl")
