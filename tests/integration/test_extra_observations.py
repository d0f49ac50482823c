"""Calibrations that also observe on their way: what they measure, where, and how the ground reads it."""

import shutil

import numpy as np
import pytest
from flight import CORE, TABLES, read_table

from kincal.flight import Terms
from kincal.flight import tables as codec
from kincal.run.inprocess import Setup, simulate
from kincal.space import SpaceTable
from kincal.workbench.data.readers.lcm import read_log

STOP = CORE.constant("KC_AT_STOP")
SETTINGS = {"initial_design": 0, "extra_obs_max": 4, "stops_max": 2, "n_poses": 5}


@pytest.fixture(scope="module")
def run(tmp_path_factory):
    folder = tmp_path_factory.mktemp("extra")
    shutil.copytree(TABLES, folder / "tables")
    _, config = codec.decode_as("config", (TABLES / "config.tbl").read_bytes())
    for name, value in SETTINGS.items():
        setattr(config, name, value)
    (folder / "tables" / "config.tbl").write_bytes(codec.encode("config", config).data)
    return simulate("paper", 3, Setup(tables=folder / "tables", log=folder / "run.lcm")), folder / "run.lcm"


def test_every_kind_of_place_is_observed_and_only_poses_count(run):
    session = run[0].log.last_session
    assert {m.taken_at for m in session.measurements} == {0, 1, 2, 3}
    assert [m.observation for m in session.measurements] == list(range(1, len(session.measurements) + 1))
    assert [m.pose for m in session.at_poses] == [p.pose for p in session.progress]
    assert session.proposal.n_poses == len(session.at_poses)
    assert session.proposal.dof == 6 * len(session.measurements) - session.proposal.rank
    sent = run[0].log.counts["KC_MEAS"]
    assert run[0].log.hk.n_meas == sent == len(session.measurements) + 1  # the servo had to come back once


def test_stops_are_those_of_the_table(run):
    table = SpaceTable.load(TABLES / "space.tbl")[1]
    stops = [m for m in run[0].log.last_session.measurements if m.taken_at == STOP]
    assert len(stops) >= 4
    for m in stops:
        row = table.row(m.candidate)
        places = [row.hub_q_rad + part / 256.0 * (row.q_rad - row.hub_q_rad) for part in row.stops]
        assert min(np.abs(np.array(m.q_rad[:7]) - q).max() for q in places) < 2e-3
    assert not run[0].contacts


def test_the_correction_is_right(run):
    names = list(Terms.of_table(read_table("terms")).names)
    found = dict(zip(names, run[0].log.last_session.proposal.value, strict=False))
    for name, error in run[0].scenario.arm.errors.items():
        assert found[name] == pytest.approx(error, abs=3e-3)


def test_the_workbench_tells_them_from_poses(run):
    session, read = run[0].log.last_session, read_log(run[1], 7)
    assert len(set(read.ids)) == len(session.measurements)
    assert [i for i in read.ids if "w" not in i] == [str(m.pose) for m in session.at_poses]
    assert len(set(read.replicate.tolist())) == len(session.measurements)
