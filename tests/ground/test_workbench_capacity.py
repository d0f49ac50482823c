"""What to leave out of a model that is too large for flight: order, cost, and the way there by commands."""

import json
import re
import shlex

import numpy as np
import poses
import pytest
from commands import good, kincal

from kincal import tables
from kincal import workbench as wb
from kincal.workbench.model.capacity import order_of_removal, size
from kincal.workbench.model.effects import Hypothesis, Parameter, Term
from kincal.workbench.model.modelfile import ModelFile
from kincal_shared.schema.model import FitEntry

MANY = ("encoder_harmonic2", "encoder_eccentricity", "bearing_wobble", "backlash[4]")


def effect(name, count):
    row = tuple(Parameter(f"c{k}", "1", 1.0, (Term(1, 0, 1.0, ()),)) for k in range(count))
    return Hypothesis(name, name, row)


def test_rise_of_chi2_is_that_of_linear_fits_without_the_effects():
    """Columns in a random order and of very different units, correlated with one another."""
    rng = np.random.default_rng(4)
    effects = [effect("a", 1), effect("b", 3), effect("c", 2), effect("d", 2)]
    names = [f"{h.name}.{p.name}" for h in effects for p in h.parameters] + ["J1.phi_rad", "J1.a_m"]
    rng.shuffle(names)
    columns = rng.normal(size=(60, 10)) @ (np.eye(10) + 0.5 * rng.normal(size=(10, 10)))
    columns *= 10.0 ** rng.uniform(-4, 4, 10)
    y = columns @ (rng.normal(size=10) * 3 / np.linalg.norm(columns, axis=0)) + rng.normal(size=60)

    def chi2(out):
        kept = columns[:, [name.split(".")[0] not in out for name in names]]
        return float(np.sum((y - kept @ np.linalg.lstsq(kept, y, rcond=None)[0]) ** 2))

    cov = np.linalg.inv(columns.T @ columns)
    value = cov @ columns.T @ y
    frame = {"xyz_m": (0, 0, 0), "quat_wxyz": (1, 0, 0, 0)}
    lower = [list(row[: i + 1]) for i, row in enumerate(cov)]
    fit = FitEntry(when="", tool_version="", arm_sha256="", poses=60, components=6, noise_scale=1.0,
                   base=frame, tool=frame, covariance=lower)  # fmt: skip
    std_err = np.sqrt(np.diag(cov))
    model = ModelFile(values=dict(zip(names, zip(value, std_err, strict=True), strict=True)), fit=fit)
    order = order_of_removal(effects, model)
    gone = []
    for leaves in order:
        rises = {
            h.name: (chi2([*gone, h.name]) - chi2(gone)) / size([h])[0] for h in effects if h.name not in gone
        }
        assert leaves.name == min(rises, key=rises.get)
        assert leaves.each == pytest.approx(rises[leaves.name], rel=1e-6)
        gone.append(leaves.name)
    assert sorted(gone) == ["a", "b", "c", "d"]


def test_without_a_fit_of_these_effects_there_is_no_order():
    assert order_of_removal([effect("a", 1)], ModelFile()) == []


@pytest.fixture(scope="module")
def large(tmp_path_factory):
    """A model with more coefficients than flight carries, fitted to an arm with backlash in joint 4."""
    out = tmp_path_factory.mktemp("large")
    arm = poses.arm_toml(out / "arm.toml")
    data = poses.poses_csv(out / "d.csv", 100, 7, lambda q, d: q + np.array([0, 0, 0, 3e-3 * d[3], 0, 0, 0]))
    model = out / "M.toml"
    good("model", "add", "--model", model, *MANY)
    refused = kincal("uplink", "--model", model, "--arm", arm)
    assert "`kincal model fit` first" in refused.output
    good("model", "fit", "--arm", arm, "--data", data, "--model", model)
    return model, data


def test_a_model_too_large_for_flight_is_refused_with_what_to_leave_out(large):
    model, data = large
    refused = kincal("uplink", "--model", model)
    assert refused.exit_code == 2
    assert "flight carries 64" in refused.output
    listed = [line for line in refused.output.splitlines() if line.startswith("    ")][1:]
    assert listed[-1].split()[0] == "backlash[4]"  # the true one is the last to go
    drop = re.search(r"add to the command: (.*)", refused.output)[1].replace("'", "").split()
    out = model.with_name("small.tbl")
    done = good("model", "uplink", "--model", model, "-o", out, "--data", data, *drop)
    assert "held-out error without them" in done.output
    struct = tables.load(out)[1]
    assert 62 <= struct.n_coef <= 64
    assert len(wb.read_model(model).effects) == len(MANY)
    assert drop[1] in done.output


def test_what_has_no_room_in_the_search_space_is_advised_with_what_is_too_much(large, tmp_path):
    """One advice: dropping what it names leads to no second refusal."""
    model, text = tmp_path / "M.toml", large[0].read_text()
    values = wb.read_model(large[0]).values
    name = next(n for n in values if n.startswith("bearing_wobble"))
    entry = f"name = {json.dumps(name)}\nvalue = "
    model.write_text(text.replace(f"{entry}{values[name][0]!r}", f"{entry}0.5"))
    assert wb.read_model(model).values[name][0] == 0.5
    refused = kincal("uplink", "--model", model)
    assert refused.exit_code == 2 and "flight carries 64" in refused.output
    drop = shlex.split(re.search(r"add to the command: (.*)", refused.output)[1])
    assert "bearing_wobble" in " ".join(drop)
    good("model", "uplink", "--model", model, "-o", tmp_path / "small.tbl", *drop)
    small = [word for word in drop if "bearing_wobble" not in word and word != "--drop"]
    again = kincal("uplink", "--model", model, *(w for n in small for w in ("--drop", n)))
    assert again.exit_code == 2, "what has no room stays a reason of its own"


def test_an_effect_that_is_not_there_cannot_be_dropped(large):
    done = kincal("uplink", "--model", large[0], "--drop", "base_flex")
    assert done.exit_code == 2
    assert "base_flex is not in the model" in done.output
