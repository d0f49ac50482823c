"""`kincal model predict`: what the fitted values of a model file say of other measurements."""

import json

import numpy as np
import pytest
from commands import good as ends_well
from places import DATA

from kincal import workbench as wb
from kincal.workbench.prediction.gain import unpaired_ratio


def good(*words):
    return ends_well("model", *words)


def answer(*words):
    return json.loads(good(*words, "--json").stdout)


def test_prediction_says_errors_without_outliers_and_whether_new_poses_are_as_good(tmp_path, monkeypatch):
    """Two of 33 poses made 1.33 mm of 0.38 mm, beside 0.40 mm "when it was fitted", without a word."""
    monkeypatch.chdir(tmp_path)
    arm, data = DATA / "wam" / "wam.toml", DATA / "wam" / "wam.csv"
    header, *rows = data.read_text().splitlines()
    (tmp_path / "fit.csv").write_text("\n".join([header, *rows[::3]]) + "\n")
    column = header.split(",").index("px")
    new = [row.split(",") for row in rows[1::3]]
    for k, off in ((3, 0.2), (9, -0.3)):
        new[k][column] = repr(float(new[k][column]) + off)
    (tmp_path / "new.csv").write_text("\n".join([header, *map(",".join, new)]) + "\n")
    good("fit", "--arm", arm, "--data", "fit.csv", "--model", "M.toml")
    said = answer("predict", "--arm", arm, "--model", "M.toml", "--data", "new.csv")
    read = wb.read_csv("new.csv", 7)
    assert said["outliers"] == [read.ids[3], read.ids[9]]
    assert said["without_outliers"]["pos_mm"] < 0.2 * said["errors"][1]["pos_mm"]
    low, high = said["ratio_interval"]
    assert low < said["ratio"] < high
    assert said["ratio"] == pytest.approx(said["without_outliers"]["pos_mm"] / said["held"]["pos_mm"])
    text = good("predict", "--arm", arm, "--model", "M.toml", "--data", "new.csv").output
    assert f"(2 outliers: {read.ids[3]}, {read.ids[9]})" in text
    how = "worse than" if low > 1.0 else "better than" if high < 1.0 else "as well as"
    assert f"predicted {how} the held-out ones of the fit, outliers excluded: ratio" in text
    own = answer("predict", "--arm", arm, "--model", "M.toml", "--data", "fit.csv")
    assert own["ratio"] is None


def test_an_interval_beside_a_known_error_covers_poses_of_one_kind():
    """20 poses of one kind each time, their squares chi-squared: 1 is in about 95 % of the intervals."""
    rng = np.random.default_rng(8)
    inside = 0
    for _ in range(200):
        new, held = rng.chisquare(3, 40), rng.chisquare(3, 20)
        _, (low, high) = unpaired_ratio(new, float(np.sqrt(held.mean())), 20)
        inside += low < 1.0 < high
    assert 175 <= inside <= 199
    assert unpaired_ratio(9.0 * new, float(np.sqrt(held.mean())), 20)[1][0] > 1.0
