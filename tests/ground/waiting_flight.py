"""Flight's core with a correction that waits, on a network of its own, from the store of an earlier run: no
calibration has to be waited for. CONFIG asks for two holders; each has a key file. Its power and its link can
be cut."""

import shutil
import struct
import threading
import time
import zlib
from dataclasses import dataclass
from pathlib import Path

import lcm
from places import SRC

import kcm
from kincal import link as links
from kincal.flight import library
from kincal.run.inprocess import TABLES, Hooks, Script, Setup, Simulation, command, simulate
from kincal.run.store import Store
from kincal.tables import build
from kincal_shared import keys
from kincal_sim.ports import private_port, private_url

STATES = {number: name for name, number in library("flight").enum("kc_state_t", "KC_ST_").items()}
SHOWN = {"KC_ARM_STATE": 5, "KC_PANTILT_STATE": 5}  # every so manyth
JOURNAL, SLOT_HEAD = 18, 24


@dataclass(frozen=True)
class Proposed:
    """A calibration that has ended with a proposal: its log, its store, CRC."""

    log: Path
    store: Path
    crc: int

    @property
    def text(self):
        return f"{self.crc:08x}"


def proposed(folder) -> Proposed:
    store = Store(folder / "store")
    (folder / "store").mkdir()
    start = [(3, command("START", -1, 0, 1))]
    setup = Setup(
        store=store, log=folder / "run.lcmlog", commander=lambda send: Script(send, start), limit_s=2000.0
    )
    review = library("flight").constant("KC_ST_REVIEW")
    run = simulate("paper", 1, setup, each_tick=lambda tick: tick.state != review)
    return Proposed(folder / "run.lcmlog", folder / "store", run.log.last_session.proposal.crc & 0xFFFFFFFF)


def tables_of_two_holders(folder, approval_s=3600):
    """The tables as shipped, but for CONFIG: it asks for two holders, and a busy machine has an hour for both
    steps, or so many seconds of mission time."""
    shutil.copytree(TABLES, folder)
    text = (SRC / "config.toml").read_text()
    text = text.replace("\n[servo]", "\ngo_by_other_key = 1\n\n[servo]", 1)
    text = text.replace("= 600000000 ", f"= {approval_s}000000 ", 1)
    assert "go_by_other_key" in text and f"= {approval_s}000000 " in text
    source = folder.parent / "config.toml"
    source.write_text(text)
    (folder / "config.tbl").write_bytes(build(source).data)
    return folder


def with_verdict(store: Path, verdict: int) -> None:
    """Write another verdict into the journal of a store."""
    for slot in store.glob(f"k{JOURNAL}.?"):
        whole = slot.read_bytes()
        head, record = whole[: SLOT_HEAD - 4], bytearray(whole[SLOT_HEAD:])
        struct.pack_into("<I", record, len(record) - 8, verdict)
        struct.pack_into("<I", record, len(record) - 4, zlib.crc32(record[:-4]))
        slot.write_bytes(head + struct.pack("<I", zlib.crc32(head + record)) + record)


class WaitingFlight:
    """first, second: key files of two holders; commands: what was sent to it, (opcode, key), also while the
    link is cut; taken: opcodes that it took, but for refused ones."""

    def __init__(self, made: Proposed, folder, verdict: int = 0, tick_s: float = 0.002, approval_s=3600):
        self.made, self.verdict, self.tick_s = made, verdict, tick_s
        shutil.copytree(made.store, folder / "store")
        if verdict:
            with_verdict(folder / "store", verdict)
        port, self._port_lock = private_port()
        self.url = private_url(port)
        self.first, self.second = folder / "first.keys", folder / "second.keys"
        key = keys.of_simulation(1)
        keys.write(self.first, (key,))
        second = keys.new(self.second, 1)
        self._lost, self.cut = threading.Event(), threading.Event()
        setup = Setup(
            tables=tables_of_two_holders(folder / "tables", approval_s), store=Store(folder / "store"),
            commander=lambda send: Script(send, []), others=(second,), hooks=Hooks(power_loss=self._power),
            limit_s=1e6,
        )  # fmt: skip
        self.tables = folder / "tables"
        self._simulation = Simulation("paper", 1, setup)
        self.commands, self.taken, self.state, self.hk = [], [], "", kcm.hk_t()
        self._bus = lcm.LCM(self.url)
        self._bus.subscribe("KC_CMD", self._on_cmd)
        self._stop = threading.Event()
        self._thread = threading.Thread(target=self._run, daemon=True)

    def __enter__(self):
        self._thread.start()
        self.until(lambda: self.hk.boot_count)
        return self

    def __exit__(self, *_):
        self._stop.set()
        self._thread.join()
        del self._bus
        self._port_lock.close()

    def _power(self, _tick):
        lost = self._lost.is_set()
        self._lost.clear()
        return lost

    def _on_cmd(self, channel, data):
        message = kcm.cmd_t.decode(data)
        self.commands.append((message.opcode, message.key_id))
        if not self.cut.is_set():
            self._simulation.publish(channel, message)

    def _run(self):
        with self._simulation as simulation:
            while not self._stop.is_set() and (tick := simulation.step()) is not None:
                for channel, message in (*tick.to_flight, *tick.from_flight):
                    self._note(channel, message)
                    if (
                        channel != "KC_CMD"
                        and not self.cut.is_set()
                        and not tick.number % SHOWN.get(channel, 1)
                    ):
                        self._bus.publish(channel, message.encode())
                self.state = STATES[tick.state]
                self._bus.handle_timeout(0)
                time.sleep(self.tick_s)

    def _note(self, channel, message):
        if channel == "KC_HK":
            self.hk = message
        elif channel == "KC_ACK" and message.status == 0:
            self.taken.append(message.opcode)

    def until(self, what, seconds=60.0):
        deadline = time.monotonic() + seconds
        while not what():
            assert time.monotonic() < deadline, f"flight is in {self.state}"
            time.sleep(0.005)

    def restart(self):
        """Power is lost and comes back."""
        starts = self.hk.boot_count
        self._lost.set()
        self.until(lambda: self.hk.boot_count == starts + 1)

    @property
    def in_force(self):
        return self.hk.table_crc[4] & 0xFFFFFFFF

    def proposal(self):
        """Measurements and proposal as they were published, for a console that has heard them."""
        session = links.read_log(self.made.log).last_session
        session.proposal.verdict = self.verdict or session.proposal.verdict
        return [("KC_MEAS", m) for m in session.measurements] + [("KC_PROPOSAL", session.proposal)]
