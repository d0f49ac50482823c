"""Stand-in for the lander's executive: starts a calibration, watches it, decides by policy.

    python -m kincal_sim.executive --scenario paper --url udpm://239.255.76.67:7667?ttl=0 --out DIR

Writes DIR/result.json. Exit status 0: the calibration succeeded, 1: it did not.
"""

from __future__ import annotations

import argparse
import json
import sys
import time
from pathlib import Path

import kcm

from .bus import Bus, Participant
from .scenario import ACCEPT, ACQUISITIONS, VERDICTS, Scenario, load

HEARD = ["KC_HK", "KC_ACK", "KC_EVENT", "KC_PROPOSAL", "KC_ARM_STATE", "KC_PANTILT_STATE"]
IDLE, REVIEW, SAFE = 0, 9, 11  # KC_HK.state, see docs/INTERFACES.md
TBL_KIN = 4
ABORTED = 75  # event whose `got` is the cause, see docs/STATES.md
CAUSES = (
    "it was told to stop",
    "the arm controller reports a fault",
    "the arm did not get there in time",
    "the head did not get there in time",
    "no image came",
    "no usable pose was left",
    "the arm stands where no proven path begins",
    "time or energy was used up",
    "arm or head fell silent",
    "no correction within its bounds explains what was seen, so the arm goes nowhere else",
    "too few of the first looks saw a tag, so the arm goes nowhere else",
)
FIRST_HEARTBEAT_S = 30.0
LINGER_S = 2.0  # after the end: one more heartbeat shows where flight stands
ABORT_WAIT_S = 10.0
POLICY_WAIT_S = 10.0
PEOPLE_S = 0.1  # wall time of a tick while people decide
GROUND_WAIT_S = 1800.0  # with --accept ground: somebody listens and will decide


class Executive:
    """One calibration. tick(now_us, messages) is called ten times a second; `send` publishes a command.

    Phases: HELLO (wait for heartbeat, arm and head) -> START -> RUN -> DECIDE (policy) -> ARM -> GO -> END,
    or GROUND (somebody else decides) -> END, and from START and RUN ABORT -> END.
    """

    def __init__(
        self,
        scenario: Scenario,
        send,
        seed: int = 1,
        acquisition: str = "",
        poses: int = 0,
        first_seq: int = 1,
    ):
        self.limits, self.send = scenario.executive, send
        self.ask = [
            ACQUISITIONS[acquisition or scenario.calibration.acquisition],
            poses or scenario.calibration.poses,
            seed,
            0,
        ]
        self.mask = scenario.calibration.estimate_mask
        self.seq = first_seq
        self.phase, self.since_us, self.now_us, self.begun_us = "HELLO", None, 0, None
        self.hk = self.hk_us = self.proposal = self.awaited = None
        self.arm_heard = self.head_heard = False
        self.pose, self.pose_us = -1, 0
        self.result: dict = {}
        self.warnings: dict[int, int] = {}
        self.why = ""

    # -- inputs --------------------------------------------------------------------------------------

    def tick(self, now_us: int, messages: list) -> bool:
        """Take what was heard, look at the clocks, act. False when everything is over."""
        self.now_us = now_us
        self.since_us = now_us if self.since_us is None else self.since_us
        self.begun_us = now_us if self.begun_us is None else self.begun_us
        for channel, m in messages:
            getattr(self, "_on_" + channel.removeprefix("KC_").lower())(m)
        if self.phase not in ("ABORT", "END"):
            self._watch()
        getattr(self, "_do_" + self.phase.lower())()
        return not (self.phase == "END" and self._waited(LINGER_S))

    def _on_hk(self, m) -> None:
        self.hk, self.hk_us = m, self.now_us
        if m.n_poses != self.pose:
            self.pose, self.pose_us = m.n_poses, self.now_us

    def _on_arm_state(self, _) -> None:
        self.arm_heard = True

    def _on_pantilt_state(self, _) -> None:
        self.head_heard = True

    def _on_ack(self, m) -> None:
        if m.source != kcm.cmd_t.SRC_EXECUTIVE or m.seq != self.awaited:
            return
        self.awaited = None
        if m.status != 0 and self.phase != "ABORT":
            self._fail(f"command {m.opcode} refused with status {m.status}, event {m.event_id}")

    def _on_event(self, m) -> None:
        if m.severity >= 2:
            self.warnings[m.id] = self.warnings.get(m.id, 0) + 1
        if m.id == ABORTED and 0 <= m.got < len(CAUSES):
            self.why = f": {CAUSES[int(m.got)]}"

    def _on_proposal(self, m) -> None:
        if self.phase == "RUN":
            self.proposal = m

    # -- phases --------------------------------------------------------------------------------------

    def _do_hello(self) -> None:
        if self.hk is not None and self.arm_heard and self.head_heard:
            # Only a calibration of our own counts from here on.
            self._command(kcm.cmd_t.START, self.ask, self.mask)
            self._go("START")

    def _do_start(self) -> None:
        if self.awaited is None:
            self._go("RUN")
            self.pose_us = self.now_us

    def _do_run(self) -> None:
        if self.proposal is not None:
            self._go("DECIDE")
        elif self._hk_since() and self.hk.state == SAFE:
            self._fail(f"flight gave the calibration up{self.why}")
        elif self._hk_since() and self.hk.state == IDLE and self._waited(LINGER_S):
            self._fail("flight is idle and proposed nothing")

    def _do_decide(self) -> None:
        p, accept = self.proposal, self.limits.accept
        if p.verdict == kcm.proposal_t.NO_CHANGE:
            self._succeed("nothing needs to change")
        elif p.verdict != kcm.proposal_t.CHANGE:
            self._fail("the fit is poor")
        elif accept == "ground":
            self._go("GROUND")
        elif accept == "policy":
            if self._active():
                self._succeed("accepted on board")
            elif self._waited(POLICY_WAIT_S):
                self._succeed("outside the on-board policy, correction waits for the ground")
        elif reason := self._outside_limits(p):
            self._fail(f"correction not accepted: {reason}")
        else:
            self._command(kcm.cmd_t.APPROVE_ARM, [p.crc, 0, 0, 0])
            self._go("ARM")

    def _do_ground(self) -> None:
        """The ground decides; with ground_wait_s = 0 the run ends while the correction waits."""
        if self._active():
            self._succeed("correction approved by the ground and active")
        elif self._hk_since() and self.hk.proposal_crc == 0:
            self._fail("correction rejected by the ground")
        elif self._waited(self.limits.ground_wait_s):
            self._succeed("correction waits for the ground")

    def _do_arm(self) -> None:
        if self.awaited is None:
            self._command(kcm.cmd_t.APPROVE_GO, [self.proposal.crc, 0, 0, 0])
            self._go("GO")

    def _do_go(self) -> None:
        if self._active():
            self._succeed("correction approved and active")
        elif self._waited(self.limits.ack_timeout_s + 2.0):
            self._fail("approved correction did not become active")

    def _do_abort(self) -> None:
        if self.awaited is None or self._waited(ABORT_WAIT_S):
            self._go("END")

    def _do_end(self) -> None:
        pass

    # -- clocks and helpers --------------------------------------------------------------------------

    def _watch(self) -> None:
        """Heartbeat, answer and progress time-outs."""
        limits = self.limits
        if self.phase == "HELLO":
            if self._waited(FIRST_HEARTBEAT_S):
                heard = {"heartbeat": self.hk, "arm state": self.arm_heard, "head state": self.head_heard}
                self._fail(f"no {' and no '.join(k for k, v in heard.items() if not v)}")
        elif self._ago(self.hk_us) > limits.heartbeat_timeout_s:
            self._fail(f"heartbeat lost for {limits.heartbeat_timeout_s:g} s")
        elif self.awaited is not None and self._waited(limits.ack_timeout_s):
            self._fail(f"command {self.awaited} not answered within {limits.ack_timeout_s:g} s")
        elif self.phase == "RUN" and self._ago(self.pose_us) > limits.pose_timeout_s:
            self._fail(f"no new pose for {limits.pose_timeout_s:g} s")
        elif self._ago(self.begun_us) > limits.total_timeout_s:
            self._fail(f"not finished after {limits.total_timeout_s:g} s")

    def _outside_limits(self, p) -> str:
        limits = self.limits
        for name, got, allowed in (
            ("predicted position sigma", p.pred_pos_m, limits.pred_pos_max_m),
            ("predicted rotation sigma", p.pred_rot_rad, limits.pred_rot_max_rad),
            ("outliers", p.n_outliers, limits.outliers_max),
        ):
            if not got <= allowed:
                return f"{name} {got:.4g} > {allowed:.4g}"
        return ""

    def _active(self) -> bool:
        """Housekeeping newer than this phase shows the proposed table in force."""
        return self._hk_since() and self.hk.table_crc[TBL_KIN] == self.proposal.crc

    def _hk_since(self) -> bool:
        return self.hk is not None and self.hk.t_us >= self.since_us

    def _ago(self, t_us: int) -> float:
        return (self.now_us - t_us) * 1e-6

    def _waited(self, seconds: float) -> bool:
        return self._ago(self.since_us) >= seconds

    def _go(self, phase: str) -> None:
        self.phase, self.since_us = phase, self.now_us

    def _command(self, opcode: int, arg_i=(0, 0, 0, 0), arg_u64: int = 0) -> None:
        m = kcm.cmd_t()
        m.t_us, m.seq, m.source, m.opcode = self.now_us, self.seq, kcm.cmd_t.SRC_EXECUTIVE, opcode
        m.arg_i, m.arg_u64 = list(arg_i), arg_u64
        self.send(m)
        self.awaited, self.seq = self.seq, self.seq + 1

    def _succeed(self, reason: str) -> None:
        self._finish(True, reason)
        self._go("END")

    def _fail(self, reason: str) -> None:
        """Give up. While flight still measures, it is told to stop; a proposal is left to the ground."""
        self._finish(False, reason)
        self.awaited = None
        if self.phase in ("START", "RUN") and self.hk.state not in (IDLE, REVIEW, SAFE):
            self._command(kcm.cmd_t.ABORT)
            self._go("ABORT")
        else:
            self._go("END")

    def _finish(self, success: bool, reason: str) -> None:
        if self.result:
            return
        p = self.proposal
        self.result = {
            "success": success,
            "reason": reason,
            "phase": self.phase,
            "verdict": VERDICTS[p.verdict] if p is not None and 0 <= p.verdict < len(VERDICTS) else "",
            "crc": f"{p.crc & 0xFFFFFFFF:08x}" if p is not None else "",
            "n_poses": p.n_poses if p is not None else max(self.pose, 0),
            "mission_s": round(self._ago(self.begun_us), 1),
        }

    def record(self) -> dict:
        """The result with flight's last housekeeping, for result.json."""
        hk = self.hk
        return {
            **self.result,
            "state": hk.state if hk else None,
            "table_crc_kin": f"{hk.table_crc[TBL_KIN] & 0xFFFFFFFF:08x}" if hk else "",
            "warnings": {str(k): v for k, v in sorted(self.warnings.items())},
        }


def options(argv: list[str] | None) -> argparse.Namespace:
    p = argparse.ArgumentParser(prog="python -m kincal_sim.executive", description=__doc__.split("\n")[0])
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
    p.add_argument("--live", action="store_true", help="wall clock instead of lockstep")
    return p.parse_args(argv)


def main(argv: list[str] | None = None) -> int:
    o = options(argv)
    bus = Bus(o.url)
    # Live, a restarted executive must still be newer than its predecessor: count on from the clock.
    first_seq = int(time.time() - 1.7e9) * 4 if o.live else 1
    scenario = load(o.scenario)
    scenario.executive.accept = o.accept or scenario.executive.accept
    if o.accept == "ground":
        scenario.executive.ground_wait_s = max(scenario.executive.ground_wait_s, GROUND_WAIT_S)
    executive = Executive(
        scenario, lambda m: bus.publish("KC_CMD", m), o.seed, o.acquisition, o.poses, first_seq
    )

    def act(now_us: int, messages: list) -> bool:
        alive = executive.tick(now_us, messages)
        if executive.phase == "GROUND" and not o.live:
            time.sleep(PEOPLE_S)  # lockstep would be over before anybody has read the proposal
        return alive

    part = Participant(bus, kcm.tick_done_t.WHO_EXECUTIVE, HEARD, act)
    o.out.mkdir(parents=True, exist_ok=True)
    part.run_live() if o.live else part.run_lockstep()
    # Written as a whole: whoever finds the file finds all of it.
    part_file = o.out / "result.json.part"
    part_file.write_text(json.dumps(executive.record(), indent=1) + "\n")
    part_file.rename(o.out / "result.json")
    return 0 if executive.result["success"] else 1


if __name__ == "__main__":
    sys.exit(main())
