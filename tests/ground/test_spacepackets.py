"""Telemetry for other ground systems, judged by space_packet_parser, which shares no code with us: its XSD
validation of the database, and its decoding of the packets."""

import socket
import struct
import threading
import xml.etree.ElementTree as ET

import numpy as np
import pytest
import space_packet_parser as spp
from click.testing import CliRunner
from fake_flight import FakeFlight

from kincal.cli import main
from kincal.link import channels
from kincal.spacepackets import bridge, packets
from kincal.spacepackets.database import xtce
from kincal_shared.errors import BadInput
from kincal_shared.schema.messages import fields_of

NS = {"x": "http://www.omg.org/spec/XTCE/20180204"}
FIRST = 300


@pytest.fixture(scope="module")
def database(tmp_path_factory):
    path = tmp_path_factory.mktemp("xtce") / "kincal.xml"
    path.write_text(xtce(FIRST), encoding="utf-8")
    return path


def numbers_of(tree, name):
    """The numbers that have a name, of a parameter of the database; none: any number."""
    kind = tree.find(f".//x:EnumeratedParameterType[@name='{name}']", NS)
    return [] if kind is None else [int(e.get("value")) for e in kind.iter(f"{{{NS['x']}}}Enumeration")]


def made_up(channel, tree, rng):
    """A message with another value in every place, and the raw values in the order of its fields."""
    message_type = channels.BY_NAME[channel].type
    message, raw = channels.message_type(message_type)(), []
    limits = {"int8_t": 2**7, "int16_t": 2**15, "int32_t": 2**31, "int64_t": 2**63}
    for field in fields_of(message_type):
        if field.base == "double":
            values = [float(x) for x in rng.normal(size=field.length)]
        elif named := numbers_of(tree, f"{channel}_{field.name}") or numbers_of(
            tree, f"{channel}_{field.name}_1"
        ):
            values = [int(x) for x in rng.choice(named, field.length)]
        else:
            values = [int(x) for x in rng.integers(-limits[field.base], limits[field.base], field.length)]
        setattr(message, field.name, values if "[" in field.type else values[0])
        raw.append((field, values))
    return message, raw


def test_the_database_is_valid_xtce_by_its_schema(database):
    result = spp.validate_xtce(database, level="all")
    assert result.valid and not result.errors


@pytest.mark.parametrize("channel", packets.APIDS)
def test_an_independent_parser_reads_every_field_of_every_packet(channel, database):
    kind = channels.BY_NAME[channel].type
    message, raw = made_up(channel, ET.parse(database), np.random.default_rng(7))
    packet = packets.Packer(FIRST).packet(channel, message.encode())
    found = spp.load_xtce(database).parse_bytes(packet)
    read = {name: value for name, value in found.items() if name.startswith(channel)}
    assert found["PKT_APID"] == FIRST + packets.APIDS[channel]
    assert found["PKT_LEN"] == len(packet) - 7
    given = [int.from_bytes(packets.fingerprint(kind), "big", signed=True)]
    for field, values in raw:
        if field.length > 64:
            given.append(struct.pack(f">{field.length}d", *values))
        else:
            given += values
    values = [
        value.raw_value if getattr(value, "raw_value", None) is not None else value for value in read.values()
    ]
    assert len(values) == len(given)
    for name, ours, theirs in zip(read, given, values, strict=True):
        bits = isinstance(ours, int) and ours < 0 and theirs >= 0  # a CRC or a mask
        assert theirs == (ours + 2 ** (64 if "confounded" in name else 32) if bits else ours), name


def parameter(tree, name):
    """Type and description of a parameter."""
    kind = tree.find(f".//x:ParameterTypeSet/*[@name='{name}']", NS)
    return kind, tree.find(f".//x:ParameterSet/x:Parameter[@name='{name}']", NS)


def test_units_names_and_limits_are_in_the_database(database):
    tree = ET.parse(database)
    speed, _ = parameter(tree, "KC_ARM_STATE_dq_rad_s_1")
    assert "".join(speed.find("x:UnitSet", NS).itertext()).strip() == "rad/s (m/s, prismatic)"
    state, about = parameter(tree, "KC_HK_state")
    labels = {e.get("label"): int(e.get("value")) for e in state.iter(f"{{{NS['x']}}}Enumeration")}
    assert labels["SAFE"] == 11 and labels["IDLE"] == 0
    assert about.get("shortDescription") == "Sequencer state, see docs/INTERFACES.md."
    energy, _ = parameter(tree, "KC_HK_energy_j")
    assert "".join(energy.find("x:UnitSet", NS).itertext()).strip() == "J"
    alarms = {e.get("enumerationLabel"): e.get("alarmLevel") for e in state.iter() if e.get("alarmLevel")}
    assert alarms["SAFE"] == "warning"
    events, _ = parameter(tree, "KC_EVENT_id")
    texts = {e.get("label"): e.get("shortDescription") for e in events.iter(f"{{{NS['x']}}}Enumeration")}
    assert "arm controller reports a fault" in texts["ARM_FAULT"]
    fault, _ = parameter(tree, "KC_ARM_STATE_fault_mask")
    assert fault.find(".//x:StaticAlarmRanges/x:CriticalRange", NS) is not None
    assert parameter(tree, "KC_HK_table_crc_KIN")[1] is not None


def test_packets_are_counted_for_each_channel_and_the_count_wraps():
    packer = packets.Packer(FIRST)
    counts = [struct.unpack(">HHH", packer.packet("KC_HK", b"x")[:6])[1] & 0x3FFF for _ in range(2**14 + 2)]
    assert counts == [*range(2**14), 0, 1]
    assert struct.unpack(">HHH", packer.packet("KC_EVENT", b"xy")[:6]) == (FIRST + 2, 3 << 14, 1)


@pytest.mark.parametrize("first", [-1, 2047, 2036])
def test_identifiers_that_do_not_fit_are_refused(first):
    with pytest.raises(BadInput, match="outside 0 to"):
        xtce(first)


@pytest.mark.parametrize(
    "target", ["", "host", "127.0.0.1:", "127.0.0.1:0", "127.0.0.1:70000", ":5", "1.2.3.4:x"]
)
def test_an_address_that_is_none_is_refused(target):
    with pytest.raises(BadInput, match="is no address"):
        bridge.address(target)


def test_telemetry_on_lcm_arrives_as_packets_and_nothing_goes_back(database):
    with FakeFlight() as flight, socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as receiver:
        receiver.bind(("127.0.0.1", 0))
        receiver.settimeout(10)
        got = threading.Event()
        result = []
        to = receiver.getsockname()
        work = lambda: result.append(bridge.forward(flight.url, to, lambda _: not got.is_set(), FIRST))  # noqa: E731
        run = threading.Thread(target=work)
        run.start()
        found = [spp.load_xtce(database).parse_bytes(receiver.recv(65536)) for _ in range(3)]
        receiver.sendto(
            b"\x1b\x64\xc0\x00\x00\x01ab", receiver.getsockname()
        )  # a ground system that talks back
        got.set()
        run.join()
        assert [p["PKT_APID"] for p in found] == [FIRST + 1] * 3
        assert found[0]["KC_HK_state"] == "IDLE"
        assert result[0].packets["KC_HK"] >= 3 and not result[0].damaged
        assert not flight.commands and not flight.unsigned


def test_the_commands_say_what_they_do(tmp_path):
    run = CliRunner().invoke
    out = tmp_path / "k.xml"
    assert "identifiers from 7" in run(main, ["export", "xtce", "--apid", "7", "-o", str(out)]).output
    assert run(main, ["export", "xtce", "--apid", "7"]).output == out.read_text("utf-8")
    assert run(main, ["export", "xtce", "--apid", "4000"]).exit_code == 2
    assert run(main, ["bridge", "ccsds", "--to", "nowhere"]).exit_code == 2
    with FakeFlight() as flight:
        said = run(main, ["bridge", "ccsds", "--url", flight.url, "--to", "127.0.0.1:9", "--seconds", "0.5"])
    assert said.exit_code == 0 and "KC_HK" in said.output
