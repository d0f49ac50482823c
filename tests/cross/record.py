"""What the core is called with in whole calibrations, as a file that tests/cross/replay.c steps it with.

    record.py FOLDER        FOLDER/record.bin, expected.txt, and replay_fields.h for replay.c

record.bin is a list of calls: length, kind of call ("i"nit, "k"eys, "l"oad, "b"oot, "s"tep)
and its arguments, as fields.py says. It holds several calibrations, each begins with "i", and so does the
start after a power loss. expected.txt is what the replay has to print: replay.c says what it is.
"""

from __future__ import annotations

import argparse
import struct
import zlib
from pathlib import Path

from fields import c_source, packed

from kincal.run import onboard
from kincal.run.inprocess import Hooks, Setup, simulate

FFI = onboard._FLIGHT.ffi
IN = ("kc_keys_t", "kc_cmd_t", "kc_table_chunk_t", "kc_detection_t", "kc_arm_state_t", "kc_pantilt_state_t")
OUT = ("kc_ack_t", "kc_event_t", "kc_arm_cmd_t", "kc_pantilt_cmd_t", "kc_hk_t", "kc_meas_t", "kc_progress_t",
       "kc_proposal_t", "kc_table_chunk_t")  # fmt: skip
LINE_STEPS = 100
# scenario, seed, how: the paper's errors, bending links, and nothing wrong but the power
RUNS = (
    ("paper", 3, Setup()),
    ("compliance", 2, Setup()),
    ("healthy", 1, Setup(hooks=Hooks(power_loss=lambda tick: tick == 500))),
)


def inputs(i: object) -> bytes:
    """kc_in_t, without what is not there."""
    parts = [struct.pack("<I", i.n_rx_errors)]
    for name in ("cmd", "chunk", "det"):
        values = getattr(i, name)[0 : getattr(i, f"n_{name}")]
        parts += [struct.pack("<I", len(values)), *(packed(FFI, x) for x in values)]
    for name in ("arm", "pantilt"):
        there = getattr(i, f"has_{name}")
        parts += [bytes([there]), packed(FFI, getattr(i, name)) if there else b""]
    parts.append(struct.pack("<BHi", i.has_store_result, i.store_kind, i.store_status))
    return b"".join(parts)


def outputs(o: object) -> tuple[bytes, ...]:
    """kc_out_t by group: commands and answers, events, telemetry, proposals, and what is to be kept."""

    def there(*names: str) -> bytes:
        return b"".join(packed(FFI, getattr(o, name)) for name in names if getattr(o, f"has_{name}"))

    acks, events = o.ack[0 : o.n_ack], o.events.e[0 : o.events.n]
    frame = struct.pack("<i", o.frame_request.seq) if o.has_frame_request else b""
    commands = b"".join(packed(FFI, x) for x in acks) + there("arm_cmd", "pantilt_cmd") + frame
    kept = (struct.pack("<HI", s.kind, s.n) + bytes(FFI.buffer(s.data, s.n)) for s in o.store[0 : o.n_store])
    telemetry = there("hk", "meas", "progress", "table_down")
    return commands, b"".join(packed(FFI, x) for x in events), telemetry, there("proposal"), b"".join(kept)


class Recorder:
    """The core, with each call and the checksums of what it gives written down."""

    def __init__(self, core: object) -> None:
        self._core, self._app = core, None
        self._steps, self._sums = 0, [0] * 5
        self.calls: list[bytes] = []
        self.lines: list[str] = []

    def __getattr__(self, name: str) -> object:
        return getattr(self._core, name)

    def _note(self, kind: bytes, arguments: bytes = b"") -> None:
        self.calls.append(struct.pack("<I", 1 + len(arguments)) + kind + arguments)

    def _line(self) -> None:
        numbers = (self._steps, self._core.kc_app_state(self._app), *self._sums)
        self.lines.append(" ".join(f"{x:08x}" for x in numbers))

    def end(self) -> None:
        """The line at the end of a calibration, if there was one."""
        if self._steps > 0:
            self._line()
        self._steps, self._sums = 0, [0] * 5

    def kc_app_init(self, app: object) -> None:
        self._note(b"i")
        self.end()
        self._app = app
        self._core.kc_app_init(app)

    def kc_app_keys(self, app: object, keys: object) -> None:
        self._note(b"k", packed(FFI, keys[0]))
        self._core.kc_app_keys(app, keys)

    def kc_app_load(self, app: object, kind: int, data: bytes, n: int) -> int:
        self._note(b"l", struct.pack("<H", kind) + bytes(data[:n]))
        return self._core.kc_app_load(app, kind, data, n)

    def kc_app_boot(self, app: object) -> None:
        self._note(b"b")
        self._core.kc_app_boot(app)

    def kc_app_step(self, app: object, now_us: int, i: object, out: object) -> None:
        self._note(b"s", struct.pack("<Q", now_us) + inputs(i))
        self._core.kc_app_step(app, now_us, i, out)
        self._sums = [zlib.crc32(x, crc) for x, crc in zip(outputs(out), self._sums, strict=True)]
        self._steps += 1
        if self._steps % LINE_STEPS == 0:
            self._line()


def record(folder: Path, runs: tuple[tuple[str, int, Setup], ...] = RUNS) -> None:
    """Run calibrations and write the files."""
    folder.mkdir(parents=True, exist_ok=True)
    core = onboard._LIB
    recorder = onboard._LIB = Recorder(core)
    try:
        for scenario, seed, setup in runs:
            done = simulate(scenario, seed, setup)
            print(f"  {scenario} {seed}: {done.record['verdict']}, {done.mission_s:.0f} s")
            recorder.end()
    finally:
        onboard._LIB = core
    (folder / "record.bin").write_bytes(b"".join(recorder.calls))
    (folder / "expected.txt").write_text("\n".join(recorder.lines) + "\n")
    (folder / "replay_fields.h").write_text(c_source(FFI, IN + OUT))


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("folder", type=Path)
    record(parser.parse_args().folder)


if __name__ == "__main__":
    main()
