"""Posterior and selection as functions: made-up evidence in, the chosen effects out."""

from dataclasses import dataclass, replace

import numpy as np
import poses
import pytest

from kincal import workbench as wb
from kincal.workbench.diagnosis.posterior import NONE, UNNAMED, Posterior
from kincal.workbench.diagnosis.selection import State, backward, extended, forward, settle
from kincal.workbench.diagnosis.study import Study
from kincal.workbench.evidence.bayes_factors import Score
from kincal.workbench.evidence.scoring import Scored
from kincal.workbench.model.effects import Hypothesis, Parameter
from kincal.workbench.model.hypotheses import Candidate, Competition

BARE = Score(np.zeros(1), np.ones(1), 0.0, 0.0, 1)


def effect(name, parameters=1):
    made = tuple(Parameter(f"k{i}", "rad", 1e-3, ()) for i in range(parameters))
    return Hypothesis(name.partition("[")[0], name, made)


def scored(name, ln_bf, parameters=1):
    return Scored(name, ln_bf, BARE, effect(name, parameters), lambda: np.zeros((1, 1)), None, np.zeros(1))


def posterior(probability, ln_bf=None, parameters=None):
    named = [name for name in probability if name not in (NONE, UNNAMED)]
    rows = [scored(n, (ln_bf or {}).get(n, 0.0), (parameters or {}).get(n, 1)) for n in named]
    return Posterior(None, tuple(rows), (), (), probability)


# --------------------------------------------------------------------------- posterior


def test_presence_counts_an_effect_alone_and_with_all_joints():
    p = posterior({NONE: 0.1, "gain": 0.2, "gain[1]": 0.3, "gain[2]": 0.3, "flex": 0.1})
    assert p.presence("gain[1]") == pytest.approx(0.5)
    assert p.presence("gain") == pytest.approx(0.8)
    assert p.presence("flex") == pytest.approx(0.1)


def test_one_joint_is_preferred_unless_all_explain_far_more():
    probability = {NONE: 0.0, "gain": 0.6, "gain[2]": 0.4}
    assert posterior(probability, {"gain": 20.0, "gain[2]": 19.0}).best(room=10).name == "gain[2]"
    assert posterior(probability, {"gain": 25.0, "gain[2]": 19.0}).best(room=10).name == "gain"


def test_an_effect_that_needs_more_coefficients_than_there_are_is_passed_over():
    p = posterior({NONE: 0.0, "gain": 0.9, "flex": 0.1}, parameters={"gain": 7})
    assert p.best(room=6).name == "flex"
    assert p.best(room=0) is None


def test_a_closer_search_keeps_the_weights_of_the_grid():
    def at(*values):
        return tuple(replace(effect("step"), constants=(("t0", v),)) for v in values)

    def shares(candidate):
        return {h.constants[0][1]: w for h, w in zip(candidate.variants, candidate._shares, strict=True)}

    equal = Candidate("step", None, at(1.0, 2.0, 3.0, 4.0), 0.1).refined(at(1.5, 2.0, 2.5))
    assert shares(equal) == pytest.approx(
        {1.0: 1 / 4, 3.0: 1 / 4, 4.0: 1 / 4, 1.5: 1 / 12, 2.0: 1 / 12, 2.5: 1 / 12}
    )
    half = Candidate("step", None, at(1.0, 2.0, 3.0, 4.0), 0.1, (1.0, 3.0, 1.0, 1.0)).refined(
        at(1.5, 2.0, 2.5, 3.0)
    )
    assert shares(half) == pytest.approx(
        {1.0: 1 / 6, 4.0: 1 / 6, 2.0: 1 / 2, 1.5: 1 / 18, 2.5: 1 / 18, 3.0: 1 / 18}
    )


def test_the_unnamed_wins_only_over_nothing_and_every_name():
    assert posterior({NONE: 0.01, UNNAMED: 0.6, "gain[1]": 0.39}).unnamed_wins
    assert not posterior({NONE: 0.01, UNNAMED: 0.4, "gain[1]": 0.59}).unnamed_wins
    assert not posterior({NONE: 0.2, UNNAMED: 0.6, "gain[1]": 0.2}).unnamed_wins
    assert posterior({NONE: 0.01, UNNAMED: 0.4, "gain[1]": 0.59}).wins("gain[1]")
    assert not posterior({NONE: 0.08, UNNAMED: 0.3, "gain[1]": 0.62}).wins("gain[1]")


# --------------------------------------------------------------------------- selection


@dataclass(frozen=True)
class MadeUp:
    """A study whose posteriors are written down: by the names of the model, and of what competes again."""

    tables: dict
    gains: frozenset = frozenset()
    has_held_out: bool = False
    competition: Competition = Competition((), (), {})

    def posterior(self, model):
        return posterior(self.tables[tuple(h.name for h in model), None])

    def reopened(self, model, h, _grid=()):
        return posterior(self.tables[tuple(x.name for x in model), h.name])

    def room(self, _model):
        return 100

    def constants_of(self, _h):
        return ()

    def fewest_joints(self, _model, _h):
        return None

    def held_gain(self, _model, h):
        class Gain:
            gains = h.name in self.gains

        return Gain()


CLEAR_A = {NONE: 0.001, UNNAMED: 0.009, "a[1]": 0.98, "b": 0.01}
NOTHING = {NONE: 0.9, UNNAMED: 0.05, "a[1]": 0.03, "b": 0.02}


def test_forward_takes_what_wins_where_it_is_fitted_and_stops_when_nothing_is_missing():
    study = MadeUp({((), None): CLEAR_A, (("a[1]",), "a[1]"): CLEAR_A, (("a[1]",), None): NOTHING})
    states = list(forward(study))
    assert [[h.name for h in s.model] for s in states] == [[], ["a[1]"]]


def test_settle_follows_the_winner_to_the_fit_that_contains_it():
    clear_b = {NONE: 0.001, UNNAMED: 0.009, "a[1]": 0.01, "b": 0.98}
    study = MadeUp({(("a[1]",), "a[1]"): clear_b, (("b",), "b"): clear_b})
    found = settle(study, State(), effect("a[1]"))
    assert (found.effect.name, found.done) == ("b", True)


def test_settle_ends_when_two_effects_take_turns():
    clear_b = {NONE: 0.001, UNNAMED: 0.009, "a[1]": 0.01, "b": 0.98}
    study = MadeUp({(("a[1]",), "a[1]"): clear_b, (("b",), "b"): CLEAR_A})
    assert not settle(study, State(), effect("a[1]")).done


def test_an_effect_at_all_joints_replaces_the_same_at_one():
    clear = {NONE: 0.001, UNNAMED: 0.009, "a": 0.99}
    tables = {(("a[1]",), None): clear, (("a[1]", "a"), "a"): clear}
    state = extended(MadeUp(tables), State((effect("a[1]"),)))
    assert [h.name for h in state.model] == ["a"]


def test_backward_removes_what_the_others_explain_and_keeps_what_helps():
    loses = {NONE: 0.2, UNNAMED: 0.1, "a[1]": 0.35, "b": 0.35}
    wins = {NONE: 0.001, UNNAMED: 0.009, "b": 0.98, "a[1]": 0.01}
    state = State((effect("a[1]"), effect("b")))
    tables = {(("a[1]", "b"), "a[1]"): loses, (("b",), "b"): wins, (("a[1]", "b"), "b"): wins}
    gone = backward(MadeUp(tables), state)
    assert [(k.effect.name, k.role) for k in gone.kept] == [("b", "accepted")]
    assert [h.name for h in gone.state.model] == ["b"]
    helped = backward(MadeUp(tables, frozenset({"a[1]"})), state)
    assert [(k.effect.name, k.role) for k in helped.kept] == [("a[1]", "helps"), ("b", "accepted")]


# --------------------------------------------------------------------------- a study of data


def test_a_study_gives_the_same_answer_whatever_was_asked_before(tmp_path):
    arm = wb.read_arm(poses.arm_toml(tmp_path / "arm.toml"))
    data = wb.read_csv(poses.poses_csv(tmp_path / "poses.csv", 30, 21), 7)
    library = wb.Library.load()
    h = library.find("backlash[2]", arm, data)[0]
    fresh, used = (Study.of(wb.compare(arm, data), library, (), True) for _ in range(2))
    used.posterior(())
    used.fit((h,))
    used.reopened((h,), h)
    assert fresh.posterior((h,)).probability == used.posterior((h,)).probability
    assert fresh.held_gain((h,), h) == used.held_gain((h,), h)
    same = replace(fresh, _memory={})
    assert same.posterior((h,)).probability == fresh.posterior((h,)).probability
