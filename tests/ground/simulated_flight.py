"""Flight's core and the simulator in this process, on a network of their own: as fast as they can until a
state is reached, then slowly, so that a browser can follow."""

import threading
import time

import lcm

import kcm
from kincal.flight import library
from kincal.run.inprocess import Script, Setup, Simulation, command
from kincal_shared import keys
from kincal_sim.ports import private_port, private_url

START_TICK = 3
SLOW_S = 0.04  # a tick of 0.1 s takes this long
FAST_S = 0.0005  # so that a receiver of datagrams keeps up
SPARSE = {"KC_ARM_STATE": 4, "KC_PANTILT_STATE": 4}  # while it runs fast: every so manyth
SHOWN = {"KC_ARM_STATE", "KC_PANTILT_STATE", "KC_DETECTION"}


class SimulatedFlight:
    """until: names of the states from which on it runs slowly; start: whether a calibration begins; more: of
    the run's Setup."""

    def __init__(self, scenario, until: set[str], folder, seed: int = 1, poses: int = 0,
                 start: bool = True, **more) -> None:  # fmt: skip
        port, self._port_lock = private_port()
        self.url = private_url(port)
        states = library("flight").enum("kc_state_t", "KC_ST_")
        self._until = {states[name] for name in until}
        self.names = {number: name for name, number in states.items()}
        self.state = ""
        script = [(START_TICK, command("START", -1, poses, seed))] if start else []
        setup = Setup(**{"commander": lambda send: Script(send, script), "limit_s": 1e5} | more)
        self._simulation = Simulation(scenario, seed, setup)
        self.key_file = folder / "keys"
        keys.write(self.key_file, (self._simulation.signer.key,))
        self.commands: list[int] = []
        self._bus = lcm.LCM(self.url)
        self._bus.subscribe("KC_CMD", self._on_cmd)
        self._bus.subscribe("KC_TABLE_UP", self._on_chunk).set_queue_capacity(0)
        self._stop = threading.Event()
        self._thread = threading.Thread(target=self._run, daemon=True)

    def __enter__(self):
        self._thread.start()
        return self

    def __exit__(self, *_):
        self._stop.set()
        self._thread.join()
        self._port_lock.close()

    def _on_cmd(self, channel: str, data: bytes) -> None:
        message = kcm.cmd_t.decode(data)
        self.commands.append(message.opcode)
        self._simulation.publish(channel, message)

    def _on_chunk(self, channel: str, data: bytes) -> None:
        self._simulation.publish(channel, kcm.table_chunk_t.decode(data))

    def _run(self) -> None:
        slow = False
        with self._simulation as simulation:
            while not self._stop.is_set() and (tick := simulation.step()) is not None:
                self.state = self.names[tick.state]
                slow = slow or tick.state in self._until
                for channel, message in (*tick.to_flight, *tick.from_flight):
                    if channel in SHOWN and not slow and tick.number % SPARSE.get(channel, 1):
                        continue
                    if channel != "KC_CMD":
                        self._bus.publish(channel, message.encode())
                self._bus.handle_timeout(0)
                time.sleep(SLOW_S if slow else FAST_S)

    def wait(self, states: set[str], timeout_s: float = 60.0) -> None:
        """Until flight is in one of these states."""
        deadline = time.monotonic() + timeout_s
        while self.state not in states:
            assert time.monotonic() < deadline, f"flight is in {self.state}, not in {states}"
            time.sleep(0.02)
