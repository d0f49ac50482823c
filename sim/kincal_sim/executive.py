"""Stand-in for the lander's executive: starts a calibration, watches it, decides by policy.

    python -m kincal_sim.executive --scenario paper --url udpm://239.255.76.67:7667?ttl=0 --out DIR

Writes DIR/result.json. Exit status 0: the calibration succeeded, 1: it did not.
"""

from __future__ import annotations

import argparse
import sys
import time
from collections import Counter
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import kcm
from kincal_shared.keys import DEFAULT, VARIABLE, file_of, signer_of

from . import outputs
from .bus import Bus
from .lockstep import Participant, Received
from .scenario import ACCEPT, ACQUISITIONS, VERDICTS, Scenario, load

CHANNELS = ["KC_HK", "KC_ACK", "KC_EVENT", "KC_PROPOSAL", "KC_ARM_STATE", "KC_PANTILT_STATE"]
# An executive knows flight by docs/INTERFACES.md alone, so these numbers and texts are here once more; a test
# compares them with the headers.
IDLE, REVIEW, SAFE = 0, 9, 11  # KC_HK.state
TBL_KIN = 4  # index in KC_HK.table_crc
WARNING = 2  # KC_EVENT.severity
NAMED, UNEXPLAINED, SEVERAL = 1, 2, 3  # KC_HK.mon_state
UNEXPLAINED_OBS = 5  # observations of an alarm without joints that are enough: more would hardly name any
NO_PATH = 68  # event of a START that is refused since the arm is elsewhere
UNDETERMINED = (2, 3, 4)  # KC_PROPOSAL.status: held, at its lower bound, at its upper bound
ABORTED = 75  # event whose `got` is the cause, an index into CAUSES
CAUSES = (
    "command ABORT",
    "the arm controller reports a fault",
    "the arm did not reach its target in time, or did not come to rest",
    "the pan-tilt unit did not reach its target in time, or did not come to rest",
    "no frame in spite of all retries",
    "no usable candidate left before enough was measured",
    "no verified path begins where the arm stands",
    "time or energy used up before enough was measured",
    "no state messages from the arm or the pan-tilt unit",
    "no correction within its bounds explains the observations",
    "tags detected at fewer than a third of the local initial poses",
    "tables or observations have changed in memory",
)
ROUNDING_US = 1000  # more than times in seconds are rounded by
FIRST_HEARTBEAT_S = 30.0
RETRY_S = 5.0  # after such a START
LINGER_S = 2.0  # after the end: one more heartbeat shows where flight stands
ABORT_WAIT_S = 10.0
POLICY_WAIT_S = 10.0
ACTIVE_WAIT_S = 2.0  # beyond the time-out of the answer
PEOPLE_S = 0.1  # wall time of a tick while people decide
GROUND_WAIT_S = 1800.0  # with --accept ground: somebody listens and will decide


class Executive:
    """One calibration. tick(now_us, messages) is called ten times a second; `send` publishes a command.

    Phases: HELLO (wait for heartbeat, arm and pan-tilt unit) -> (WATCH, wait for an alarm ->) START -> RUN
    -> DECIDE (policy) -> ARM -> GO -> END, or GROUND (somebody else decides) -> END, and from START and RUN
    ABORT -> END.

    seed: of flight's random acquisition; acquisition, poses: instead of the scenario's; first_seq: number of
    the first command. result: set when it is over, see record().
    """

    def __init__(
        self,
        scenario: Scenario,
        send: Callable[[kcm.cmd_t], None],
        seed: int = 1,
        acquisition: str = "",
        poses: int = 0,
        first_seq: int = 1,
    ):
        self.limits, self.send = scenario.executive, send
        request = scenario.calibration
        self.start_args = [ACQUISITIONS[acquisition or request.acquisition], poses or request.poses, seed, 0]
        self.estimate_mask, self.on_alarm = request.estimate_mask, request.start == "alarm"
        self.phase = "HELLO"
        self.result: dict = {}
        self.warnings: Counter[int] = Counter()  # events by id
        self._seq = first_seq
        self._now_us = self._quiet_until_us = 0
        self._begun_us: int | None = None
        self._phase_us = 0  # when this phase began
        self._hk: Any = None
        self._hk_us = 0
        self._proposal: Any = None
        self._awaited_seq: int | None = None  # command whose answer is awaited
        self._arm_received = self._pantilt_received = False
        self.channels = set(CHANNELS)  # that it still needs
        self._n_poses, self._pose_us = -1, 0
        self._abort_cause = ""
        self._watch_us: int | None = None  # when the wait for an alarm began
        self._not_before_us = 0  # next START
        self._started_us = 0  # the last one, after an alarm

    # ---- inputs ------------------------------------------------------------------------------------

    def tick(self, now_us: int, messages: list[Received]) -> bool:
        """Take in (channel, message) pairs, look at the clocks, act. False when everything is over."""
        self._now_us = now_us
        if not messages and now_us < self._quiet_until_us:
            return True
        if self._begun_us is None:
            self._begun_us = self._phase_us = now_us
        for channel, m in messages:
            self._HANDLERS[channel](self, m)
        if self.phase not in ("ABORT", "END"):
            self._check_timeouts()
        self._ACTIONS[self.phase](self)
        self._quiet_until_us = self._nothing_until_us() if self.phase == "RUN" else 0
        return not (self.phase == "END" and self._waited(LINGER_S))

    def _nothing_until_us(self) -> int:
        """Until when nothing happens in RUN if nothing is received: no time-out ends before. 0: at once."""
        if self._proposal is not None or self._hk.state in (IDLE, SAFE):
            return 0
        limits, started_us = self.limits, self._started_us or self._begun_us or 0
        ends_us = [
            self._hk_us + limits.heartbeat_timeout_s * 1e6,
            self._pose_us + limits.pose_timeout_s * 1e6,
            started_us + limits.total_timeout_s * 1e6,
        ]
        if self._awaited_seq is not None:
            ends_us.append(self._phase_us + limits.ack_timeout_s * 1e6)
        return int(min(ends_us)) - ROUNDING_US

    def _on_hk(self, m: kcm.hk_t) -> None:
        self._hk, self._hk_us = m, self._now_us
        if m.n_poses != self._n_poses:
            self._n_poses, self._pose_us = m.n_poses, self._now_us

    def _on_arm_state(self, _: kcm.arm_state_t) -> None:
        self._arm_received = True
        self.channels.discard("KC_ARM_STATE")

    def _on_pantilt_state(self, _: kcm.pantilt_state_t) -> None:
        self._pantilt_received = True
        self.channels.discard("KC_PANTILT_STATE")

    def _on_ack(self, m: kcm.ack_t) -> None:
        if m.source != kcm.cmd_t.SRC_EXECUTIVE or m.seq != self._awaited_seq:
            return
        self._awaited_seq = None
        if m.status != 0 and self.phase == "START" and self.on_alarm and m.event_id == NO_PATH:
            self._not_before_us = self._now_us + round(RETRY_S * 1e6)  # whoever moves the arm brings it there
            self._enter("WATCH")
        elif m.status != 0 and self.phase != "ABORT":
            self._fail(f"command {m.opcode} refused with status {m.status}, event {m.event_id}")

    def _on_event(self, m: kcm.event_t) -> None:
        if m.severity >= WARNING:
            self.warnings[m.id] += 1
        if m.id == ABORTED and 0 <= m.got < len(CAUSES):
            self._abort_cause = f": {CAUSES[int(m.got)]}"

    def _on_proposal(self, m: kcm.proposal_t) -> None:
        if self.phase == "RUN":
            self._proposal = m

    # ---- phases ------------------------------------------------------------------------------------

    def _hello(self) -> None:
        if self._hk is not None and self._arm_received and self._pantilt_received:
            if self.on_alarm:
                self._watch_us = self._now_us
                self._enter("WATCH")
            else:
                self._send_start()

    def _watch(self) -> None:
        """On an alarm, START: from the suspects, or without them if there are none."""
        m = self._hk
        if not self._hk_since() or m.state not in (IDLE, SAFE) or self._now_us < self._not_before_us:
            return
        if m.mon_state in (NAMED, SEVERAL):
            self._send_start(suspects=1)
        elif m.mon_state == UNEXPLAINED and m.mon_n_obs >= UNEXPLAINED_OBS:
            self._send_start()

    def _send_start(self, suspects: int = 0) -> None:
        """Only a calibration of our own counts from here on."""
        self._command(kcm.cmd_t.START, [*self.start_args[:3], suspects], self.estimate_mask)
        self._started_us = self._now_us if self.on_alarm else 0
        self._enter("START")

    def _start(self) -> None:
        if self._awaited_seq is None:
            self._enter("RUN")
            self._pose_us = self._now_us

    def _run(self) -> None:
        if self._proposal is not None:
            self._enter("DECIDE")
        elif self._hk_since() and self._hk.state == SAFE:
            self._fail(f"flight aborted the calibration{self._abort_cause}")
        elif self._hk_since() and self._hk.state == IDLE and self._waited(LINGER_S):
            self._fail("flight is idle and proposed nothing")

    def _decide(self) -> None:
        if self._proposal.verdict == kcm.proposal_t.NO_CHANGE:
            self._succeed("no change needed")
        elif self._proposal.verdict != kcm.proposal_t.CHANGE:
            self._fail("the fit is poor; the proposal is left to the ground")
        elif self.limits.accept == "ground":
            self._enter("GROUND")
        elif self.limits.accept == "policy":
            self._by_policy()
        else:
            self._by_limits()

    def _by_policy(self) -> None:
        """Flight decides by the policy that is on board."""
        if self._active():
            self._succeed("accepted on board")
        elif self._waited(POLICY_WAIT_S):
            self._succeed("outside the on-board policy, the correction waits for the ground")

    def _by_limits(self) -> None:
        """The executive decides by the scenario's limits, in two steps."""
        if reason := self._limit_violation(self._proposal):
            self._fail(f"correction not accepted, left to the ground: {reason}")
        else:
            self._command(kcm.cmd_t.APPROVE_ARM, [self._proposal.crc, 0, 0, 0])
            self._enter("ARM")

    def _wait_for_ground(self) -> None:
        """The ground decides; with ground_wait_s = 0 the run ends while the correction waits."""
        if self._active():
            self._succeed("correction approved by the ground and active")
        elif self._hk_since() and self._hk.proposal_crc == 0:
            self._fail("correction rejected by the ground")
        elif self._waited(self.limits.ground_wait_s):
            self._succeed("correction waits for the ground")

    def _arm(self) -> None:
        """The first step of the approval is sent; the second follows its answer."""
        if self._awaited_seq is None:
            self._command(kcm.cmd_t.APPROVE_GO, [self._proposal.crc, 0, 0, 0])
            self._enter("GO")

    def _wait_until_active(self) -> None:
        if self._active():
            self._succeed("correction approved and active")
        elif self._waited(self.limits.ack_timeout_s + ACTIVE_WAIT_S):
            self._fail("approved correction did not become active")

    def _abort(self) -> None:
        if self._awaited_seq is None or self._waited(ABORT_WAIT_S):
            self._enter("END")

    def _end(self) -> None:
        """Nothing is left to do; tick() says so after LINGER_S."""

    _HANDLERS = {
        "KC_HK": _on_hk,
        "KC_ARM_STATE": _on_arm_state,
        "KC_PANTILT_STATE": _on_pantilt_state,
        "KC_ACK": _on_ack,
        "KC_EVENT": _on_event,
        "KC_PROPOSAL": _on_proposal,
    }
    _ACTIONS = {
        "HELLO": _hello,
        "WATCH": _watch,
        "START": _start,
        "RUN": _run,
        "DECIDE": _decide,
        "GROUND": _wait_for_ground,
        "ARM": _arm,
        "GO": _wait_until_active,
        "ABORT": _abort,
        "END": _end,
    }

    # ---- clocks and helpers ------------------------------------------------------------------------

    def _check_timeouts(self) -> None:
        """Heartbeat, answer and progress."""
        limits = self.limits
        if self.phase == "HELLO":
            if self._waited(FIRST_HEARTBEAT_S):
                self._fail(f"no {' and no '.join(self._missing())}")
        elif self._ago(self._hk_us) > limits.heartbeat_timeout_s:
            self._fail(f"heartbeat lost for {limits.heartbeat_timeout_s:g} s")
        elif self._awaited_seq is not None and self._waited(limits.ack_timeout_s):
            self._fail(f"command {self._awaited_seq} not answered within {limits.ack_timeout_s:g} s")
        elif self.phase == "WATCH":
            if self._ago(self._watch_us or 0) > limits.alarm_wait_s:
                self._fail(f"no alarm for {limits.alarm_wait_s:g} s")
        elif self.phase == "RUN" and self._ago(self._pose_us) > limits.pose_timeout_s:
            self._fail(f"no new pose for {limits.pose_timeout_s:g} s")
        elif self._ago(self._started_us or self._begun_us or 0) > limits.total_timeout_s:
            self._fail(f"not finished after {limits.total_timeout_s:g} s")

    def _missing(self) -> list[str]:
        received = {
            "heartbeat": self._hk is not None,
            "arm state": self._arm_received,
            "pan-tilt state": self._pantilt_received,
        }
        return [name for name, there in received.items() if not there]

    def _limit_violation(self, p: kcm.proposal_t) -> str:
        """The first of the scenario's limits that the proposal does not keep; empty if it keeps all."""
        limits = self.limits
        for name, got, allowed in (
            ("predicted position error", p.pred_pos_m, limits.pred_pos_max_m),
            ("predicted rotation error", p.pred_rot_rad, limits.pred_rot_max_rad),
            ("outliers", p.n_outliers, limits.outliers_max),
            ("share of outliers", p.n_outliers / max(p.n_poses, 1), limits.outliers_share_max),
            ("coefficients that are held or at a bound", _undetermined(p), limits.undetermined_max),
        ):
            if not got <= allowed:  # NaN is a violation too
                return f"{name} {got:.4g} > {allowed:.4g}"
        if not p.p_fit >= limits.p_fit_min:
            return f"p of the fit {p.p_fit:.4g} < {limits.p_fit_min:.4g}"
        return ""

    def _active(self) -> bool:
        """Housekeeping newer than this phase shows the proposed table in force."""
        return self._hk_since() and self._hk.table_crc[TBL_KIN] == self._proposal.crc

    def _hk_since(self) -> bool:
        return self._hk is not None and self._hk.t_us >= self._phase_us

    def _ago(self, t_us: int) -> float:
        return (self._now_us - t_us) * 1e-6

    def _waited(self, seconds: float) -> bool:
        return self._ago(self._phase_us) >= seconds

    def _enter(self, phase: str) -> None:
        self.phase, self._phase_us = phase, self._now_us

    def _command(self, opcode: int, arg_i: Sequence[int] = (0, 0, 0, 0), arg_u64: int = 0) -> None:
        m = kcm.cmd_t()
        m.t_us, m.seq, m.source, m.opcode = self._now_us, self._seq, kcm.cmd_t.SRC_EXECUTIVE, opcode
        m.arg_i, m.arg_u64 = list(arg_i), arg_u64
        self.send(m)
        self._awaited_seq, self._seq = self._seq, self._seq + 1

    def _succeed(self, reason: str) -> None:
        self._finish(True, reason)
        self._enter("END")

    def _fail(self, reason: str) -> None:
        """End without success. While flight still measures, ABORT is sent; a proposal stays."""
        self._finish(False, reason)
        self._awaited_seq = None
        if self.phase in ("START", "RUN") and self._hk.state not in (IDLE, REVIEW, SAFE):
            self._command(kcm.cmd_t.ABORT)
            self._enter("ABORT")
        else:
            self._enter("END")

    def _finish(self, success: bool, reason: str) -> None:
        if self.result:
            return
        p = self._proposal
        self.result = {
            "success": success,
            "reason": reason,
            "phase": self.phase,
            "verdict": VERDICTS[p.verdict] if p is not None and 0 <= p.verdict < len(VERDICTS) else "",
            "crc": _hex(p.crc) if p is not None else "",
            "n_poses": p.n_poses if p is not None else max(self._n_poses, 0),
            "mission_s": round(self._ago(self._begun_us or 0), 1),
        }

    def record(self) -> dict:
        """The result with flight's last housekeeping, for result.json."""
        hk = self._hk
        return {
            **self.result,
            "state": hk.state if hk else None,
            "table_crc_kin": _hex(hk.table_crc[TBL_KIN]) if hk else "",
            "warnings": {str(k): v for k, v in sorted(self.warnings.items())},
        }


def _undetermined(p: kcm.proposal_t) -> int:
    return sum(status in UNDETERMINED for status in p.status[: p.n_coef])


def _hex(crc: int) -> str:
    return f"{crc & 0xFFFFFFFF:08x}"


def options(argv: list[str] | None) -> argparse.Namespace:
    """The command line."""
    about = (__doc__ or "").split("\n")[0]
    p = argparse.ArgumentParser(prog="python -m kincal_sim.executive", description=about)
    p.add_argument(
        "--scenario", required=True, help="name or file: accept policy, time-outs, what to ask for"
    )
    p.add_argument("--url", required=True, help="LCM URL")
    p.add_argument("--out", type=Path, required=True, help="folder for result.json")
    p.add_argument("--seed", type=int, default=1, help="of flight's random acquisition")
    p.add_argument("--acquisition", default="", choices=["", *ACQUISITIONS])
    p.add_argument("--poses", type=int, default=0)
    p.add_argument(
        "--accept", default="", choices=["", *ACCEPT], help="accept policy (default: the scenario's)"
    )
    p.add_argument("--keys", type=Path, help=f"key file (default: ${VARIABLE}, else {DEFAULT})")
    p.add_argument("--live", action="store_true", help="wall clock instead of lockstep")
    return p.parse_args(argv)


def accepted_by(scenario: Scenario, accept: str) -> Scenario:
    """A copy of the scenario with this accept policy; "" leaves it as it is. A ground that is asked for here
    listens, and gets time to decide."""
    changed = scenario.model_copy(deep=True)
    if accept:
        changed.executive.accept = accept  # type: ignore[assignment]  # the model checks it
    if accept == "ground":
        changed.executive.ground_wait_s = max(changed.executive.ground_wait_s, GROUND_WAIT_S)
    return changed


def main(argv: list[str] | None = None) -> int:
    """The process; exit status as above."""
    o = options(argv)
    signer = signer_of(file_of(o.keys))
    bus = Bus(o.url)
    # Live, a restarted executive must still be newer than its predecessor: count on from the clock.
    first_seq = int(time.time() - 1.7e9) * 4 if o.live else 1
    executive = Executive(
        accepted_by(load(o.scenario), o.accept),
        lambda m: bus.publish("KC_CMD", signer.command(m)),
        o.seed,
        o.acquisition,
        o.poses,
        first_seq,
    )

    def act(now_us: int, messages: list[Received]) -> bool:
        alive = executive.tick(now_us, messages)
        if executive.phase == "GROUND" and not o.live:
            time.sleep(PEOPLE_S)  # lockstep would be over before anybody has read the proposal
        return alive

    participant = Participant(bus, kcm.tick_done_t.WHO_EXECUTIVE, CHANNELS, act)
    o.out.mkdir(parents=True, exist_ok=True)
    if o.live:
        participant.run_live()
    else:
        participant.run_lockstep()
    outputs.write(o.out / outputs.RESULT, executive.record())
    return 0 if executive.result["success"] else 1


if __name__ == "__main__":
    sys.exit(main())
