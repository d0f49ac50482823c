"""Campaigns: answers to wrong files, cases that survive kills and full disks, replays, and what they
show."""

import json
import os
import re
import shutil
import signal
import subprocess
import sys
import time
import warnings
from functools import partial
from pathlib import Path

import numpy as np
import pytest
from commands import good, shell
from medium import full_medium
from places import BIN, ROOT
from scipy import stats

from kincal import campaign
from kincal.campaign import cluster, fly, function, installed, pool, statistics, store
from kincal.campaign import plan as plan_
from kincal.run import dispersed
from kincal_shared.errors import BadInput, CommandFailed
from kincal_shared.schema.campaign import Condition, Requirement
from kincal_shared.schema.errors import Contradiction

run = partial(campaign.run, processes=1)  # each takes a second to start
KINCAL = (sys.executable, "-m", "kincal")
CASES = 4
SPEC = f"""
title = "test"
scenario = "healthy"
cases = {CASES}
seed = 7
set = {{ "calibration.poses" = 1 }}
[[dispersion]]
key = "arm.errors.J2.phi_rad"
uniform = [-0.02, 0.02]
[[dispersion]]
key = "config.stop_pos_m"
uniform = [0.001, 0.004]
[[requirement]]
name = "comes to an end"
holds = 'ended != "no end"'
probability = 0.4
"""
COMBINED = """
scenario = "healthy"
cases = 6
seed = 5
sampling = "combinations"
[[dispersion]]
key = "env.temp_c"
choice = [0.0, 1.0]
"""


def spec_file(folder, text=SPEC):
    path = folder / "spec.toml"
    path.write_text(text)
    return path


def rows(folder):
    """All cases of a folder without timings, by index."""
    found = campaign.read(folder)
    columns = {k: v for k, v in found.columns.items() if k not in function.TIMINGS}
    return [dict(zip(columns, values, strict=True)) for values in zip(*columns.values(), strict=True)]


@pytest.fixture(scope="module")
def whole(tmp_path_factory):
    """A campaign that nobody interrupted, by two workers; and its file."""
    folder = tmp_path_factory.mktemp("whole")
    path = spec_file(folder)
    seen = []
    end = run(campaign.prepare(path), folder / "out", processes=2, batch=2, tick=seen.append)
    assert (end.done, end.of, end.flown, end.died) == (CASES, CASES, CASES, 0)
    assert [p.done for p in seen] == [1, 2, 3, 4]
    assert seen[0].rate > 0
    assert seen[0].left_s > 0
    return path, folder / "out"


# --------------------------------------------------------------------------- the file


@pytest.mark.parametrize(
    ("old", "new", "said"),
    [
        ("seed = 7", "sed = 7", ("sed", "unknown key", "seed")),
        ('scenario = "healthy"', 'scenario = "helthy"', ("scenario", "no scenario 'helthy'", "healthy")),
        ('scenario = "healthy"', "", ("scenario", "is missing")),
        (
            'scenario = "healthy"',
            'scenario = "healthy"\nfunction = "a:b"',
            ("and a function too", "give one"),
        ),
        ("seed = 7", 'columns = { a = "number" }', ("columns", "a scenario has columns of its own")),
        ("seed = 7", 'sampling = "combinations"', ("sampling", "only choices have combinations")),
        (SPEC, COMBINED.replace("seed = 5", "seed = 2147483642"), ("seed", "less the cases", "smaller")),
        ("[-0.02, 0.02]", "[0.02, -0.02]", ("dispersion[1].uniform", "empty", "low below high")),
        ("[-0.02, 0.02]", "[0.02, 0.02]", ("empty",)),
        ("uniform = [-0.02, 0.02]", "", ("no distribution", "exactly one")),
        ("uniform = [-0.02, 0.02]", "uniform = [0.0, 1.0]\nnormal = [0.0, 1.0]", ("uniform and normal",)),
        ("uniform = [-0.02, 0.02]", "uniform = [0.0, 1.0]\nlimits = [0.0, 1.0]", ("limits go with normal",)),
        ("uniform = [-0.02, 0.02]", "uniform = [0.0, 1.0]\nchoice = [0.0, 1.0]", ("uniform and choice",)),
        ("uniform = [-0.02, 0.02]", "normal = [0.0, 1.0]\nlimits = [0.2, -0.2]", ("limits", "empty")),
        ("uniform = [-0.02, 0.02]", "normal = [0.0, -1.0]", ("dispersion[1].normal",)),
        ("uniform = [-0.02, 0.02]", "choice = []", ("dispersion[1].choice",)),
        ('scenario = "healthy"', 'scenario = "none/here.toml"', ("scenario", "none/here.toml")),
        ("J2.phi_rad", "J9.phi_rad", ("J9.phi_rad", "dispersion[1]", "known: J1..J7")),
        ("arm.errors.J2.phi_rad", "arm.errrors.J2.phi_rad", ("errrors", "known there")),
        ("arm.errors.J2.phi_rad", "arm.errors", ("no single value",)),
        ("arm.errors.J2.phi_rad", "optics.read_noise_dn", ("nothing that can be changed", "detection.*")),
        ("config.stop_pos_m", "config.stop_pos", ("stop_pos", "known there")),
        ("[0.001, 0.004]", "[-1.0, 0.004]", ("dispersion[2]", "config.stop_pos_m = -1.0")),
        ("config.stop_pos_m", "arm.errors.J*.phi_rad", ("given twice", "dispersion[1]")),
        (  # its ends are whole numbers, what is drawn between them is none
            'key = "config.stop_pos_m"\nuniform = [0.001, 0.004]',
            'key = "executive.outliers_max"\nuniform = [1.0, 2.0]',
            ("dispersion[2]", "executive.outliers_max = 1.38", "whole number"),
        ),
        ("config.stop_pos_m", "calibration.poses", ("given twice", "by set")),
        ("arm.errors.J2.phi_rad", "arm.encoder_noise_rad", ("arm.encoder_noise_rad", "must be 0 or more")),
        ("seed = 7", 'sampling = "sobol"\ncases = 5', ("not valid TOML",)),
        (f"cases = {CASES}", 'cases = 5\nsampling = "sobol"', ("powers of two", "4 or 8")),
        ("probability = 0.4", "probability = 1.0", ("must be below 1",)),
        ("'ended != \"no end\"'", "'end != 1'", ("has no 'end'", "after_pos_m")),
        ("'ended != \"no end\"'", "'__import__(1)'", ("cannot be read",)),
        ("no end", "no ende", ("requirement[1].holds", "ended is never 'no ende'", "'no end', 'died'")),
        (
            "'ended != \"no end\"'",
            "'verdict == \"nochange\"'",
            ("verdict is never 'nochange'", "'no_change'"),
        ),
        ("'ended != \"no end\"'", "'True'", ("requirement[1].holds", "True is the same for every case")),
        ("'ended != \"no end\"'", "'active or 1 < 2'", ("1 < 2 is the same for every case", "name a column")),
        (
            "probability = 0.4",
            'probability = 0.4\ngiven = "not False"',
            ("requirement[1].given", "not False is"),
        ),
    ],
)
def test_a_wrong_file_is_refused_with_what_where_and_what_to_do(tmp_path, old, new, said):
    assert old in SPEC
    path = spec_file(tmp_path, SPEC.replace(old, new, 1))
    found = shell("campaign", "run", path, "--out", tmp_path / "out")
    assert found.exit_code == 2
    for words in (str(path), *said):
        assert words in found.output
    assert not (tmp_path / "out").exists()


def test_an_unlimited_normal_distribution_that_reaches_the_impossible_asks_for_limits(tmp_path):
    text = SPEC.replace("uniform = [-0.02, 0.02]", "normal = [0.1, 0.1]").replace(
        "arm.errors.J2.phi_rad", "detection.corner_sigma_px"
    )
    with pytest.raises(BadInput, match=r"add limits = \[LOW, HIGH\]"):
        campaign.prepare(spec_file(tmp_path, text))
    limited = text.replace("normal = [0.1, 0.1]", "normal = [0.1, 0.1]\nlimits = [0.01, 0.2]")
    plan = campaign.prepare(spec_file(tmp_path, limited.replace(f"cases = {CASES}", "cases = 500")))
    drawn = [plan.case(i).changes["detection.corner_sigma_px"] for i in range(500)]
    assert 0.01 <= min(drawn) < 0.03
    assert 0.18 < max(drawn) <= 0.2
    assert stats.kstest(drawn, stats.truncnorm(-0.9, 1.0, 0.1, 0.1).cdf).pvalue > 0.001


@pytest.mark.parametrize("sampling", ["random", "latin hypercube", "sobol"])
def test_cases_depend_on_root_and_index_alone_and_cover_the_range(tmp_path, sampling):
    text = SPEC.replace(f"cases = {CASES}", f'cases = 64\nsampling = "{sampling}"')
    one, two = (campaign.prepare(spec_file(tmp_path, text)) for _ in range(2))
    forwards, backwards = list(one.cases(range(64))), list(two.cases(range(63, -1, -1)))
    assert forwards == backwards[::-1]
    assert len({c.seed for c in forwards}) == 64
    assert all(c.changes["calibration.poses"] == 1 for c in forwards)
    x = np.array([c.changes["arm.errors.J2.phi_rad"] for c in forwards])
    assert np.all(np.abs(x) <= 0.02)
    if sampling != "random":  # one in every 64th
        assert sorted(np.floor((x + 0.02) / 0.04 * 64)) == list(range(64))
    other = campaign.prepare(spec_file(tmp_path, text.replace("seed = 7", "seed = 8")))
    assert other.case(0).seed != one.case(0).seed
    assert other.case(0).changes != one.case(0).changes


def test_choices_are_equally_likely_and_joints_independent(tmp_path):
    text = SPEC.replace("uniform = [0.001, 0.004]", "choice = [0.001, 0.002, 0.004]")
    text = text.replace("J2.phi_rad", "J*.phi_rad").replace(f"cases = {CASES}", "cases = 900")
    plan = campaign.prepare(spec_file(tmp_path, text))
    drawn = [c.changes for c in plan.cases(range(900))]
    counts = [sum(d["config.stop_pos_m"] == v for d in drawn) for v in (0.001, 0.002, 0.004)]
    assert stats.chisquare(counts).pvalue > 0.001
    joints = np.array([[d[f"arm.errors.J{j}.phi_rad"] for j in range(1, 8)] for d in drawn])
    off = np.corrcoef(joints.T) - np.eye(7)
    assert np.abs(off).max() < 0.15


# --------------------------------------------------------------------------- conditions


def test_conditions_are_read_and_take_missing_values_as_unknown():
    case = {"active": True, "after_pos_m": 0.001, "before_pos_m": 0.01, "verdict": "change", "p_fit": None}
    case["mission_s"] = float("nan")
    for text, want in {
        "after_pos_m <= 0.001": True, "0 < after_pos_m < 0.5 * before_pos_m": True,
        'not active or verdict == "poor"': False, "p_fit > 0.1": None, "active or p_fit > 0.1": True,
        "not p_fit > 0.1": None, "not mission_s > 1": None, "mission_s != 1": None, "mission_s < 1": None,
        f"after_pos_m + {10**400} > 0": None,
        "not active and p_fit > 0.1": False, "before_pos_m / 0 > 1": None,
    }.items():  # fmt: skip
        assert Condition(text).holds(case) is want
    for text in (
        "after_pos_m", "active < 1", "verdict == 1", "after_pos_m.real > 0", "active +", "1 and active", "",
    ):  # fmt: skip
        with pytest.raises(Contradiction):
            Condition(text)


# --------------------------------------------------------------------------- flying


def test_what_was_dispersed_is_read_back_from_the_world_that_was_built(whole):
    path, folder = whole
    plan = campaign.prepare(path)
    for row in rows(folder):
        asked = plan.case(row["index"])
        assert row["seed"] == asked.seed
        for key in plan.keys:
            assert row["x." + key] == pytest.approx(asked.changes[key], rel=1e-6, abs=1e-12)
        assert row["ended"] == "finished"
        assert row["before_pos_m"] > 0
        assert len(row["digest"]) == 64


def test_every_kind_of_value_is_read_back(tmp_path):
    changes = {
        "arm.errors.J1.d_m": 0.002, "arm.errors.J7.alpha_rad": -0.3, "arm.errors.J3.a_m": 0.004,
        "arm.errors.base.tx_m": 0.01, "arm.errors.base.ry_rad": 0.2, "arm.errors.tool.tz_m": -0.02,
        "arm.errors.tool.rx_rad": 0.1, "arm.errors.tool.rz_rad": -0.2, "arm.encoder_bias_rad.J3": 0.05,
        "arm.encoder_gain.J1": 0.01, "arm.compliance_rad_per_nm.J4": 0.001, "arm.hysteresis_rad.J5": 0.002,
        "arm.encoder_noise_rad": 1e-4, "env.payload_kg": 0.7, "env.temp_c": -40.0,
        "detection.corner_sigma_px": 0.09, "detection.noise": "isotropic", "config.acquisition": "vopt",
        "config.n_poses": 9.0,
    }  # fmt: skip
    base = dispersed.load("healthy", tmp_path)
    scenario = dispersed.changed(base, changes)
    folder = BIN
    with dispersed.tables_with(folder, changes) as used:
        world = dispersed.World(scenario, 1, dispersed.fast_imager)
        found = dispersed.read_back(changes, world, used, folder)
        for key, want in changes.items():
            assert found[key] == (want if isinstance(want, str) else pytest.approx(want, rel=1e-6)), key
        dispersed.check(changes, changes)
        with pytest.raises(ArithmeticError, match=r"env.temp_c = -39.0, asked for was -40.0"):
            dispersed.check(changes, changes | {"env.temp_c": -39.0})


def test_cases_with_other_values_of_config_share_one_evaluator(tmp_path):
    """A campaign of any length keeps as much in memory as one of two cases."""
    base = dispersed.load("healthy", tmp_path)
    base["executive"]["total_timeout_s"] = 1.0
    known = dispersed._evaluators.cache_info
    dispersed.fly(base, BIN, {}, 1)
    before = known().currsize
    flown = [dispersed.fly(base, BIN, {"config.n_poses": n}, 1) for n in (9, 10)]
    assert known().currsize == before
    assert [case.dispersed["config.n_poses"] for case in flown] == [9, 10]


def test_killed_worker_and_killed_command_lose_and_repeat_nothing(whole, tmp_path):
    path, undisturbed = whole
    command = [*KINCAL, "campaign", "run", str(path), "--out", str(tmp_path / "out"), "--batch", "1"]
    process = subprocess.Popen(command, start_new_session=True, stderr=subprocess.DEVNULL)
    killed = wait_for_worker(process.pid)
    os.kill(killed, signal.SIGKILL)
    deadline = time.monotonic() + 300
    while not store.parts(tmp_path / "out") and process.poll() is None and time.monotonic() < deadline:
        time.sleep(0.02)
    process.kill()
    process.wait()
    kept = [(part, part.read_bytes()) for part in store.parts(tmp_path / "out")]
    assert kept
    (tmp_path / "out" / "part-000009.parquet.tmp").write_bytes(b"half")
    (tmp_path / "out" / "mine.tmp").write_text("of somebody else")
    end = run(campaign.prepare(path), tmp_path / "out", batch=2)
    assert end.done == CASES
    assert end.flown <= CASES - len(kept)
    assert all(part.read_bytes() == data for part, data in kept)
    assert [path.name for path in (tmp_path / "out").glob("*.tmp")] == ["mine.tmp"]
    assert rows(tmp_path / "out") == rows(undisturbed)


def wait_for_worker(parent):
    """Process id of the first worker of a command."""
    deadline = time.monotonic() + 300
    while time.monotonic() < deadline:
        for entry in Path("/proc").iterdir():
            try:
                if (
                    entry.name.isdigit()
                    and int((entry / "stat").read_text().rpartition(")")[2].split()[1]) == parent
                ):
                    return int(entry.name)
            except OSError:
                continue
        time.sleep(0.02)
    raise AssertionError("no worker was started")


def test_ctrl_c_keeps_what_is_finished(whole, tmp_path):
    path, undisturbed = whole

    def stop(progress):
        if progress.flown == 1:
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        run(campaign.prepare(path), tmp_path / "out", batch=50, tick=stop)
    assert rows(tmp_path / "out") == rows(undisturbed)[:1]


def test_a_worker_ends_with_its_command_in_the_middle_of_a_case(tmp_path):
    path = function_file(tmp_path, FUNCTION, HANGS)
    command = [*KINCAL, "campaign", "run", str(path), "--out", str(tmp_path / "out"), "--processes", "1"]
    process = subprocess.Popen(command, stderr=subprocess.DEVNULL)
    deadline = time.monotonic() + 300
    while not (tmp_path / "pids").exists() and process.poll() is None and time.monotonic() < deadline:
        time.sleep(0.05)
    pids = (tmp_path / "pids").read_text().split()
    process.kill()
    process.wait()
    assert len(pids) == 2  # the worker, and what its case started
    deadline = time.monotonic() + 20
    while any(running(pid) for pid in pids) and time.monotonic() < deadline:
        time.sleep(0.05)
    left = [pid for pid in pids if running(pid)]
    for pid in left:
        os.kill(int(pid), signal.SIGKILL)
    assert left == []


def running(pid):
    """Whether there is such a process that has not ended."""
    try:
        return Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()[0] != "Z"
    except OSError:
        return False


def answers(plan, n):
    """Cases that died at once: storing them takes no flight."""
    return [pool.Answer(c, {"index": c.index, "error": "x" * 2000}, 0.1) for c in plan.cases(range(n))]


def test_a_full_disk_is_said_and_leaves_nothing_half_written(whole, tmp_path):
    plan = campaign.prepare(whole[0])
    with store.Store(tmp_path / "out", plan) as opened:
        opened.write(answers(plan, 1))
        before = sorted(f.name for f in (tmp_path / "out").iterdir())
        with full_medium(1000), pytest.raises(CommandFailed) as said:
            opened.write(answers(plan, 4)[1:])
        assert "make room" in said.value.todo
        assert said.value.where == str(tmp_path / "out")
        assert sorted(f.name for f in (tmp_path / "out").iterdir()) == before
        assert opened.done == {0}
        opened.write(answers(plan, 4)[1:])
    assert [row["index"] for row in rows(tmp_path / "out")] == [0, 1, 2, 3]


def test_other_cases_and_other_software_are_not_mixed(whole, tmp_path, monkeypatch):
    path, _ = whole
    plan = campaign.prepare(path)
    with store.Store(tmp_path / "out", plan) as opened:
        opened.write(answers(plan, 1))
        with pytest.raises(BadInput, match="another process"), store.Store(tmp_path / "out", plan):
            pass
    other = campaign.prepare(spec_file(tmp_path, SPEC.replace("seed = 7", "seed = 8")))
    with pytest.raises(BadInput, match=r"spec: \w+ there, \w+ here"), store.Store(tmp_path / "out", other):
        pass
    requirement = SPEC.replace("probability = 0.4", "probability = 0.5")
    with store.Store(tmp_path / "out", campaign.prepare(spec_file(tmp_path, requirement))) as opened:
        assert opened.done == {0}  # requirements change no case
    new = installed.software() | {"flight": "00000000"}
    monkeypatch.setattr(installed, "software", lambda: new)
    with (
        pytest.raises(BadInput, match="flight: .* there, 00000000 here"),
        store.Store(tmp_path / "out", plan),
    ):
        pass


# --------------------------------------------------------------------------- cases that die


def worker(tmp_path, body):
    """A package kincal.campaign.worker whose cases do this."""
    code = "import json, os, sys, time\nsys.stdin.readline()\nfor x in sys.stdin:\n    case = json.loads(x)\n"
    code += (
        "".join(f"    {x}\n" for x in body) + "    print(json.dumps({'index': case['index']}), flush=True)\n"
    )
    path = tmp_path / "worker.py"
    path.write_text(code)
    return (sys.executable, str(path))


def test_a_case_that_kills_its_process_or_hangs_is_an_outcome_and_the_others_fly(tmp_path, monkeypatch):
    body = [f"open({str(tmp_path / 'tries')!r}, 'a').write(str(case['index']))",
            "if case['index'] == 1: os.abort()",
            "if case['index'] == 2: time.sleep(60)",
            f"once = {str(tmp_path / 'once')!r}",
            "if case['index'] == 3 and not os.path.exists(once): open(once, 'w'); os._exit(9)"]  # fmt: skip
    monkeypatch.setattr(pool, "COMMAND", worker(tmp_path, body))
    cases = [plan_.Case(i, i, {}) for i in range(6)]
    found = {a.case.index: a.answer for a in pool.Pool(2, {}, 3.0).fly(cases)}
    assert sorted(found) == list(range(6))
    assert found[1]["error"] == "the process that flew it died 2 times, signal 6"
    assert found[2]["error"] == "not finished within the time limit of 3 s"
    assert [i for i in found if "error" in found[i]] in ([1, 2], [2, 1])
    tries = (tmp_path / "tries").read_text()
    assert [tries.count(str(i)) for i in range(6)] == [1, 2, 1, 2, 1, 1]


def test_software_that_changes_meanwhile_ends_the_campaign_and_is_no_outcome(whole):
    plan = campaign.prepare(whole[0])
    shared = plan.for_worker()
    shared["software"] = shared["software"] | {"code": "before"}
    with pytest.raises(CommandFailed, match="the software has changed"):
        list(pool.Pool(1, shared, 300.0).fly(plan.cases([0])))


def test_an_exception_is_an_outcome_with_its_text(whole, tmp_path):
    plan = campaign.prepare(whole[0])
    from kincal.campaign import worker as real

    shared = plan.for_worker() | {"tables": str(tmp_path)}
    found = real.fly(shared, {"index": 3, "seed": 1, "changes": {}})
    assert found["index"] == 3
    assert "tbl" in found["error"]
    row = store.row_of(plan, pool.Answer(plan.case(3), found, 0.1))
    assert (row["ended"], row["reason"], row["after_pos_m"]) == ("died", found["error"], None)
    assert row["x.config.stop_pos_m"] == plan.case(3).changes["config.stop_pos_m"]


# --------------------------------------------------------------------------- functions

FUNCTION = """
function = "flights:case"
cases = 6
seed = 5
sampling = "combinations"
set = { size = 2.0 }
[[dispersion]]
key = "arm"
choice = ["left", "right"]
[[dispersion]]
key = "kind"
choice = [1, 2, 3]
"""
FLIGHTS = """
import os
from numpy import bool_
def case(seed, values):
    if os.path.exists(os.path.join(os.path.dirname(__file__), "kill")) and values["kind"] == 2:
        os._exit(9)
    if values["kind"] == 3:
        return {"length": values["kind"], "good": bool_(values["arm"] == "left"), "word": "far"}
    return {"length": seed * values["size"] + 0.5, "good": values["arm"] == "left"}
nothing = 7
def nested(_seed, _values): return {"a": {"b": 1}}
def no_dict(_seed, _values): return [1]
def its_own(_seed, _values): return {"digest": "x"}
def its_end(_seed, _values): return {"ended": "died"}
def large(_seed, _values): return {"a": 2**63}
def raises(_seed, _values): raise ValueError("out of range")
def raises_bytes(_seed, _values): raise ValueError("no file \\udcff")
def bytes_(_seed, _values): return {"word": "\\udcff"}
def wrong(seed, values): return globals()[values["arm"]](seed, values)
def mixed(seed, values): return {"a": {1: 1, 2: "text", 3: 2.5}[values["kind"]], "good": True}
def large_or_half(seed, values): return {"a": 2**60 + 1 if values["kind"] == 1 else 0.5}
def words(seed, values): return {"good": values["kind"] == 1, "word": "far"}
"""


HANGS = """
import os, subprocess, sys, time
def case(seed, values):
    other = subprocess.Popen([sys.executable, "-c", "import time; time.sleep(600)"])
    new = os.path.join(os.path.dirname(__file__), "new")
    with open(new, "w") as file:
        file.write(f"{os.getpid()} {other.pid}")
    os.rename(new, new.replace("new", "pids"))
    time.sleep(600)
"""


def function_file(tmp_path, text=FUNCTION, flights=FLIGHTS):
    """A campaign of a function, with its module beside it, which has a name of its own in this process."""
    name = f"flights_{tmp_path.name.replace('-', '_')}"
    (tmp_path / f"{name}.py").write_text(flights)
    return spec_file(tmp_path, text.replace("flights:", f"{name}:"))


def flown(tmp_path, text=FUNCTION, **options):
    """The cases of such a campaign in a folder beside it."""
    run(campaign.prepare(function_file(tmp_path, text)), tmp_path / "out", **options)
    return rows(tmp_path / "out")


def test_a_function_flies_all_combinations_with_each_seed(tmp_path):
    found = flown(tmp_path, FUNCTION.replace("cases = 6", "cases = 9"), batch=2)
    given = [(r["seed"], r["x.arm"], r["x.kind"]) for r in found]
    once = [(arm, kind) for arm in ("left", "right") for kind in (1, 2, 3)]
    assert given == [(5, *x) for x in once] + [(6, *x) for x in once[:3]]
    assert [r["length"] for r in found] == [10.5, 10.5, 3.0] * 2 + [12.5, 12.5, 3.0]
    assert [r["good"] for r in found] == [True] * 3 + [False] * 3 + [True] * 3
    assert [r["word"] for r in found] == [None, None, "far"] * 3
    assert {(r["ended"], r["reason"]) for r in found} == {("finished", "")}
    again = campaign.replay(tmp_path / "out", 0)
    assert again.differing == ()
    with pytest.raises(BadInput, match="a function writes no log"):
        campaign.replay(tmp_path / "out", 0, tmp_path / "log")


def test_what_the_cases_of_a_function_show(tmp_path):
    flown(
        tmp_path, FUNCTION + '[[requirement]]\nname = "r"\nholds = \'ended != "died"\'\nprobability = 0.5\n'
    )
    said = good("campaign", "report", tmp_path / "out", "--outcome", "length")
    assert "6 of 6 cases, 0 died" in said.output
    assert "length" in (tmp_path / "out" / "report.html").read_text()
    assert shell("campaign", "report", tmp_path / "out").output == said.output
    said = shell("campaign", "report", tmp_path / "out", "--outcome", "after_pos_m")
    assert said.exit_code == 2
    assert "no number 'after_pos_m'" in said.output
    assert "known: length" in said.output


COLUMNS = """
[columns]
length = "number"
good = "true or false"
word = "text"
[[requirement]]
name = "short or left"
holds = 'length < 5 or good'
given = 'ended == "finished"'
probability = 0.2
"""


def test_requirements_name_the_columns_that_are_declared(tmp_path):
    flown(tmp_path, FUNCTION + COLUMNS, batch=2)
    results = store.read(tmp_path / "out")
    (judged,) = statistics.report(results, "length").requirements
    assert (judged.share.k, judged.share.n, judged.verdict) == (4, 6, "pass")
    other = COLUMNS.replace("length < 5 or good", 'word == "far"')  # these may change later
    run(campaign.prepare(function_file(tmp_path, FUNCTION + other)), tmp_path / "out")
    (judged,) = statistics.report(store.read(tmp_path / "out"), "length").requirements
    assert (judged.share.k, judged.share.n) == (2, 6)
    wrong = function_file(tmp_path, FUNCTION + COLUMNS.replace("word =", "far ="))
    run(campaign.prepare(wrong), tmp_path / "out")
    with pytest.raises(BadInput, match="no case has a value of the column 'far'"):
        statistics.report(store.read(tmp_path / "out"), "length")


@pytest.mark.parametrize(
    ("old", "new", "said"),
    [
        ('good = "true or false"', "", ("requirement[1].holds", "no 'good'", "others are declared")),
        ('good = "true or false"', 'good = "number"', ("requirement[1].holds", "good is not true or false")),
        ('word = "text"', 'word = "words"', ("columns.word", 'write "number" or "text" or "true or false"')),
        ('word = "text"', 'reason = "text"', ("columns", "'reason' is a text in every campaign")),
        ('word = "text"', 'word = "number"', ("word is of type str, not float as declared",)),
    ],
)
def test_columns_that_the_function_does_not_give_are_refused(tmp_path, monkeypatch, old, new, said):
    monkeypatch.setattr(
        fly, "KEEP_S", float("inf")
    )  # cases without a word may be kept where a start takes long
    text = (FUNCTION + COLUMNS).replace(old, new)
    code, output = command(function_file(tmp_path, text), "--out", tmp_path / "out")
    assert code == 2
    for words in said:
        assert words in output
    assert not (tmp_path / "out").exists() or not store.parts(tmp_path / "out")


@pytest.mark.parametrize(
    ("function_", "said"),
    [
        ("no_such_module:case", ("No module named 'no_such_module'", "write MODULE:FUNCTION")),
        ("flights:missing", ("has no attribute 'missing'", "write MODULE:FUNCTION")),
        ("flights:nothing", ("is no function",)),
        ("flights", ("cannot be used",)),
        (":case", ("cannot be used",)),
    ],
)
def test_a_function_that_is_not_there_is_refused(tmp_path, function_, said):
    path = function_file(tmp_path, FUNCTION.replace("flights:case", function_))
    code, text = command(path, "--out", tmp_path / "out")
    assert code == 2
    for words in (f"{path}: function", *said):
        assert words in text
    assert not (tmp_path / "out").exists()


def test_a_module_that_cannot_be_read_is_refused(tmp_path):
    path = function_file(tmp_path, flights="raise SystemExit(3)")
    code, text = command(path, "--out", tmp_path / "out")
    assert code == 2
    assert "SystemExit: 3" in text


def test_a_function_that_gives_no_columns_is_an_outcome(tmp_path):
    said = {
        "nested": "TypeError: a is of type dict; columns hold texts",
        "no_dict": "TypeError: the function gave a list, not a dict",
        "its_own": "TypeError: no column can be called 'digest'",
        "its_end": "TypeError: ended is 'died'; a text is needed, other than 'died'",
        "large": "TypeError: a is too large; columns hold",
        "raises": "ValueError: out of range",
        "raises_bytes": r"ValueError: no file \udcff",
        "bytes_": r"TypeError: 'word' is no Unicode text: '\udcff'",
    }
    text = FUNCTION.replace(":case", ":wrong").replace('["left", "right"]', json.dumps(list(said)))
    found = flown(tmp_path, text.replace("[1, 2, 3]", "[1, 2]").replace("cases = 6", "cases = 16"))
    assert [row["x.arm"] for row in found[::2]] == list(said)
    for row in found:
        assert row["ended"] == "died"
        assert row["reason"].startswith(said[row["x.arm"]])


def test_a_function_that_kills_its_process_is_an_outcome(tmp_path):
    (tmp_path / "kill").write_text("")
    found = flown(tmp_path)
    assert [r["ended"] == "died" for r in found] == [False, True, False] * 2
    assert "died 2 times, exit status 9" in found[1]["reason"]


@pytest.mark.parametrize("batch", [1, 6])
def test_a_case_with_another_type_in_a_column_died_of_it(tmp_path, batch):
    path = function_file(tmp_path, FUNCTION.replace(":case", ":mixed"))
    end = run(campaign.prepare(path), tmp_path / "out", batch=batch)
    assert (end.flown, end.died) == (6, 2)
    found = rows(tmp_path / "out")
    assert [r["a"] for r in found] == [1, None, 2.5] * 2
    assert [r["ended"] == "died" for r in found] == [False, True, False] * 2
    why = "TypeError: a is of type str, in other cases or as declared of type "
    assert {r["reason"].replace("int", "float") for r in found if r["a"] is None} == {why + "float"}
    assert "a is of type str" in good("campaign", "report", tmp_path / "out").output
    assert campaign.replay(tmp_path / "out", 1).flown["reason"].startswith("TypeError: a is of type str")
    assert campaign.replay(tmp_path / "out", 2).differing == ()


def test_a_declared_type_decides_which_cases_died(tmp_path):
    text = FUNCTION.replace(":case", ":mixed") + '[columns]\na = "text"\n'
    path = function_file(tmp_path, text)
    with pytest.raises(BadInput, match="a is of type int, not str as declared"):
        run(campaign.prepare(path), tmp_path / "out", indices=[0])
    assert store.parts(tmp_path / "out") == []
    run(campaign.prepare(path), tmp_path / "out")
    assert [r["a"] for r in rows(tmp_path / "out")] == [None, "text", None] * 2
    other = function_file(tmp_path, text.replace('"text"', '"number"'))
    with pytest.raises(BadInput, match="a is of type str, not float as declared"):
        run(campaign.prepare(other), tmp_path / "out")


@pytest.mark.parametrize("batch", [1, 6])
def test_large_whole_numbers_and_fractions_are_numbers_together(tmp_path, batch):
    found = flown(tmp_path, FUNCTION.replace(":case", ":large_or_half"), batch=batch)
    assert [r["a"] for r in found] == [2.0**60, 0.5, 0.5] * 2


@pytest.mark.parametrize("name", ["raises", "words"])
def test_cases_without_a_number_have_a_report(tmp_path, name):
    text = (
        FUNCTION.replace(":case", f":{name}")
        + """
[columns]
good = "true or false"
[[requirement]]
name = "all is good"
holds = "good"
probability = 0.01
"""
    )
    flown(tmp_path, text)
    said = shell("campaign", "report", tmp_path / "out", tmp_path / "out")
    assert said.exit_code == (1 if name == "raises" else 0)
    for words in ("all is good", "No case gave a number", "differ in: nothing"):
        assert words in said.output
    html = (tmp_path / "out" / "report.html").read_text()
    assert "Distribution of" not in html
    for words in (said.output, html):
        assert ("ValueError: out of range" in words) == (name == "raises")
    said = shell("campaign", "report", tmp_path / "out", "--outcome", "length")
    assert said.exit_code == 2
    assert "no case gave a number; leave it out" in said.output


def test_a_function_that_was_changed_is_not_mixed(tmp_path):
    path = function_file(tmp_path)
    plan = campaign.prepare(path)
    run(plan, tmp_path / "out", indices=[0])
    (tmp_path / f"{plan.spec.function.partition(':')[0]}.py").write_text(FLIGHTS + "# other\n")
    with pytest.raises(BadInput, match=r"function: \w+ there, \w+ here"):
        run(campaign.prepare(path), tmp_path / "out")


# --------------------------------------------------------------------------- replay


def test_parts_of_another_campaign_and_a_changed_manifest_are_refused(tmp_path):
    path = function_file(tmp_path)
    text = path.read_text()
    run(campaign.prepare(path), tmp_path / "a", batch=3)
    other = spec_file(tmp_path, text.replace("size = 2.0", "size = 1.0"))
    run(campaign.prepare(other), tmp_path / "b", batch=3)
    part = "part-000002.parquet"
    kept = (tmp_path / "a" / part).read_bytes()
    shutil.copyfile(tmp_path / "b" / part, tmp_path / "a" / part)
    for command in (["report", tmp_path / "a"], ["run", spec_file(tmp_path, text), "--out", tmp_path / "a"]):
        said = shell("campaign", *command)
        assert said.exit_code == 2
        assert "cases of another campaign" in said.output
        assert part in said.output
    (tmp_path / "a" / part).write_bytes(kept)
    (tmp_path / "a" / "part-copy.parquet").write_bytes(kept)  # no part
    assert len(rows(tmp_path / "a")) == 6
    assert run(campaign.prepare(spec_file(tmp_path, text)), tmp_path / "a").flown == 0
    manifest = tmp_path / "a" / "campaign.json"
    whole_ = manifest.read_text()
    for changed in (whole_.replace('"size": 2.0', '"size": 3.0'), "[]", '{"spec": 1}'):
        manifest.write_text(changed)
        said = shell("campaign", "report", tmp_path / "a")
        assert said.exit_code == 2
        assert str(manifest) in said.output
    manifest.write_text(whole_.replace('"title": ""', '"title": "other words"'))
    assert len(rows(tmp_path / "a")) == 6


def test_modules_of_the_folder_where_it_is_called_are_not_used(tmp_path, monkeypatch):
    path = function_file(tmp_path)
    here = tmp_path / "here"
    here.mkdir()
    (here / "random.py").write_text("raise RuntimeError('mine')")
    monkeypatch.chdir(here)
    assert run(campaign.prepare(path), tmp_path / "out").died == 0


STRANGE = """
def case(seed, values):
    off = float("nan") if values["kind"] == 2 else values["kind"]
    return {"off[/]": off, "ended": "[/x] over"}
"""


def test_not_a_number_is_among_the_worst_and_brackets_are_text(tmp_path):
    run(campaign.prepare(function_file(tmp_path, FUNCTION, STRANGE)), tmp_path / "out")
    said = good("campaign", "report", tmp_path / "out")
    assert "[/x] over" in said.output
    found = campaign.report(campaign.read(tmp_path / "out"))
    assert [bad.index for bad in found.worst] == [1, 4, 2, 5, 0, 3]


def test_two_campaigns_without_a_common_outcome_are_not_compared(whole, tmp_path):
    flown(tmp_path)
    said = shell("campaign", "report", whole[1], tmp_path / "out")
    assert said.exit_code == 2
    assert "after_pos_m" in said.output
    assert "name a number of both" in said.output


def test_replay_gives_the_same_bits_and_says_what_differs(whole, tmp_path, monkeypatch):
    _, folder = whole
    index = int(np.random.default_rng().integers(CASES))
    found = campaign.replay(folder, index, tmp_path / "case.lcmlog")
    assert found.differing == ()
    assert found.flown["digest"] == found.stored["digest"]
    assert (tmp_path / "case.lcmlog").stat().st_size > 1000
    with pytest.raises(BadInput, match="there is no case 99"):
        campaign.replay(folder, 99)
    changed = dispersed.crcs(BIN) | {"kin": "00000000"}
    monkeypatch.setattr(dispersed, "crcs", lambda _folder: changed)
    with pytest.raises(BadInput, match=r"the tables have changed \(kin: \w+ then, 00000000 now"):
        campaign.replay(folder, index)


def test_a_changed_case_is_found_by_replay(whole, tmp_path):
    _, folder = whole
    import pyarrow as pa
    import pyarrow.parquet as pq

    for file in folder.iterdir():
        (tmp_path / file.name).write_bytes(file.read_bytes())
    part = store.parts(tmp_path)[0]
    found = pq.read_table(part).to_pylist()
    found[0]["after_pos_m"] = np.nextafter(found[0]["after_pos_m"], 1.0)
    pq.write_table(pa.Table.from_pylist(found, pq.read_schema(part)), part)
    said = shell("campaign", "replay", tmp_path, found[0]["index"])
    assert said.exit_code == 1
    assert "after_pos_m" in said.output
    assert "the software is the same" in said.output


# --------------------------------------------------------------------------- what it shows


def outcomes(n, met, died=0):
    case = {"ended": "finished", "active": True, "after_pos_m": 0.0005}
    bad, dead = case | {"after_pos_m": 0.002}, {"ended": "died", "active": None, "after_pos_m": None}
    return [case] * met + [bad] * (n - met - died) + [dead] * died


@pytest.mark.parametrize(
    ("n", "met", "died", "verdict"),
    [(59, 59, 0, "pass"), (58, 58, 0, "not shown"), (93, 92, 0, "pass"), (92, 91, 0, "not shown"),
     (93, 92, 1, "pass"), (300, 260, 0, "fail"), (300, 260, 40, "fail"), (0, 0, 0, "not shown")],
)  # fmt: skip
def test_requirements_are_judged_by_one_sided_bounds(n, met, died, verdict):
    asked = Requirement(name="r", holds="after_pos_m <= 0.001", given="active", probability=0.95)
    found = statistics.evaluate(asked, outcomes(n, met, died) + [{"ended": "stopped", "active": False}])
    assert (found.share.k, found.share.n, found.died) == (met, n, died)
    assert found.verdict == verdict
    assert found.needed == 59  # the textbook's number for 95 % with 95 % confidence
    if 0 < met < n:  # at the bound exactly so many cases would come by chance in one of twenty
        assert stats.binom.sf(met - 1, n, found.low) == pytest.approx(0.05)
        assert stats.binom.cdf(met, n, found.high) == pytest.approx(0.05)


def test_quantiles_have_the_coverage_that_they_state():
    rng, inside = np.random.default_rng(4), np.zeros((400, 4))
    for k in range(400):
        found = statistics.distribution("after_pos_m", [*rng.exponential(size=150), None])
        truth = stats.expon.ppf([q.p for q in found.quantiles])
        inside[k] = [q.low <= t <= q.high for q, t in zip(found.quantiles, truth, strict=True)]
    assert found.missing == 1
    assert np.all(inside.mean(axis=0) > 0.92)
    low, high = found.bounds()
    assert np.all((low < np.arange(1, 151) / 150) & (np.arange(1, 151) / 150 <= high))


def made(tmp_path, n=300, seed=3, effect=1.0):
    """A campaign whose outcome follows the size of one value, without a flight."""
    text = SPEC.replace(f"cases = {CASES}", f"cases = {n}").replace("seed = 7", f"seed = {seed}")
    plan = campaign.prepare(spec_file(tmp_path, text))
    rng, found = np.random.default_rng(seed), []
    for case in plan.cases(range(n)):
        error = effect * abs(case.changes["arm.errors.J2.phi_rad"]) + 1e-3 * rng.random()
        outcome = dict.fromkeys(store.OUTCOME) | {
            "ended": "finished", "verdict": "change", "reason": f"off by {error:.6f}", "active": True,
            "after_pos_m": error, "before_pos_m": 0.1, "success": True, "contacts_s": 0.0}  # fmt: skip
        flown = {
            "index": case.index, "dispersed": case.changes, "outcome": outcome, "digest": "d", "cpu_s": 1.0,
        }  # fmt: skip
        found.append(pool.Answer(case, flown, 1.0))
    with store.Store(tmp_path / f"out{seed}", plan) as opened:
        opened.write(found)
    return campaign.read(tmp_path / f"out{seed}")


def test_influences_and_worst_cases_are_found(tmp_path):
    found = campaign.report(made(tmp_path), sobol=True)
    first, second = found.influences
    assert (first.key, second.key) == ("arm.errors.J2.phi_rad", "config.stop_pos_m")
    assert first.size > 0.9
    assert abs(first.rank) < 0.2
    assert first.p < 1e-6
    assert second.p > 0.01
    assert first.sobol[0] > 0.8 > 0.2 > second.sobol[0]
    ((end, share),) = found.ends  # alike but for their numbers
    first = found.results.columns["reason"][0]
    assert share.k == 300 and end.endswith(first) and re.search(r"off by \d", end)
    values = found.results.columns["after_pos_m"]
    assert [bad.index for bad in found.worst] == list(np.argsort(values)[::-1][:20])
    assert found.worst[0].command.endswith(f"out3 {found.worst[0].index}")
    with pytest.raises(BadInput, match="no number 'ended'"):
        campaign.report(found.results, "ended")


def test_a_choice_of_two_has_no_correlation_with_its_size(tmp_path):
    text = FUNCTION.replace('["left", "right"]', "[0.0, 1.0]").replace("cases = 6", "cases = 24")
    flights = "def case(seed, values): return {'length': values['arm'] + 0.01 * seed}"
    run(campaign.prepare(function_file(tmp_path, text, flights)), tmp_path / "out")
    with warnings.catch_warnings(action="error"):
        first, second = campaign.report(campaign.read(tmp_path / "out")).influences
    assert (first.key, first.size, second.key) == ("arm", None, "kind")
    assert first.rank == pytest.approx(
        stats.spearmanr([0] * 12 + [1] * 12, [*range(4)] * 3 + [*range(4, 8)] * 3).statistic
    )
    assert second.size == pytest.approx(0.0, abs=0.2)
    assert first.p == pytest.approx(
        3 * stats.spearmanr([0] * 12 + [1] * 12, [*range(4)] * 3 + [*range(4, 8)] * 3).pvalue
    )
    assert "nan" not in good("campaign", "report", tmp_path / "out").output


def test_two_campaigns_are_compared(tmp_path):
    one, alike, worse = made(tmp_path), made(tmp_path, seed=5), made(tmp_path, seed=6, effect=2.0)
    same, other = (campaign.compare(campaign.report(one), campaign.report(x)) for x in (alike, worse))
    assert same.p_outcome > 0.001 > other.p_outcome
    assert same.different == ("spec seed",) or "spec seed" in same.different
    assert [c.p for c in same.requirements] == [1.0]


def test_the_report_is_text_and_page(whole, tmp_path):
    _, folder = whole
    page = tmp_path / "r.html"
    said = good("campaign", "report", folder, folder, "--report", page)
    for words in (f"{CASES} of {CASES} cases, 0 died", "comes to an end", "Compared", "differ in: nothing"):
        assert words in said.output
    html = page.read_text()
    for words in ("Requirements", "Worst cases", "Clopper", "comes to an end", "Compared",
                  f"kincal campaign replay {folder} 0"):  # fmt: skip
        assert words in html
    assert "<script src" not in html


def test_an_unfinished_campaign_passes_nothing(whole, tmp_path):
    plan = campaign.prepare(whole[0])
    with store.Store(tmp_path / "out", plan) as opened:
        opened.write(answers(plan, 2))
    found = campaign.report(campaign.read(tmp_path / "out"))
    assert not found.complete
    assert not found.ok
    assert found.died == 2
    assert [r.share.k for r in found.requirements] == [0]


# --------------------------------------------------------------------------- cluster


@pytest.fixture(scope="module")
def scheduler():
    """Address of a scheduler with a worker, all as processes."""
    from distributed import LocalCluster

    with LocalCluster(n_workers=1, threads_per_worker=1, dashboard_address=":0") as made_cluster:
        yield made_cluster.scheduler_address


def test_a_scheduler_gives_the_same(whole, tmp_path, scheduler):
    path, undisturbed = whole
    end = run(campaign.prepare(path), tmp_path / "out", scheduler=scheduler, batch=10)
    assert end.flown == CASES
    assert rows(tmp_path / "out") == rows(undisturbed)


def test_a_function_goes_on_with_more_cases_and_flies_those_that_are_asked_for(tmp_path, scheduler):
    path = function_file(tmp_path)
    text = path.read_text()
    end = run(campaign.prepare(path), tmp_path / "out", indices=[1, 4])
    assert (end.done, end.of, end.flown) == (2, 2, 2)
    kept = store.parts(tmp_path / "out")[0].read_bytes()
    end = run(campaign.prepare(path), tmp_path / "out", scheduler=scheduler, batch=10)
    assert (end.done, end.of, end.flown) == (6, 6, 4)
    assert store.parts(tmp_path / "out")[0].read_bytes() == kept
    more = text.replace("cases = 6", "cases = 8")
    end = run(campaign.prepare(spec_file(tmp_path, more)), tmp_path / "out")
    assert (end.done, end.flown) == (8, 2)
    found = rows(tmp_path / "out")
    assert [r["index"] for r in found] == list(range(8))
    fewer = text.replace("cases = 6", "cases = 3")
    run(campaign.prepare(spec_file(tmp_path, fewer)), tmp_path / "out")
    assert rows(tmp_path / "out") == found[:3]


def test_other_software_on_a_worker_is_refused(whole, tmp_path, scheduler, monkeypatch):
    plan = campaign.prepare(whole[0])
    here = installed.software() | {"flight": "00000000"}
    monkeypatch.setattr(installed, "software", lambda: here)
    with pytest.raises(BadInput, match="flight: .* there, 00000000 here"):
        run(plan, tmp_path / "out", scheduler=scheduler, batch=10)
    assert store.parts(tmp_path / "out") == []
    monkeypatch.undo()
    expected = {"software": here, "tables": []}
    assert cluster.fly_task(plan.for_worker(), [plan.case(0)], 60.0, [], expected)["software"] != here


def test_no_scheduler_and_a_scheduler_that_goes_away_are_said(whole, tmp_path, monkeypatch):
    from distributed import LocalCluster

    plan = campaign.prepare(whole[0])
    monkeypatch.setattr(cluster, "CONNECT_S", 1.0)
    with pytest.raises(BadInput, match="no scheduler answers"):
        run(plan, tmp_path / "out", scheduler="tcp://127.0.0.1:9", batch=10)
    with pytest.raises(BadInput, match="5 cases a task"):
        run(plan, tmp_path / "out", scheduler="tcp://127.0.0.1:9", batch=5)
    monkeypatch.setattr(cluster, "GONE_S", 1.0)
    monkeypatch.setattr(cluster, "fly_task", never)
    made_cluster = LocalCluster(n_workers=1, threads_per_worker=1, dashboard_address=":0")
    real = cluster._checked_workers

    def then_gone(*given):
        threads = real(*given)
        made_cluster.close()
        return threads

    monkeypatch.setattr(cluster, "_checked_workers", then_gone)
    with pytest.raises(CommandFailed, match="the scheduler has gone away") as said:
        run(plan, tmp_path / "out", scheduler=made_cluster.scheduler_address, batch=10)
    assert "goes on" in said.value.todo
    assert store.parts(tmp_path / "out") == []


def test_a_task_that_was_lost_with_its_scheduler_is_no_traceback():
    from distributed.client import FutureCancelledError

    class Lost:
        def result(self):
            raise FutureCancelledError("fly_task-1", "scheduler-connection-lost")

    with pytest.raises(CommandFailed, match="the scheduler has gone away"):
        cluster._answers(Lost(), {}, "tcp://127.0.0.1:9")


def command(*arguments):
    """What the command says, in its own words."""
    found = shell("campaign", "run", *arguments)
    return found.exit_code, found.output


def test_the_command_says_what_to_do_about_a_scheduler_and_writes_no_case(whole, tmp_path, monkeypatch):
    monkeypatch.setattr(cluster, "CONNECT_S", 1.0)
    gone = ("--scheduler", "tcp://127.0.0.1:9", "--batch", 10)
    code, text = command(whole[0], "--out", tmp_path / "out", *gone)
    assert code == 2
    for words in ("no scheduler answers", "tcp://127.0.0.1:9", "dask scheduler", "dask worker"):
        assert words in text
    assert store.parts(tmp_path / "out") == []
    assert not list((tmp_path / "out").glob("*.tmp"))
    code, text = command(whole[0], "--out", tmp_path / "out", *gone[:3], 60)
    assert code == 2
    assert "60 cases a task" in text
    assert "10 to 50" in text


def test_the_command_names_a_worker_of_another_version(whole, tmp_path, scheduler, monkeypatch):
    here = installed.software() | {"kincal": "0.0.1"}
    monkeypatch.setattr(installed, "software", lambda: here)
    code, text = command(whole[0], "--out", tmp_path / "out", "--scheduler", scheduler, "--batch", 10)
    assert code == 2
    for words in ("kincal: ", "there, 0.0.1 here", "tcp://", "install the same there"):
        assert words in text
    assert store.parts(tmp_path / "out") == []


def never(*_given):
    """A task without an end."""
    time.sleep(600)


def test_the_example_is_a_campaign_that_can_fly():
    plan = campaign.prepare(ROOT / "sim" / "campaigns" / "errors.toml")
    assert len(plan.keys) == 30
    assert json.dumps(plan.contents())
