"""Which physical effect is missing: evidence for every effect and joint, with honest probabilities.

docs/DIAGNOSIS.md gives the mathematics. The probabilities are conditional on the library and on the
priors stated here; wording is "consistent with", never "proven".
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np
from scipy import stats

from kincal.errors import BadInput

from .arms import ArmTable
from .columns import Columns
from .compare import ADEQUATE_P, Comparison, compare, lack_of_fit, noise_floor
from .data import Measurements
from .effects import Effect, Hypothesis, Library, Parameter
from .evidence import LAMBDAS, NoiseScale, Projector, Score, ln_bayes_factor, posterior, score
from .fit import STUDENT_NU, Fit, fit_model, rms
from .novel import Cell, cells

PRIOR_NONE, PRIOR_NOVEL = 0.3, 0.1
ACCEPT_ODDS = 9.0
CLAIM = 0.9
MENTION = 0.05
_TWIN_CHI2 = 9.0
ABSORBED = 0.995
MAX_EFFECTS = 5
_SURE_ENOUGH = 0.2  # nothing was accepted and 'none' is not far behind
_SETTLE_MAX = 4
_PREFER_SINGLE = np.log(10.0)
_NULL_DRAWS = 400
_BOOTSTRAP = 1000


@dataclass(frozen=True)
class Candidate:
    """A hypothesis that competes: the constants of its grid are summed over."""

    name: str
    effect: Effect
    variants: tuple[Hypothesis, ...]
    prior: float


@dataclass(frozen=True)
class Scored:
    """columns: W G; signal: W z0, what there is to explain."""

    name: str
    ln_bf: float
    score: Score
    best: Hypothesis | Cell
    columns: np.ndarray
    signal: np.ndarray


@dataclass(frozen=True)
class ParameterValue:
    name: str
    value: float
    std_err: float
    unit: str


@dataclass(frozen=True)
class EffectFinding:
    """One named effect with its probability; `accepted`: it is part of the final model."""

    name: str
    probability: float
    p_value: float
    delta_bic: float
    held_rms_before_m: float
    held_rms_after_m: float
    held_ratio_interval: tuple[float, float]
    parameters: tuple[ParameterValue, ...]
    confounded_with: tuple[str, ...]
    why: str
    accepted: bool


@dataclass(frozen=True)
class NovelFinding:
    locus: str
    depends_on: tuple[str, ...]
    suggested_terms: tuple[str, ...]
    p_value: float
    probability: float


@dataclass(frozen=True)
class NotTestable:
    """needs: the columns or arm keys that are missing; empty when the fitted parameters imitate the
    effect exactly, so that no data of this kind can show it."""

    name: str
    needs: tuple[str, ...]


@dataclass(frozen=True)
class Diagnosis:
    comparison: Comparison
    verdict: str
    effects: tuple[EffectFinding, ...]
    novel: NovelFinding | None
    not_testable: tuple[NotTestable, ...]
    probability_none: float
    final: Fit
    adequate_after: bool
    map_ln_bf: dict[tuple[str, str], float] = field(default_factory=dict)


def merged(effect: Effect, hypotheses: list[Hypothesis]) -> Hypothesis:
    """One hypothesis with the parameters of all joints: "joint_compliance" from its instances."""
    parameters = tuple(
        Parameter(f"{p.name}{h.name[len(effect.name) :]}", p.unit, p.sigma, p.terms)
        for h in hypotheses
        for p in h.parameters
    )
    return Hypothesis(effect.name, effect.name, parameters, hypotheses[0].constants)


def build_candidates(
    arm: ArmTable, data: Measurements, library: Library, used: set[str]
) -> tuple[list[Candidate], list[NotTestable]]:
    """Every testable effect: all joints at once (half its prior) and each joint or pair alone."""
    testable, lacking = [], []
    for effect in library.effects.values():
        missing = effect.missing(arm, data)
        if missing:
            lacking.append(NotTestable(effect.name, tuple(missing)))
        elif not effect.twin_of:
            testable.append(effect)
    out: list[Candidate] = []
    share = (1.0 - PRIOR_NONE - PRIOR_NOVEL) / max(len(testable), 1)
    for effect in testable:
        by_constants: dict[tuple, list[Hypothesis]] = {}
        by_name: dict[str, list[Hypothesis]] = {}
        for h in effect.instances(arm, data):
            if not any(p.terms for p in h.parameters):
                continue
            by_constants.setdefault(h.constants, []).append(h)
            by_name.setdefault(h.name, []).append(h)
        several = effect.per == "joint" and len(by_name) > 1
        singles = [name for name in by_name if name not in used]
        for name in singles:
            prior = share / len(by_name) * (0.5 if several else 1.0)
            out.append(Candidate(name, effect, tuple(by_name[name]), prior))
        if several and effect.name not in used:
            variants = tuple(merged(effect, group) for group in by_constants.values())
            out.append(Candidate(effect.name, effect, variants, 0.5 * share))
    return out, lacking


def robust_weights(fit: Fit, candidates: list[Candidate]) -> np.ndarray:
    """Student-t pose weights under DH plus ALL effects at prior width, so that an effect is not
    mistaken for outliers (diagnosis.md 3.1)."""
    n, c = fit.evaluation.r.shape
    plain = Columns(fit, np.ones(n))
    blocks = [plain.hypothesis(cand.variants[0]) for cand in candidates if cand.prior > 0]
    big = np.hstack([fit.J * fit.sigma_prior, *blocks])
    z0 = fit.z + fit.J @ fit.estimate
    weight = np.ones(n)
    for _ in range(6):
        root = np.repeat(np.sqrt(weight), c)
        a = big * root[:, None]
        kernel = a @ a.T / fit.scale**2 + np.eye(n * c)
        # residual of the ridge fit is K^-1 z; (I - H)_ii blocks are those of K^-1
        inverse = np.linalg.inv(kernel)
        e = inverse @ (root * z0)
        d2 = np.empty(n)
        for i in range(n):
            block = slice(i * c, (i + 1) * c)
            d2[i] = e[block] @ np.linalg.solve(inverse[block, block] + 1e-9 * np.eye(c), e[block]) / weight[i]
        scale2 = max(float(np.median(d2) / stats.chi2.median(c)), 1e-6)
        weight = np.minimum((STUDENT_NU + c) / (STUDENT_NU + d2 / scale2), 1.0)
    # poses that are merely a little off keep their full weight: the evidence is Gaussian
    return np.where(weight > 0.35, 1.0, weight)


class Engine:
    """Scores everything at one fit: candidates and map cells by the same formula.

    drop: an effect of the fit that is to compete again. The point of linearisation stays the fit WITH
    it: a large effect bends the DH errors, and columns taken beside the truth would favour cousins.
    """

    def __init__(self, fit: Fit, weight: np.ndarray, stated: bool, drop: Hypothesis | None = None):
        self.columns = Columns(fit, weight)
        keep = np.array(
            [drop is None or not name.startswith(f"{drop.name}.") for name in fit.names], dtype=bool
        )
        self.projector = Projector.of(self.columns.weighted(fit.J[:, keep]) * fit.sigma_prior[keep])
        z0 = self.columns.weighted(fit.z + fit.J @ fit.estimate)
        self.wz = self.projector.apply(z0)
        rows = float((weight > 0.35).sum() * self.columns.c)
        self.dof = max(rows - self.projector.spent, 1.0)
        self.noise = NoiseScale.posterior(float(self.wz @ self.wz), self.dof, stated=stated)
        self.scale = float((self.noise.s * self.noise.weight).sum())

    def score(self, columns: np.ndarray) -> tuple[Score, float, np.ndarray]:
        projected = self.projector.apply(columns)
        s = score(columns, projected, self.wz)
        return s, float(ln_bayes_factor(s.u, s.v, self.noise)), projected

    def candidates(self, candidates: list[Candidate]) -> list[Scored]:
        out = []
        for candidate in candidates:
            found = []
            for h in candidate.variants:
                columns = self.columns.hypothesis(h)
                s, ln_bf, projected = self.score(columns)
                found.append(Scored(candidate.name, ln_bf, s, h, projected, self.wz))
            best = max(found, key=lambda f: f.ln_bf)
            ln_mean = float(np.logaddexp.reduce([f.ln_bf for f in found]) - np.log(len(found)))
            out.append(Scored(candidate.name, ln_mean, best.score, best.best, best.columns, self.wz))
        return out

    def map(self, *, double: bool = True) -> list[Scored]:
        out = []
        for cell in cells(self.columns, double=double):
            s, ln_bf, projected = self.score(cell.columns)
            out.append(Scored(cell.name, ln_bf, s, cell, projected, self.wz))
        return out


def family_p(engine: Engine, scored: list[Scored], seed: int = 1) -> dict[str, float]:
    """Family-wise p-value of each score test: draws from the null give the distribution of the least p."""
    rng = np.random.default_rng(seed)
    rows = len(engine.wz)
    z = rng.standard_normal((rows, _NULL_DRAWS))
    wz = engine.projector.apply(z)
    least = np.ones(_NULL_DRAWS)
    own: dict[str, float] = {}
    for s in scored:
        if s.score.rank == 0:
            own[s.name] = 1.0
            continue
        u, sv, _ = np.linalg.svd(s.columns, full_matrices=False)
        basis = u[:, sv > 1e-5 * sv.max()]
        k = basis.shape[1]
        p = stats.chi2.sf(((basis.T @ wz) ** 2).sum(axis=0), k)
        least = np.minimum(least, p)
        own[s.name] = float(stats.chi2.sf(((basis.T @ engine.wz) ** 2).sum() / engine.scale**2, k))
    least.sort()
    count = len(least)
    return {
        name: float(max((np.searchsorted(least, p, side="right") + 1) / (count + 1), min(1.0, p * len(own))))
        if p * len(own) < 1.0 / count
        else float((np.searchsorted(least, p, side="right") + 1) / (count + 1))
        for name, p in own.items()
    }


def _posterior(candidates: list[Candidate], scored: list[Scored], mapped: list[Scored]) -> dict[str, float]:
    """Posterior by candidate name plus 'none' and 'novel'; effects that the nuisance parameters imitate
    (absorbed) are left out, for the data say nothing about them."""
    ln_bf = {"none": 0.0}
    prior = {"none": PRIOR_NONE}
    by_name = {s.name: s for s in scored}
    for candidate in candidates:
        s = by_name[candidate.name]
        if s.score.absorbed < ABSORBED:
            ln_bf[candidate.name] = s.ln_bf
            prior[candidate.name] = candidate.prior
    if mapped:
        single = [s.ln_bf for s in mapped if len(s.best.drivers) == 1]
        double = [s.ln_bf for s in mapped if len(s.best.drivers) == 2]
        parts = [np.logaddexp.reduce(x) - np.log(len(x)) for x in (single, double) if x]
        ln_bf["novel"] = float(np.logaddexp.reduce(parts) - np.log(len(parts)))
        prior["novel"] = PRIOR_NOVEL
    return posterior(ln_bf, prior)


def diagnose(
    arm: ArmTable,
    data: Measurements,
    library: Library,
    hypotheses: list[Hypothesis] | tuple[Hypothesis, ...] = (),
    *,
    dh: bool = True,
    progress: Callable[[str, int, int], None] | None = None,
) -> Diagnosis:
    """Find the effects that the data ask for, one after another, and say how sure that is."""
    tell = progress or (lambda *_: None)
    tell("fit", 0, 4)
    comparison = compare(arm, data, hypotheses, dh=dh)
    fit = comparison.fit_all
    used_data = fit.chain.data
    stated = data.cov is not None
    used = {h.name for h in hypotheses}
    candidates, lacking = build_candidates(arm, used_data, library, used)
    weight = robust_weights(fit, candidates)
    accepted: list[Hypothesis] = []
    frames = (fit.base, fit.tool)

    def refit(extra: list[Hypothesis]) -> Fit:
        return fit_model(
            arm,
            used_data,
            [*hypotheses, *extra],
            dh=dh,
            frames=frames,
            start=dict(zip(fit.names, fit.estimate, strict=True)),
        )

    current = fit
    looks: list[Look] = []
    for step in range(MAX_EFFECTS + 1):
        tell("evidence", 1 + step, MAX_EFFECTS + 2)
        look = _look(Engine(current, weight, stated), candidates, accepted)
        looks.append(look)
        named = look.best_named
        if step == MAX_EFFECTS or named is None or not look.something_missing:
            break
        chosen = _settle(named, accepted, refit, weight, stated, candidates)
        if chosen is None:
            break
        accepted.append(chosen)
        current = refit(accepted)

    library_twins: dict[str, list[str]] = {}
    for effect in library.effects.values():
        if effect.twin_of:
            library_twins.setdefault(effect.twin_of, []).append(effect.name)
    tell("check", MAX_EFFECTS + 1, MAX_EFFECTS + 2)
    return _conclude(
        comparison,
        candidates,
        lacking,
        accepted,
        hypotheses,
        looks,
        current,
        weight,
        stated,
        refit,
        library_twins,
    )


@dataclass(frozen=True)
class Look:
    """Everything scored at one fit, with its posterior."""

    engine: Engine
    scored: list[Scored]
    mapped: list[Scored]
    probability: dict[str, float]

    @property
    def best_named(self) -> Hypothesis | None:
        """The best effect; one joint alone unless the data clearly ask for all of them."""
        names = [name for name in self.probability if name not in ("none", "novel")]
        if not names:
            return None
        top = max(names, key=self.probability.__getitem__)
        by_name = {s.name: s for s in self.scored}
        singles = [name for name in names if name.startswith(f"{top}[")]
        if singles:
            single = max(singles, key=self.probability.__getitem__)
            if by_name[single].ln_bf > by_name[top].ln_bf - _PREFER_SINGLE:
                top = single
        return by_name[top].best

    def presence(self, name: str) -> float:
        """Probability that this effect is there: at this joint (alone or with all others), or, for a
        name without joint, at any joint."""
        effect, _, joint = name.partition("[")
        return sum(
            p
            for other, p in self.probability.items()
            if other in (name, effect) or (not joint and other.startswith(f"{effect}["))
        )

    @property
    def something_missing(self) -> bool:
        rest = max(p for name, p in self.probability.items() if name != "none")
        return rest > ACCEPT_ODDS * self.probability["none"]


def _look(engine: Engine, candidates: list[Candidate], others: list[Hypothesis]) -> Look:
    taken = {h.name for h in others}
    still_open = [c for c in candidates if c.name not in taken]
    scored, mapped = engine.candidates(still_open), engine.map()
    return Look(engine, scored, mapped, _posterior(still_open, scored, mapped))


def _settle(h, accepted, refit, weight, stated, candidates) -> Hypothesis | None:
    """The named effect that still wins when everything is linearised at the fit that contains it; None
    when the unnamed (novel) wins even there, or nothing is needed."""
    for _ in range(_SETTLE_MAX):
        look = _look(Engine(refit([*accepted, h]), weight, stated, drop=h), candidates, accepted)
        winner = look.best_named
        p = look.probability
        if winner is None or look.presence(winner.name) < max(ACCEPT_ODDS * p["none"], p["novel"]):
            return None
        if winner.name == h.name and winner.constants == h.constants:
            return h
        h = winner
    return h


def _conclude(
    comparison,
    candidates,
    lacking,
    accepted,
    hypotheses,
    looks,
    current,
    weight,
    stated,
    refit,
    library_twins,
) -> Diagnosis:
    first, last = looks[0], looks[-1]
    p_family = family_p(first.engine, first.scored + first.mapped)
    # each accepted effect against everything that could stand in its place, the others kept
    kept, own = list(accepted), {}
    for h in list(accepted):
        others = [x for x in kept if x is not h]
        look = _look(Engine(current, weight, stated, drop=h), candidates, others)
        if others and look.presence(h.name) < ACCEPT_ODDS * look.probability["none"]:
            kept.remove(h)  # backward check: not needed once the others are there
            current = refit(kept)
        else:
            own[h.name] = look
    findings = [
        _finding(h, own[h.name], p_family, comparison, kept, hypotheses, current, library_twins, True)
        for h in kept
    ]
    listed = {h.effect if h.name == h.effect else h.name for h in kept}
    rivals: dict[str, tuple[float, Look]] = {}
    for look in list(own.values()) or [first]:
        for name in look.probability:
            effect = name.partition("[")[0]
            if name in ("none", "novel") or {name, effect} & listed:
                continue
            if any(other.startswith(f"{name}[") for other in (*listed, *look.probability)):
                continue  # all joints at once: counted with its joints
            same = effect in {other.partition("[")[0] for other in listed}
            p = look.probability[name] if same else look.presence(name)
            if p > rivals.get(name, (MENTION, None))[0]:
                rivals[name] = (p, look)
    for name, (_, look) in sorted(rivals.items(), key=lambda item: -item[1][0])[:8]:
        h = next(s for s in look.scored if s.name == name).best
        findings.append(
            _finding(h, look, p_family, comparison, kept, hypotheses, current, library_twins, False)
        )
    p_after = lack_of_fit(current, noise_floor(current))
    novel_p = last.probability["novel"]
    novel = _novel(last) if novel_p > ACCEPT_ODDS * last.probability["none"] or novel_p > 0.5 else None
    heat = {(s.best.locus, " x ".join(s.best.drivers)): s.ln_bf for s in first.mapped}
    absorbed = [
        NotTestable(s.name, ()) for s in first.scored if s.score.absorbed >= ABSORBED and "[" not in s.name
    ]
    return Diagnosis(
        comparison=comparison,
        verdict=_verdict(first.probability, findings, novel),
        effects=tuple(sorted(findings, key=lambda f: (-f.accepted, -f.probability))),
        novel=novel,
        not_testable=tuple(lacking + absorbed),
        probability_none=first.probability["none"],
        final=current,
        adequate_after=(p_after is None or p_after > ADEQUATE_P) and novel is None,
        map_ln_bf=heat,
    )


def _verdict(first_probability, findings, novel) -> str:
    accepted = [f for f in findings if f.accepted]
    if novel is not None:
        return "novel"
    if not accepted:
        return "adequate" if first_probability["none"] > _SURE_ENOUGH else "undecidable"
    if len(accepted) > 1:
        return "several_effects"
    return "effect" if accepted[0].probability > CLAIM else "undecidable"


def _finding(
    h, look, p_family, comparison, kept, hypotheses, current, library_twins, accepted
) -> EffectFinding:
    prob, scored, engine = look.probability, look.scored, look.engine
    mine = next(s for s in scored if s.name == h.name)
    twins = []
    for other in scored:
        if other.name == h.name or other.score.absorbed >= ABSORBED:
            continue
        effect, _, joint = other.name.partition("[")
        if effect == h.effect and (not joint or h.name == h.effect):
            continue  # the same effect, with all joints or one of them
        if prob.get(other.name, 0.0) > MENTION or _same_to_these_data(mine, other, engine.scale):
            twins.append(other.name)
    twins += [name + h.name[len(h.effect) :] for name in library_twins.get(h.effect, ())]
    before, after, interval = _held_gain(comparison, kept, h, hypotheses)
    values = _values(h, current if accepted else None)
    bic = -mine.score.chi2 / engine.scale**2 + mine.score.rank * np.log(len(engine.wz))
    where = (
        f"its pattern explains {mine.score.chi2 / max(engine.wz @ engine.wz, 1e-12):.0%} of what DH leaves"
    )
    gain = (
        f"held-out error {before * 1e3:.2f} to {after * 1e3:.2f} mm"
        if np.isfinite(after)
        else "no held-out poses"
    )
    why = f"consistent with {h.label}: {where}, {gain}, probability {look.presence(h.name):.2f}"
    return EffectFinding(
        name=h.name,
        probability=look.presence(h.name),
        p_value=p_family.get(h.name, 1.0),
        delta_bic=float(bic),
        held_rms_before_m=before,
        held_rms_after_m=after,
        held_ratio_interval=interval,
        parameters=values,
        confounded_with=tuple(twins),
        why=why,
        accepted=accepted,
    )


def _same_to_these_data(mine: Scored, other: Scored, scale: float) -> bool:
    """Whether the other effect could imitate what was found, at its fitted size: less than 9 units of
    chi^2 stay unexplained (diagnosis.md section 6)."""
    theta = _ridge(mine.columns, mine.signal, scale)
    signal = mine.columns @ theta
    left = signal - other.columns @ _ridge(other.columns, signal, scale)
    return float(left @ left) / scale**2 < _TWIN_CHI2


def _ridge(columns: np.ndarray, target: np.ndarray, scale: float) -> np.ndarray:
    inner = columns.T @ columns + (scale / LAMBDAS[-1]) ** 2 * np.eye(columns.shape[1])
    return np.linalg.solve(inner, columns.T @ target)


def _values(h: Hypothesis, fit: Fit | None) -> tuple[ParameterValue, ...]:
    if fit is None:
        return ()
    out = []
    for p in h.parameters:
        k = fit.names.index(f"{h.name}.{p.name}")
        out.append(ParameterValue(p.name, float(fit.estimate[k]), float(fit.std_err[k]), p.unit))
    return tuple(out)


def _held_gain(comparison: Comparison, kept, h, hypotheses) -> tuple[float, float, tuple[float, float]]:
    """Held-out position RMS without and with this effect (the other accepted ones in both), and a
    bootstrap interval of the ratio over held-out poses."""
    split = comparison.split
    if not len(split.held):
        return float("nan"), float("nan"), (float("nan"), float("nan"))
    part_fit = comparison.fit_part
    arm, part = part_fit.chain.arm, part_fit.chain.data
    frames = (part_fit.base, part_fit.tool)
    held = comparison.held_data
    others = [x for x in kept if x.name != h.name]
    without = fit_model(arm, part, [*hypotheses, *others], frames=frames).predict(held)
    with_it = fit_model(arm, part, [*hypotheses, *others, h], frames=frames).predict(held)
    rng = np.random.default_rng(2)
    pick = rng.integers(0, len(without), (_BOOTSTRAP, len(without)))
    a = (without[:, :3] ** 2).sum(axis=1)
    b = (with_it[:, :3] ** 2).sum(axis=1)
    ratio = np.sqrt(b[pick].mean(axis=1) / a[pick].mean(axis=1))
    return (
        rms(without)[0],
        rms(with_it)[0],
        (float(np.quantile(ratio, 0.025)), float(np.quantile(ratio, 0.975))),
    )


def _novel(look: Look) -> NovelFinding:
    top = max(look.mapped, key=lambda s: s.ln_bf)
    p = family_p(look.engine, look.mapped)[top.name]
    cell: Cell = top.best
    return NovelFinding(
        locus=cell.locus,
        depends_on=tuple(cell.drivers),
        suggested_terms=suggest_terms(cell, look.engine),
        p_value=p,
        probability=look.probability["novel"],
    )


def suggest_terms(cell: Cell, engine: Engine, count: int = 3) -> tuple[str, ...]:
    """Simple bases, alone or as a product, that imitate the cell's function best, as TOML lines."""
    from .basis import parse_basis

    if not cell.locus.startswith("joint"):
        return tuple(f'at = "{cell.locus}", a function of {d}' for d in cell.drivers)
    joint = int(cell.locus.split()[1])
    forms = []
    for driver in cell.drivers:
        if driver[0] == "q" and driver[1:].isdigit():
            forms.append([driver, f"sin({driver})", f"cos({driver})", f"sin(2*{driver})", f"cos(2*{driver})",
                          f"tanh({driver})"])  # fmt: skip
        elif driver.startswith("tau"):
            forms.append([driver, f"tanh({driver}/1.0)"])
        else:
            forms.append([driver] if driver != "order" else ["t"])
    products = (
        list(forms[0])
        if len(forms) == 1
        else [f"{a} * {b}" for a in forms[0] for b in forms[1]] + sum(forms, [])
    )
    from .effects import Term

    frame = joint - 1
    comp = 2 if engine.columns.fit.chain.arm.joints[joint - 1].prismatic else 5
    ranked = []
    for text in products:
        try:
            basis = parse_basis(text, {}, "suggestion")
        except BadInput:  # a driver without a basis of its own suggests nothing
            continue
        column = engine.columns.rows_of(engine.columns.term(Term(frame, comp, 1.0, basis)))[:, None]
        s, _, _ = engine.score(column * 1e-3)
        ranked.append((s.chi2, text))
    ranked.sort(reverse=True)
    return tuple(f'at = "joint[{joint}]", basis = "{text}"' for _, text in ranked[:count])
