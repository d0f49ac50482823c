"""The bench of claims: which poses judge, what counts as harm, and that it goes on where it was stopped."""

import argparse
import json
from pathlib import Path

import claims
import numpy as np
import pytest


@pytest.fixture
def made_up(monkeypatch):
    """Answers that say what was asked, instead of diagnoses; gives the list of them."""
    asked = []

    def answer(_case, one):
        asked.append(one.key)
        return {"asked": one.key, "seconds": 1.0, "verdict": "adequate", "claims": [row(0.95, 0.9)]}

    monkeypatch.setattr(claims, "answer", answer)
    return asked


def row(probability, ratio):
    return {"name": "gain", "role": "accepted", "probability": probability, "ratio": ratio}


def options(path, quarters=2):
    return argparse.Namespace(out=path, quarters=quarters, sizes=[18], seed=1)


CASES = [claims.Case("x", Path("x.csv"), Path("x.toml"))]


def test_no_pose_counts_that_was_diagnosed():
    for size in (None, 18, 100):
        part, away = claims.parts(200, claims.Asked("x", 3, size, 1))
        assert not set(part) & set(away)
        assert len(part) == (size or 150)
        assert len(away) == (50 if size is None else 200 - size)
    quarters = [claims.parts(200, claims.Asked("x", quarter, None, 1))[1] for quarter in range(20)]
    assert len({tuple(q) for q in quarters}) == 20
    assert claims.parts(100, claims.Asked("x", 0, 75, 1)) is None
    assert len(claims.parts(5000, claims.Asked("x", 0, 40, 1))[1]) == claims.MOST_AWAY


def test_a_second_start_goes_on_and_other_sources_begin_anew(made_up, tmp_path, monkeypatch):
    path = tmp_path / "claims.jsonl"
    assert len(claims.run(CASES, options(path, 1))) == 2
    rows = claims.run(CASES, options(path))
    assert len(rows) == len(made_up) == 4
    assert len({json.dumps(key) for key in made_up}) == 4
    monkeypatch.setattr(claims, "fingerprint", lambda: "other")
    claims.run(CASES, options(path))
    assert len(made_up) == 8


def test_sure_claims_that_harm_fail_beyond_one_in_twenty():
    def rows(harmful, sure):
        some = [row(0.9, 1.03)] * harmful + [row(0.95, 1.01)] * (sure - harmful) + [row(0.89, 3.0)] * 50
        return [{"asked": ["x", 0, None, 1], "verdict": "", "seconds": 1.0, "claims": some}]

    assert claims.failures(rows(1, 20)) == []
    [failed] = claims.failures(rows(2, 20))
    assert failed.startswith("2 of 20 claims with P >= 0.9 harm")
    [failed] = claims.failures([{"asked": ["x", 0, None, 1], "error": "LinAlgError: SVD did not converge"}])
    assert "SVD" in failed
    [heading, low, high, by_size] = claims.table(rows(2, 20))
    assert [float(x) for x in high.split()[-4:]] == pytest.approx([0.94, 0.0, 0.1, 20], abs=0.006)
    assert by_size.startswith("P >= 0.9, all poses")


def test_a_diagnosis_of_few_real_poses_is_judged_by_the_others():
    case = next(c for c in claims.find_sets(claims.DATA) if c.name == "fr3")
    found = claims.answer(case, claims.Asked("fr3", 0, 18, 1))
    assert found["poses"] == 18
    assert found["claims"]
    assert all(
        np.isfinite([c["ratio"], c["rotation_ratio"], c["probability"]]).all() for c in found["claims"]
    )
    assert "fr3" in claims.line(found)
