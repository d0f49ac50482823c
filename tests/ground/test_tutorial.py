"""The whole circle: docs/TUTORIAL.md is run as it stands."""

import json
import re

import gen_tutorial
import pytest
from environments import as_function

from kincal import tables
from kincal import workbench as wb
from kincal.run import Evaluator, GroundTruth

pytestmark = pytest.mark.slow


# Without the reports: test_wheel.py has their pictures drawn.
INSTEAD = {"make setup-demo build": "true"} | {
    line: re.sub(r" --report \S+", "", line)
    for line in gen_tutorial.DOCUMENT.read_text("utf-8").splitlines()
    if line.startswith("kincal model diagnose") and "--report" in line
}


@pytest.fixture(scope="module")
def tutorial(full, door, clone, tmp_path_factory):
    """Every command of the page, block by block in a fresh clone, and what it printed. The clone is built."""
    text = gen_tutorial.DOCUMENT.read_text("utf-8")
    assert len(INSTEAD) == 3
    shell = gen_tutorial.Shell(clone, tmp_path_factory.mktemp("shell"), INSTEAD, **as_function(full, door))
    return clone / gen_tutorial.OUT, text, gen_tutorial.perform(text, shell)


def output(tutorial, command):
    """What the block of the page with this command printed."""
    (said,) = (step.output for step in tutorial[2] if command in step.commands)
    return said


def test_what_moves_the_real_arm_is_named_and_the_commands_of_its_diagnosis_give_what_it_promises(tutorial):
    """Predicted better than by independent fits."""
    said, fits = (
        output(tutorial, "diagnose --arm docs/data/wam/"),
        output(tutorial, "bash -e out/tutorial/wam.sh"),
    )
    promised = re.findall(r"^  (?:nominal arm|after DH calibration|\+ \S+) +([\d.]+) mm", said, re.M)
    dh, whole = (re.findall(r" held-out poses +([\d.]+) ", fit) for fit in fits.split("\nmodel ")[1:])
    assert (dh, whole[: len(promised)]) == (promised[:2], promised)
    assert float(promised[-1]) <= 1.60
    assert re.search(r"^\* backlash.*: helps", said, re.M)
    assert not re.search(r"^[*+] .*harms", said, re.M)


def test_tutorial_ends_below_1_3_times_the_noise_floor_where_dh_alone_stops_far_above(tutorial):
    n = gen_tutorial.numbers(tutorial[2])
    assert n["alone"] >= 3.0 * n["floor"]
    assert n["flown"] <= 1.3 * n["floor"]
    assert n["before"] >= 2.0 * n["floor"]
    assert n["after"] <= 1.3 * n["floor"]


def test_ground_says_that_dh_does_not_explain_the_log_and_names_both_effects(tutorial):
    said = output(tutorial, "diagnose --arm wam --data out/tutorial/dh/run.lcmlog")
    assert "diagnosis: Consistent with" in said
    listed = dict(re.findall(r"^\* (\S+): .*: helps; P (?:> )?(0\.\d+) against", said, re.M))
    assert set(listed) == {"joint_compliance[4]", "backlash[1]"}
    assert min(map(float, listed.values())) > 0.9
    assert re.search(r"^\* joint_compliance\[4\](.*\n +)+confounded with: .*pd_droop\[4\]", said, re.M)
    values = wb.read_model(tutorial[0] / "M.toml").values
    for name in ("joint_compliance[4].c", "backlash[1].h"):
        value, std_err = values[name]
        assert value == pytest.approx(0.003, abs=4 * std_err)


def test_flight_estimates_the_uplinked_terms_itself(tutorial):
    folder = tutorial[0]
    launch = json.loads((folder / "again" / "launch.json").read_text())
    assert launch["success"] and launch["verdict"] == "change"
    terms = tables.load(folder / "tables" / "terms.tbl")[1]
    assert terms.n_coef == 30


def test_a_heading_with_nothing_shown_below_it_is_not_printed():
    output = "where the rest is:\n  gravity torque of joint 4 at link 2\nworst poses: 3\n"
    assert "torque" in gen_tutorial.shown(output, "^where|torque")
    with pytest.raises(SystemExit, match="where the rest is"):
        gen_tutorial.shown(output, "^where|tau4|^worst")


def test_page_prints_what_its_commands_print(tutorial):
    """Same lines, same words; numbers are those of the run that wrote the page. Of the real arm only that
    each command shows something: which of its many small effects are named may depend on the processor."""
    _, text, steps = tutorial
    pages = [page.split("## The simulated arm") for page in (text, gen_tutorial.written(text, steps))]
    assert "```text\n```" not in pages[1][0]
    shape = [re.sub(r"\b[0-9a-f]{8}\b|[-+]?[\d.]+(e[-+]?\d+)?|\s+|…", "#", simulated)
             for _, simulated in pages]  # fmt: skip
    shape = [re.sub("#+", "#", t) for t in shape]
    assert shape[0] == shape[1], "run `python ground/gen_tutorial.py`"
    for name in gen_tutorial.PICTURES.values():
        assert (gen_tutorial.IMAGES / f"{name}.png").read_bytes().startswith(b"\x89PNG")


def test_effect_of_nobodys_library_is_mapped_written_in_ten_lines_and_flown(tutorial):
    folder = tutorial[0]
    said = output(tutorial, "diagnose --arm wam --data out/tutorial/odd/run.lcmlog")
    assert "diagnosis: Something is missing that no effect in the library describes" in said
    (drivers,) = re.findall(r"^not in the library: the error of joint 3 depends on (.+) \(P", said, re.M)
    # tanh(q4) hardly changes over the poses of flight; test_workbench_engine.py has poses that show both
    assert {"q6"} <= set(drivers.split(" and ")) <= {"q4", "q6"}
    assert len((folder / "odd.toml").read_text().splitlines()) <= 10
    value, std_err = wb.read_model(folder / "odd_model.toml").values["odd_coupling.k"]
    assert value == pytest.approx(0.012, abs=4 * std_err)
    floor = 1e-3 * float(re.search(r"^noise floor +([\d.]+) mm", said, re.M)[1])
    assert held_out(folder / "odd_again", folder / "odd_tables") <= 1.3 * floor


def held_out(out, tables_dir):
    """Position error of the correction in force over the poses that the simulator kept."""
    from kincal import link

    truth = GroundTruth.of(json.loads((out / "truth.json").read_text()))
    evaluator = Evaluator(tables_dir, truth)
    session = max(link.read_log(out / "run.lcmlog").sessions.items())[1]
    return evaluator.held_out(list(session.proposal.value)[: len(evaluator.names)]).pos_m
