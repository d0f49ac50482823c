"""The flight process on a private LCM network, stepped tick by tick, with or without a simulated world."""

import shutil
import subprocess
import time
from pathlib import Path

import kcm
from kincal.flight import library
from kincal.flight import tables as codec
from kincal_shared import keys
from kincal_sim.bus import Bus
from kincal_sim.ports import private_port
from kincal_sim.scenario import load
from kincal_sim.vision.imagers import fast_imager
from kincal_sim.world import World

ROOT = Path(__file__).resolve().parents[2]
BINARY = ROOT / "build" / "kincal-fsw"
TABLES = ROOT / "tables" / "bin"
TICK_US = 100_000
ANSWER_S = 20.0
STORING_TICKS = 60  # in which a change is stored or refused
CORE = library("flight")
STATE = CORE.enum("kc_state_t", "KC_ST_")
EVENT = CORE.enum("kc_event_id_t", "KC_EVT_")
CAUSE = CORE.enum("kc_cause_t", "KC_CAUSE_")
TABLE = CORE.enum("kc_tbl_kind_t", "KC_TBL_")
IDLE, REVIEW, SAFE = STATE["IDLE"], STATE["REVIEW"], STATE["SAFE"]
KIN = TABLE["KIN"]
TO_WORLD = ("KC_ARM_CMD", "KC_PANTILT_CMD", "KC_FRAME_REQUEST")
TELEMETRY = ("KC_EVENT", "KC_HK", "KC_MEAS", "KC_PROGRESS", "KC_PROPOSAL", "KC_TABLE_DOWN")
HEARD = ("KC_ACK", *TELEMETRY, *TO_WORLD)


def read_table(kind: str):
    """The struct of one of the project's tables."""
    return codec.decode((TABLES / f"{kind}.tbl").read_bytes())[1]


class Flight:
    """One network, one store; the process may die and be started again.

    heard: (channel, message) pairs of flight in the last tick; world: of the scenario, None without one.
    """

    def __init__(self, store: Path, scenario: str | None = None, seed: int = 1, tables: Path = TABLES):
        self.port, self._lock = private_port()
        self.url = f"udpm://239.255.76.67:{self.port}?ttl=0"
        self.store, self.tables = store, tables
        self.bus = Bus(self.url)
        self.process: subprocess.Popen | None = None
        self.stderr = store.parent / f"{store.name}.stderr"
        self.tick, self.done_tick, self.n_published = 0, -1, 0
        self.heard: list[tuple[str, object]] = []
        self.seq = 0
        self.keys = store.parent / f"{store.name}.keys"
        if not self.keys.exists():
            keys.new(self.keys)
        self.signer = keys.signer_of(self.keys)
        self.world = World(load(scenario), seed, fast_imager) if scenario else None
        self.bus.listen("KC_TICK_DONE", self._on_done)
        for channel in HEARD:
            self.bus.listen(channel, lambda ch, m: self.heard.append((ch, m)))

    def _on_done(self, _, m):
        if m.who == kcm.tick_done_t.WHO_FSW:
            self.done_tick, self.n_published = m.tick, m.n_published

    # ---- process ----

    def start(self, env: dict | None = None, wait: bool = True) -> None:
        """Start the process; wait: until it announces itself."""
        with open(self.stderr, "ab") as err:
            command = [BINARY, "--url", self.url, "--tables", self.tables, "--store", self.store]
            command += ["--keys", self.keys]
            self.process = subprocess.Popen(command, stderr=err, env=env)
        self.done_tick = -1
        self.seq = 0  # numbers of commands count from the start of the process
        if wait:
            assert self.wait_done(0), self.stderr.read_text()

    def wait_done(self, tick: int) -> bool:
        """Wait until the tick is done; False when the process has died."""
        deadline = time.monotonic() + ANSWER_S
        while self.done_tick != tick:
            if not self.bus.wait(0.02) and self.process.poll() is not None:
                while self.bus.wait(0.0):  # what it sent last
                    pass
                return self.done_tick == tick
            assert time.monotonic() < deadline, f"no answer to tick {tick}"
        return True

    def kill(self) -> None:
        """End the process at once, as a power cut would."""
        self.process.kill()
        self.process.wait()

    def stop(self) -> int:
        """End the process in good order; its exit status."""
        self.process.terminate()
        return self.process.wait(timeout=ANSWER_S)

    def close(self) -> None:
        """End what still runs and give the network back."""
        if self.process is not None and self.process.poll() is None:
            self.kill()
        self.bus.close()
        self._lock.close()

    def __enter__(self):
        return self

    def __exit__(self, *_):
        self.close()

    # ---- time ----

    @property
    def now_us(self) -> int:
        """Mission time of the last tick."""
        return self.tick * TICK_US

    def send_time(self) -> None:
        """Announce the present tick (again)."""
        t = kcm.time_t()
        t.tick, t.now_us = self.tick, self.now_us
        self.bus.publish("KC_TIME", t)

    def step(self) -> list[tuple[str, object]] | None:
        """One tick; flight's messages in it, or None if the process died before it was done."""
        self.tick += 1
        self.heard = []
        if self.world is not None:
            for channel, m in self.world.step(self.now_us):
                self.bus.publish(channel, m)
        self.send_time()
        alive = self.wait_done(self.tick)
        if self.world is not None:
            for channel, m in self.heard:
                if channel in TO_WORLD:
                    self.world.receive(channel, m)
        return self.heard if alive else None

    def command(self, opcode: int, *args: int, source: int = 2, arg_u64: int = 0) -> None:
        """Send a command; it is handled in the next tick."""
        c = kcm.cmd_t()
        self.seq += 1
        c.t_us, c.seq, c.source, c.opcode = self.now_us, self.seq, source, opcode
        c.arg_i, c.arg_u64 = (list(args) + [0, 0, 0, 0])[:4], arg_u64
        self.bus.publish("KC_CMD", self.signer.command(c))

    def do(self, opcode: int, *args: int):
        """Send a command and step until it is answered, which is after it is stored; its answer, None if the
        process died."""
        self.command(opcode, *args)
        for _ in range(STORING_TICKS):
            if self.step() is None:
                break
            if answers := [m for ch, m in self.heard if ch == "KC_ACK"]:
                return answers[0]
        return next((m for ch, m in self.heard if ch == "KC_ACK"), None)

    def until(self, channel: str, max_ticks: int = 20_000):
        """Step until a message comes on the channel; that message."""
        for _ in range(max_ticks):
            heard = self.step()
            assert heard is not None, self.stderr.read_text()
            for ch, m in heard:
                if ch == channel:
                    return m
        raise AssertionError(f"no {channel} in {max_ticks} ticks")

    def first_telemetry(self) -> tuple[list, object]:
        """Events and housekeeping of the first tick after a start."""
        assert self.step() is not None
        events = [m for ch, m in self.heard if ch == "KC_EVENT"]
        return events, next(m for ch, m in self.heard if ch == "KC_HK")


def u32(x: int) -> int:
    """A CRC as messages carry it (int32), as an unsigned number."""
    return x & 0xFFFFFFFF


def store_with_proposal(folder: Path) -> tuple[Path, int, int]:
    """A store whose correction waits for review: store, its CRC, CRC of the active table."""
    store = folder / "waiting"
    with Flight(store, "encoder_bias") as f:
        f.start()
        f.step()
        assert f.do(kcm.cmd_t.START, 2, 6, 1).status == 0
        p = f.until("KC_PROPOSAL")
        assert p.verdict == p.CHANGE
        assert f.until("KC_HK").state == REVIEW  # stored, and the journal twice
        f.kill()
    return store, u32(p.crc), u32(p.crc_kin_before)


def copy_store(template: Path, to: Path) -> Path:
    """A store of its own with the files of another."""
    shutil.copytree(template, to)
    return to
