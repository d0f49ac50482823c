"""What a selection means: typed findings about effects, the unnamed, and what is left."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from typing import Literal

import numpy as np

from kincal_shared.errors import CannotAnswer
from kincal_shared.schema.names import is_unnamed, with_constants

from ..comparison.compare import Comparison
from ..evidence.adequacy import (
    STRUCTURE_P,
    NoiseFloor,
    Outliers,
    Where,
    find_outliers,
    lack_of_fit,
    near_poses_alike,
    noise_floor,
    turned_frame,
    unseen_p,
    where_it_fails,
)
from ..evidence.bayes_factors import LAMBDAS
from ..evidence.constants import choose_constants
from ..evidence.curves import Curve, curves
from ..evidence.neighbours import Alike
from ..evidence.scoring import Scored, family_p, scaled_p
from ..evidence.serial import Serial
from ..evidence.smooth import smooth_effect
from ..evidence.unnamed import Cell, cells
from ..fit.columns import Columns
from ..fit.least_squares import Fit
from ..model.effects import Hypothesis, Parameter
from ..model.hypotheses import Untestable, effect_of, place_of
from ..model.unnamed_names import UnnamedName
from ..numerics.types import Array, array
from ..prediction.nested import HELD_OUT
from ..prediction.power import CONFOUNDED_CHI2
from .advised import NOTHING_ADVISED, Advised
from .heldout import NO_HELD_OUT, HeldGain
from .identity import Left
from .posterior import ABSORBED, NONE, UNNAMED, Posterior
from .states import Kept, Selection
from .study import Model, Study
from .suggestions import Suggestion, suggest
from .support import UNTESTED

CLAIM = 0.9
LIKELY = 0.5
"""Probability from which on an effect may be named as found."""
MENTION = 0.05
_SURE_ENOUGH = 0.2  # nothing was accepted and "nothing is missing" is not far behind
_MAX_ALTERNATIVES = 8
_PREDICTABLE = 0.95  # probability that something is missing where a black box predicts better
_FOUND = 0.75  # probability from which on something unnamed is found
_LIKELY = 0.8  # probabilities from here on count alike where effects are ordered
_BEST_NAMED = 4  # listed where nothing named wins
_STEEP = 1e9  # [1/rad, 1/m] tanh with this is the sign of any move that readings show
_MOST_LN_ODDS = 50.0
_SURELY = 5.0  # standard errors from which on a sign is sure
_TESTED_FROM = 0.2  # probability by evidence from which on an alternative is tested on unseen poses

Verdict = Literal["adequate", "effect", "several_effects", "novel", "undecidable"]
Role = Literal["accepted", "helps", "alternative"]
_ROLES: tuple[Role, ...] = ("accepted", "helps", "alternative")


@dataclass(frozen=True)
class ParameterValue:
    """A fitted coefficient of an effect, in its own unit; if_negative: as of `Parameter`."""

    name: str
    value: float
    std_err: float
    unit: str
    if_negative: str = ""

    @property
    def wrong_sign(self) -> bool:
        """It is negative beyond its error, though nature has positive ones only."""
        return bool(self.if_negative) and self.value < -_SURELY * self.std_err


@dataclass(frozen=True)
class Doubts:
    """From evidence to probability, their product: the posterior probability by evidence alone, of the effect
    or one that these data cannot tell from it; support: that it helps poses which were not fitted; identity:
    that it is what its name says, and none of those others. Where the model explains the data to within a
    known noise, support is 1 and identity only the share of this effect; worse: blocks that it makes much
    worse."""

    evidence: float
    support: float = 1.0
    identity: float = 1.0
    worse: tuple[str, ...] = ()

    def beside(self, others: float, outside: float = 0.0) -> Doubts:
        """The same where others that cannot be told from the effect have so much probability by evidence.
        outside: of those that did not compete, relative to all that did."""
        together = self.evidence + others + outside
        share = self.evidence / together if together > 0.0 else 1.0
        return replace(self, evidence=together / (1.0 + outside), identity=self.identity * share)

    @property
    def probability(self) -> float:
        """That the effect is real and helps on other poses."""
        return self.either * self.identity

    @property
    def either(self) -> float:
        """The same of the effect or one that these data cannot tell from it."""
        return self.evidence * self.support


@dataclass(frozen=True)
class EffectFinding:
    """One named effect with its probability.

    label: name with its searched constants; hypothesis: what was fitted under that name; role: "accepted": it
    won against nothing and against the unnamed; "helps": it did not win, but it predicts better, in
    cross-validation of the fit poses and on the held-out ones. Both kinds are part of the final model;
    "alternative": the others. p_value: family-wise; delta_bic: negative if the effect is worth its
    parameters; held: what held-out poses gain; confounded_with: effects that these data (or no data at all)
    can tell from it; explained_share: of what the model without it leaves; doubts: what makes the probability
    smaller than that of the evidence; inferred_direction: it rests on an approach direction that nobody
    recorded; constants: those that were searched, or assumed; inspect: what to look at on the arm;
    taken_back: it won by evidence, but poses that were not fitted do not confirm it."""

    name: str
    label: str
    hypothesis: Hypothesis
    role: Role
    probability: float
    doubts: Doubts
    p_value: float
    delta_bic: float
    held: HeldGain
    explained_share: float
    parameters: tuple[ParameterValue, ...]
    confounded_with: tuple[str, ...]
    inferred_direction: bool = False
    constants: tuple[tuple[str, float], ...] = ()
    inspect: str = ""
    taken_back: bool = False

    def named(self, right: float) -> EffectFinding:
        """The same where the name is right with a probability beside all doubts."""
        doubts = replace(self.doubts, identity=self.doubts.identity * right)
        return replace(self, doubts=doubts, probability=doubts.probability)

    @property
    def accepted(self) -> bool:
        """It won and is part of the final model."""
        return self.role == "accepted"

    @property
    def in_model(self) -> bool:
        """It is part of the final model."""
        return self.role != "alternative"

    @property
    def helps(self) -> bool:
        """Held-out poses are predicted better with it, beyond chance: what the text judges."""
        return self.held.gains

    @property
    def harms(self) -> bool:
        """Held-out poses are predicted worse with it, beyond chance; it is not part of the final model."""
        return self.held.harms


@dataclass(frozen=True)
class UnnamedFinding:
    """Something that no effect of the library describes: where it enters, the one or two variables it
    depends on, and simple terms that imitate it.

    name: what `kincal model add` takes; held: what held-out poses gain from the smooth function that it adds;
    curves: that function, fitted to all poses. Both empty where the data do not determine one. probability:
    by evidence, times that poses which were not fitted gain from the function: noise of a joint's reading
    favours functions at that joint, too, but predicts nothing.
    """

    name: str
    location: str
    depends_on: tuple[str, ...]
    suggested_terms: tuple[Suggestion, ...]
    p_value: float
    probability: float
    held: HeldGain
    curves: tuple[Curve, ...]

    @property
    def found(self) -> bool:
        """Poses that were not fitted confirm it."""
        return self.probability >= _FOUND


@dataclass(frozen=True)
class Remainder:
    """What the final model leaves: held-out error [m], [rad] beside the noise floor, where it is, and what of
    it near poses have in common (as of `Comparison`)."""

    held_pos_m: float
    held_rot_rad: float | None
    floor: NoiseFloor
    where: tuple[Where, ...]
    alike: Alike | None


@dataclass(frozen=True)
class Diagnosis:
    """Answer of `diagnose`.

    comparison: of the given model with the data; effects: best first, those of the final model before the
    alternatives; probability_none: that nothing is missing, before anything was added; final: the fit with
    the effects of the final model; adequate_after: it explains the data, as of `Comparison`; outliers: of the
    final model; map_ln_bf: ln Bayes factor of each (location, drivers) before anything was added; advised:
    what to change about the model, and the errors on the way; serial: the noise is correlated in time, so
    that effects were judged by stretches of the session, None if it is not.
    """

    comparison: Comparison
    verdict: Verdict
    effects: tuple[EffectFinding, ...]
    novel: UnnamedFinding | None
    not_testable: tuple[Untestable, ...]
    probability_none: float
    final: Fit
    adequate_after: bool
    outliers: Outliers
    remainder: Remainder
    map_ln_bf: dict[tuple[str, str], float] = field(default_factory=dict)
    advised: Advised = NOTHING_ADVISED
    serial: Serial | None = None

    @property
    def adequate(self) -> bool:
        """The given model explains the data: by the tests of `Comparison`, and by the evidence that something
        is missing, which sees more than they do; nor does it leave what follows time."""
        return self.comparison.adequate and self.serial is None and self.probability_none > _SURE_ENOUGH

    @property
    def exhausted(self) -> bool:
        """The given model has smooth functions for what has no name, and held-out poses follow nothing else
        that is recorded."""
        reachable = self.comparison.reachable
        smooth = any(is_unnamed(h.name) for h in self.comparison.fit_all.hypotheses)
        return smooth and reachable is not None and reachable.nothing


def conclude(study: Study, found: Selection, serial: Serial | None = None) -> Diagnosis:
    """Everything the answer says, from a selection. serial: noise that is correlated in time, for which the
    study is by stretches."""
    final = study.fit(found.model)
    outliers = _outliers(final, study.comparison)
    left = _left_by(final, study.comparison, outliers)
    novel = unnamed_finding(study, found) if found.last.unnamed_wins else None
    if novel is not None and serial is not None and not novel.held.gains:
        novel = None  # what follows time in one stretch is not there in the next
    explained = left.is_known_noise and novel is None and serial is None
    effects = effect_findings(study, found, left, explained=explained)
    return Diagnosis(
        comparison=study.comparison,
        verdict=_verdict(found.first.none, effects, novel, study.comparison, serial),
        effects=effects,
        novel=novel,
        not_testable=not_testable(study, found.first),
        probability_none=found.first.none,
        final=final,
        adequate_after=left.is_noise
        and novel is None
        and serial is None
        and turned_frame(final) is None
        and outliers.few,
        outliers=outliers,
        remainder=remainder(study, found.model, left),
        map_ln_bf={(s.best.location, " x ".join(s.best.drivers)): s.ln_bf for s in found.first.mapped},
        serial=serial,
    )


def promising(d: Diagnosis, advice: Advised) -> Diagnosis:
    """The answer with what it advises: the error of the final model is that which the commands will give."""
    last = advice.errors[-1]
    if last.block != HELD_OUT:
        return replace(d, advised=advice)
    left = replace(d.remainder, held_pos_m=last.pos_m, held_rot_rad=last.rot_rad)
    return replace(d, advised=advice, remainder=left)


def _left_by(final: Fit, c: Comparison, outliers: Outliers) -> Left:
    """What the final model leaves: known where nothing was added. outliers: of that model."""
    if final is c.fit_all:
        return Left(final, c.p_lack_of_fit, c.where, c.alike, c.p_unseen, outliers.clusters)
    held = c.kept_back
    p_unseen = None if held is None else unseen_p(final, held, outliers)
    p_lack = lack_of_fit(final, noise_floor(final))
    alike = near_poses_alike(final)
    return Left(final, p_lack, where_it_fails(final), alike, p_unseen, outliers.clusters)


def _outliers(final: Fit, c: Comparison) -> Outliers:
    """Those of the final model; of its own poses, and of poses that the file keeps back."""
    return c.outliers if final is c.fit_all else find_outliers(final, c.kept_back)


def _verdict(
    none: float,
    effects: Sequence[EffectFinding],
    novel: UnnamedFinding | None,
    c: Comparison,
    serial: Serial | None,
) -> Verdict:
    """Noise that is correlated in time is alike at near poses too, on a path; that is said of it."""
    accepted = [e for e in effects if e.accepted]
    if novel is not None and novel.found:
        return "novel"
    if not accepted:
        unpredicted = c.p_unseen is not None and c.p_unseen <= STRUCTURE_P
        alike = serial is None and c.alike is not None and c.alike.shown
        refuted = c.outliers.clusters or c.turned or unpredicted or alike
        return "adequate" if none > _SURE_ENOUGH and not refuted else "undecidable"
    if len(accepted) > 1:
        return "several_effects" if any(e.probability >= LIKELY for e in accepted) else "undecidable"
    return "effect" if accepted[0].probability > CLAIM else "undecidable"


def unnamed_finding(study: Study, found: Selection) -> UnnamedFinding:
    """The cell of the map with the most evidence, for all that no effect describes."""
    posterior = found.last
    top = posterior.top_unnamed
    name = UnnamedName.of_cell(top.best.location, top.best.drivers)
    if name.without_terms:
        held, lines, support = _by_columns(study, found.model, top.best)
    else:
        held, lines, support = _smooth(study, found.model, name)
    return UnnamedFinding(
        name=str(name),
        location=top.best.location,
        depends_on=top.best.drivers,
        suggested_terms=() if name.without_terms else suggest(top.best, posterior.scorer),
        p_value=_unnamed_p(posterior, top),
        probability=posterior.unnamed * support,
        held=held,
        curves=lines,
    )


def _unnamed_p(posterior: Posterior, top: Scored[Cell]) -> float:
    """Family-wise p-value over the map; of a product over the dictionary too (Bonferroni)."""
    if top.best.product is None:
        return family_p(posterior.scorer, posterior.mapped)[top.name]
    return min(1.0, posterior.tries * scaled_p(top, posterior.scorer.scale))


def _smooth(study: Study, model: Model, name: UnnamedName) -> tuple[HeldGain, tuple[Curve, ...], float]:
    """What held-out poses gain from a smooth function of this name beside a model, its terms chosen without
    them; the function fitted to all poses; and the probability that something helps poses that were not
    fitted: this function, or a black box on held-out poses."""

    def chosen(fit: Fit) -> Hypothesis | None:
        try:
            return smooth_effect(name, study.scorer_at(fit, model)).hypothesis
        except CannotAnswer:
            return None

    h = chosen(study.held_fit(model) if study.has_held_out else study.fit(model))
    if h is None:
        return NO_HELD_OUT, (), UNTESTED
    return study.held_gain(model, h), curves(study.fit((*model, h)), h), _chance(study, model, h, chosen)


def _by_columns(study: Study, model: Model, cell: Cell) -> tuple[HeldGain, tuple[Curve, ...], float]:
    """The same for a function of the tool's orientation, which no term can hold: by its cell's columns."""

    def columns(fit: Fit) -> Array:
        every = cells(Columns(fit, np.ones(fit.data.n)), double=False)
        return next(c.columns for c in every if c.name == cell.name)

    found = study.linear_gain(model, columns)
    held, chance = (NO_HELD_OUT, UNTESTED) if found is None else (found[0], found[1].probability)
    if chance < _PREDICTABLE and study.black_box_gains(model):
        chance = _PREDICTABLE
    return held, (), chance


def _chance(study: Study, model: Model, h: Hypothesis, chosen: Callable[[Fit], Hypothesis | None]) -> float:
    """Probability that something beside a model helps poses that were not fitted: the function that `chosen`
    gives of any poses, h of these. It counts as it stands if it leaves no more than a known noise."""
    if study.explains((*model, h)):
        return 1.0
    support = study.support_of(model, chosen)
    chance = UNTESTED if support is None else support.probability
    if chance < _PREDICTABLE and study.black_box_gains(model):
        return _PREDICTABLE  # by other functions, or more of them
    return chance


def remainder(study: Study, model: Model, left: Left) -> Remainder:
    """What a model leaves on held-out poses; left: by its fit."""
    position, rotation = study.held_error(model)
    return Remainder(position, rotation, study.comparison.noise_floor, left.where[:3], left.alike)


def not_testable(study: Study, first: Posterior) -> tuple[Untestable, ...]:
    """Effects that lack a column or a key, whose columns do not vary, or that the fitted parameters
    imitate exactly (those need nothing: no data of this kind can show them), at every joint."""
    needs = {c.name: c.effect.needs for c in study.competition.candidates}
    open_ = {effect_of(s.name) for s in first.scored if s.score.absorbed < ABSORBED}
    absorbed = [s for s in first.scored if not place_of(s.name) and effect_of(s.name) not in open_]
    data = study.base.data

    def lacking(s: Scored[Hypothesis]) -> tuple[str, ...]:
        still = () if s.block.any() else tuple(n for n in needs[s.name] if data.constant(n))
        return tuple(f"{name} that varies" for name in still)

    return (*study.competition.untestable, *(Untestable(s.name, lacking(s)) for s in absorbed))


# ------------------------------------------------------------------------------------------- effects


def effect_findings(
    study: Study, found: Selection, left: Left, *, explained: bool
) -> tuple[EffectFinding, ...]:
    """Findings about kept effects and alternatives, by role and probability. left: by the final model;
    explained: that is known noise, so that evidence holds as it stands."""
    first = found.first
    p_family = family_p(first.scorer, [*first.scored, *first.mapped])
    back = frozenset(k.effect.name for k in found.taken_back)
    report = _Reporter(study, found.model, p_family, left, explained, back)
    findings = [report.kept(k) for k in found.kept]
    named = {id(k.posterior): k.identity for k in found.kept}  # what stands in its place is a piece like it
    findings += [
        report.alternative(h, posterior).named(named.get(id(posterior), 1.0))
        for h, posterior in alternatives(found)
    ]
    return tuple(sorted(findings, key=_rank))


def _rank(f: EffectFinding) -> tuple[int, float, float]:
    """Best first: by role, probability, and what held-out poses gain. Effects that are likely enough come by
    their gain alone: which of .90 and .97 is larger differs from one half of the poses to the other."""
    ratio = f.held.after_m / f.held.before_m if f.held.after_m > 0.0 else 1.0
    return _ROLES.index(f.role), -min(f.probability, _LIKELY), ratio


def alternatives(found: Selection) -> list[tuple[Hypothesis, Posterior]]:
    """Effects outside the model, most probable first, each with the posterior that gives it most: those
    taken back, those that keep a probability worth a mention, and the best ones where nothing named wins."""
    most: dict[str, tuple[float, Posterior]] = {}
    for posterior in [k.posterior for k in found.kept] or [found.first]:
        for name, p in _outside(found, posterior).items():
            if p > most.get(name, (MENTION,))[0]:
                most[name] = p, posterior
    best = sorted(most.items(), key=lambda item: -item[1][0])[:_MAX_ALTERNATIVES]
    listed = {name: (posterior.by_name[name].best, posterior) for name, (_, posterior) in best}
    for h in _best_named(found) if found.last.something_missing else ():
        listed.setdefault(h.name, (h, found.last))
    back = {k.effect.name: (k.effect, k.posterior) for k in found.taken_back}
    return [*(listed | back).values()]


def _outside(found: Selection, posterior: Posterior) -> dict[str, float]:
    """Probabilities of the named effects that the final model does not have, at any joint or at all."""
    names = {k.effect.name for k in found.kept}
    effects = {effect_of(name) for name in names}
    return {
        name: p
        for name, p in posterior.probability.items()
        if name not in (NONE, UNNAMED, *names, *effects) and effect_of(name) not in names
    }


def _best_named(found: Selection) -> list[Hypothesis]:
    """The most probable named effects beside the final model, whatever their probability."""
    outside = _outside(found, found.last)
    names = sorted(outside, key=lambda name: -outside[name])[:_BEST_NAMED]
    return [found.last.by_name[name].best for name in names]


@dataclass(frozen=True)
class _Reporter:
    """Makes findings: what is the same for all of them. left: by the final model; explained: evidence holds
    as it stands; back: effects that were taken back."""

    study: Study
    model: Model
    p_family: dict[str, float]
    left: Left
    explained: bool
    back: frozenset[str]

    def kept(self, k: Kept) -> EffectFinding:
        """About an effect of the final model, with its fitted values."""
        competing = confounded_effects(self.study, k.effect, k.posterior)
        evidence = k.posterior.presence(k.effect.name)
        found = self._finding(k.effect, k.role, evidence, k.posterior, competing).named(k.identity)
        confounded = dict.fromkeys((*found.confounded_with, *k.ties))
        values = fitted_values(k.effect, self.study.fit(self.model))
        return replace(found, confounded_with=tuple(confounded), parameters=values)

    def alternative(self, h: Hypothesis, posterior: Posterior) -> EffectFinding:
        """About an effect outside the final model."""
        evidence = posterior.probability.get(h.name, 0.0)
        visible = posterior.by_name[h.name].score.chi2 > CONFOUNDED_CHI2 * posterior.scorer.scale**2
        competing = confounded_effects(self.study, h, posterior) if visible else ()
        found = self._finding(h, "alternative", evidence, posterior, competing)
        return found if visible else replace(found, confounded_with=())

    def _finding(
        self, h: Hypothesis, role: Role, evidence: float, posterior: Posterior, competing: tuple[str, ...]
    ) -> EffectFinding:
        """competing: what these data cannot tell from it."""
        scorer, score = posterior.scorer, posterior.by_name[h.name].score
        others = sum(posterior.probability.get(name, 0.0) for name in competing)
        lag, play = lagging_sensor(h, posterior), backlash_of_every_move(h, posterior)
        if lag is not None and h.alike_in_joints:  # one cause, to first order and exactly
            evidence = min(evidence + posterior.unnamed, 1.0)
        elif lag is not None:
            others += posterior.unnamed
        doubts = self._doubts(h, evidence, competing)
        doubts = doubts.beside(others, evidence * play.odds)
        alike = dict.fromkeys(
            (*with_equivalents(self.study, h, competing), *play.names, *([lag] if lag else []))
        )
        return EffectFinding(
            name=h.name,
            label=h.label,
            hypothesis=h,
            role=role,
            probability=doubts.probability,
            doubts=doubts,
            p_value=self.p_family.get(h.name, self.p_family.get(h.effect, 1.0)),
            delta_bic=float(-score.chi2 / scorer.scale**2 + score.rank * np.log(len(scorer.wz))),
            held=self.study.held_gain(self.model, h),
            explained_share=score.chi2 / max(scorer.left, 1e-12),
            parameters=(),
            confounded_with=tuple(alike),
            inferred_direction=self._rests_on_inferred_direction(h),
            constants=h.constants,
            inspect=self.study.library.effects[h.effect].inspect,
            taken_back=h.name in self.back,
        )

    def _doubts(self, h: Hypothesis, evidence: float, competing: Sequence[str]) -> Doubts:
        """What makes the probability of an effect smaller than that by evidence. Of what is unlikely anyway
        nothing more is computed. What cannot be told from an effect of the model helps as that one does:
        beside it there is nothing left to help with."""
        back = h.name in self.back
        same = h if h in self.model else next((x for x in self.model if x.name in competing), h)
        if (self.explained and not back) or (evidence < _TESTED_FROM and same not in self.model):
            return Doubts(evidence)
        identity = 1.0 if self.explained else self.left.identity(h)
        support = self.study.support(self.model, same)
        if support is None:
            return Doubts(evidence, UNTESTED, identity)
        return Doubts(evidence, support.probability, identity, support.worse)

    def _rests_on_inferred_direction(self, h: Hypothesis) -> bool:
        data = self.study.base.data
        return data.direction_source == "inferred" and "dir" in self.study.library.effects[h.effect].needs


def fitted_values(h: Hypothesis, fit: Fit) -> tuple[ParameterValue, ...]:
    """The coefficients of an effect of a fit."""

    def value(p: Parameter) -> ParameterValue:
        k = fit.names.index(f"{h.name}.{p.name}")
        return ParameterValue(p.name, float(fit.estimate[k]), float(fit.std_err[k]), p.unit, p.if_negative)

    return tuple(map(value, h.parameters))


# --------------------------------------------------------------------------------------- confounding


def confounded_effects(study: Study, h: Hypothesis, posterior: Posterior) -> tuple[str, ...]:
    """Competing effects that these data cannot tell from this one: at all joints says no more than at one."""
    scale = posterior.scorer.scale
    signal = _found_signal(h, posterior)
    similar = [
        s.name
        for s in posterior.scored
        if _another(h, s)
        and (
            posterior.probability.get(s.name, 0.0) > MENTION
            or imitates(_at_its_time(study, h, s, posterior), signal, scale)
        )
    ]
    similar += [name for name in _moved_base(h, posterior) if name not in similar]
    alone = {effect_of(name) for name in similar if place_of(name)}
    return tuple(name for name in similar if name not in alone)


def lagging_sensor(h: Hypothesis, posterior: Posterior) -> str | None:
    """The cell of a sensor that lags, by its name, where it is what is unnamed, and could imitate an effect
    of the last move: after short moves it does what joints do that all settle alike."""
    if not h.of_last_move or not posterior.unknown:
        return None
    top = posterior.top_unnamed
    name = UnnamedName.of_cell(top.best.location, top.best.drivers)
    if name.of_tool_move and imitates(top, _found_signal(h, posterior), posterior.scorer.scale):
        return str(name)
    return None


@dataclass(frozen=True)
class _Play:
    """Backlash with a side that every move decides, however small: names of the effects, and the odds against
    the effect that they were compared with. No names where the sides are those that compete anyway."""

    names: tuple[str, ...] = ()
    odds: float = 0.0


def backlash_of_every_move(h: Hypothesis, posterior: Posterior) -> _Play:
    """Backlash at the joints of an effect of their last moves, where jitter of joints that stay would decide
    the side that `with_direction` keeps."""
    data, joints = posterior.scorer.columns.fit.data, _settling_joints(h)
    if data.move is None or data.direction is None or data.direction_source != "inferred" or not joints:
        return _Play()
    moves, sides = (x[:, [j - 1 for j in joints]] for x in (data.move, data.direction))
    if not (np.sign(moves) * sides < 0.0).any():
        return _Play()
    [(_, ln_bf)] = posterior.scorer.hypotheses([_by_sign(h)])
    odds = float(np.exp(min(ln_bf - posterior.by_name[h.name].ln_bf, _MOST_LN_ODDS)))
    return _Play(tuple(f"backlash[{j}]" for j in joints), odds) if odds > MENTION else _Play()


def _settling_joints(h: Hypothesis) -> tuple[int, ...]:
    """Joints with a coefficient each that scales their last move."""
    if not h.of_last_move or any(len(p.terms) > 1 for p in h.parameters):
        return ()
    return tuple(term.basis[0].index for p in h.parameters for term in p.terms)


def _by_sign(h: Hypothesis) -> Hypothesis:
    """The same effect by the sign of each move."""

    def sign(p: Parameter) -> Parameter:
        terms = (replace(t, basis=(replace(t.basis[0], fn="tanh", c1=_STEEP), t.basis[1])) for t in p.terms)
        return replace(p, terms=tuple(terms))

    return replace(h, parameters=tuple(map(sign, h.parameters)))


def with_equivalents(study: Study, h: Hypothesis, competing: Sequence[str]) -> tuple[str, ...]:
    """Effects that these data cannot tell from this one, and those that no data can."""
    equivalent = study.competition.equivalents.get(h.effect, ())
    return (*competing, *(name + place_of(h.name) for name in equivalent))


def _another(h: Hypothesis, other: Scored[Hypothesis]) -> bool:
    """Not the same effect, nor that with all joints or one of them, and visible in the data."""
    same = effect_of(other.name) == h.effect and (not place_of(other.name) or h.name == h.effect)
    return other.name != h.name and not same and other.score.absorbed < ABSORBED


def _at_its_time(
    study: Study, h: Hypothesis, other: Scored[Hypothesis], posterior: Posterior
) -> Scored[Hypothesis]:
    """Another effect with the same constants (a step: its moment) as one that follows time, where it has
    them: the moment with most evidence for the other may be a pose off, and then it imitates nothing."""
    names = [name for name, _ in h.constants]
    if not (h.of_session and names and names == [name for name, _ in other.best.constants]):
        return other
    text = with_constants(other.name, dict(h.constants))
    same = choose_constants(study.library, [text], study.base.arm, study.base.data, dh=study.dh)
    return replace(other, make=lambda: np.hstack(posterior.scorer.columns.hypotheses(same)))


def _moved_base(h: Hypothesis, posterior: Posterior) -> list[str]:
    """A base turned and shifted at once imitates a moved camera that never turns; neither alone does."""
    moves = ("base_tilt", "base_shift")
    group = [s for s in posterior.scored if s.name in moves]
    if h.name in moves or len(group) < 2:
        return []
    both = replace(group[0], make=lambda: np.hstack([s.block for s in group]))
    signal, scale = _found_signal(h, posterior), posterior.scorer.scale
    return [s.name for s in group] if imitates(both, signal, scale) else []


def _found_signal(h: Hypothesis, posterior: Posterior) -> Array:
    """(rows,) what an effect does at its fitted size, beside the nuisance parameters."""
    mine = posterior.by_name[h.name]
    columns = mine.columns
    return array(columns @ _ridge(columns, mine.signal, posterior.scorer.scale))


def imitates(other: Scored[Hypothesis] | Scored[Cell], signal: Array, scale: float) -> bool:
    """Whether another effect could imitate what was found: less than CONFOUNDED_CHI2 units of chi^2 stay
    unexplained (METHOD.md 16)."""
    columns = other.columns
    left = signal - columns @ _ridge(columns, signal, scale)
    return float(left @ left) / scale**2 < CONFOUNDED_CHI2


def _ridge(columns: Array, target: Array, scale: float) -> Array:
    inner = columns.T @ columns + (scale / max(LAMBDAS)) ** 2 * np.eye(columns.shape[1])
    return np.linalg.solve(inner, columns.T @ target)
