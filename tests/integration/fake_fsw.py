#!/usr/bin/env python3
"""A tiny participant in flight's place: takes the same options, moves the arm a little, requests frames,
and proposes what --script says. It lets the simulator's processes be tested without flight software."""

import argparse
import sys
from pathlib import Path

import kcm
from kincal_sim.bus import Bus
from kincal_sim.lockstep import Participant

IDLE, MOVE, REVIEW, SAFE = 0, 1, 9, 11
CRC = -559038737  # what KC_PROPOSAL and approval name
FRAMES = 5
HEARD = ["KC_ARM_STATE", "KC_DETECTION", "KC_CMD"]
HK_PERIOD_US = 1_000_000
# Scripts: "change": a proposal comes; "no-housekeeping": none after the second frame; "stuck": no progress;
# "crash": ends with status 7.


class FakeFlight:
    """Flight as its telemetry shows it; script: see above."""

    def __init__(self, bus, script):
        self.bus, self.script = bus, script
        self.state, self.seq, self.poses, self.requested = IDLE, 0, 0, 0
        self.kin, self.next_hk_us, self.arm_state = 0, 0, None

    def publish(self, channel, m, now_us):
        m.t_us = now_us
        if hasattr(m, "seq") and channel != "KC_ACK":
            self.seq += 1
            m.seq = self.seq
        self.bus.publish(channel, m)

    def tick(self, now_us, messages):
        for channel, m in messages:
            self.handle(channel, m, now_us)
        if self.state == MOVE and self.script != "stuck":
            self.work(now_us)
        if now_us >= self.next_hk_us and not (self.script == "no-housekeeping" and self.poses > 1):
            self.housekeeping(now_us)
        if self.script == "crash" and self.poses > 1:
            print("fake flight crashes on purpose", file=sys.stderr)
            sys.exit(7)
        return True

    def handle(self, channel, m, now_us):
        if channel == "KC_CMD":
            self.command(m, now_us)
        elif channel == "KC_ARM_STATE":
            self.arm_state = m
        elif self.state == MOVE:
            self.poses += 1

    def housekeeping(self, now_us):
        self.next_hk_us = now_us + HK_PERIOD_US
        hk = kcm.hk_t()
        hk.state, hk.n_poses, hk.n_poses_goal = self.state, self.poses, FRAMES
        hk.table_crc = [0, 0, 0, 0, self.kin, 0, 0, 0]
        self.publish("KC_HK", hk, now_us)

    def command(self, m, now_us):
        ack = kcm.ack_t()
        ack.source, ack.seq, ack.opcode = m.source, m.seq, m.opcode
        self.publish("KC_ACK", ack, now_us)
        if m.opcode == kcm.cmd_t.START:
            self.state = MOVE
            self.move(now_us)
        elif m.opcode == kcm.cmd_t.ABORT:
            self.state = SAFE
        elif m.opcode == kcm.cmd_t.APPROVE_GO and m.arg_i[0] == CRC:
            self.kin, self.state = CRC, IDLE

    def move(self, now_us):
        """To a posture in which the camera sees a tag of the paper's faulty arm."""
        arm = kcm.arm_cmd_t()
        arm.n_joints, arm.speed_scale = 7, 1.0
        arm.q_rad = [0.3, -0.5, 0.1, 2.0, 0.0, 0.3, 0.2, 0.0]
        self.publish("KC_ARM_CMD", arm, now_us)
        pantilt = kcm.pantilt_cmd_t()
        pantilt.pan_rad, pantilt.tilt_rad = -0.77, 0.35
        self.publish("KC_PANTILT_CMD", pantilt, now_us)

    def work(self, now_us):
        if self.poses == FRAMES:
            p = kcm.proposal_t()
            p.crc, p.n_poses, p.p_fit = CRC, FRAMES, 0.5
            p.verdict = p.CHANGE
            self.state = REVIEW
            self.publish("KC_PROPOSAL", p, now_us)
        elif self.arm_state is not None and not self.arm_state.moving and self.requested == self.poses:
            self.requested += 1
            self.publish("KC_FRAME_REQUEST", kcm.frame_request_t(), now_us)


def main():
    p = argparse.ArgumentParser()
    p.add_argument("--url", required=True)
    p.add_argument("--tables", type=Path)
    p.add_argument("--store", type=Path)
    p.add_argument("--keys", type=Path)
    p.add_argument("--lockstep", action="store_true")
    p.add_argument("--live", action="store_true")
    o = p.parse_args()
    bus = Bus(o.url)
    # Which script to play comes through the store folder: launch has no option for it, and needs none.
    script = (o.store / "script").read_text() if (o.store / "script").exists() else "change"
    flight = FakeFlight(bus, script)
    participant = Participant(bus, kcm.tick_done_t.WHO_FSW, HEARD, flight.tick)
    if o.live:
        participant.run_live()
    else:
        participant.run_lockstep()


if __name__ == "__main__":
    main()
