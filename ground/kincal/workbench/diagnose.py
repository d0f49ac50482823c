"""Which physical effect is missing: evidence for every effect and joint, with honest probabilities.

docs/DIAGNOSIS.md gives the mathematics. The probabilities are conditional on the library and on the
priors stated here; wording is "consistent with", never "proven".
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field, replace

import numpy as np

from kincal.errors import BadInput

from .arms import ArmTable
from .basis import parse_basis
from .chain import MAX_COEF, MAX_TERM
from .compare import (
    ADEQUATE_P,
    Comparison,
    NoiseFloor,
    Where,
    compare,
    lack_of_fit,
    noise_floor,
    where_it_fails,
)
from .data import Measurements
from .effects import Hypothesis, Library, Term, finer
from .engine import (
    PRIOR_NONE,
    PRIOR_NOVEL,
    Candidate,
    Engine,
    Scored,
    build_candidates,
    family_p,
    merged,
    robust_weights,
    unknown,
)
from .evidence import LAMBDAS, posterior
from .fit import Fit, fit_model, rms
from .novel import Cell
from .power import TWIN_CHI2

ACCEPT_ODDS = 9.0
CLAIM = 0.9
MENTION = 0.05
ABSORBED = 0.995
MAX_EFFECTS = 5
_SURE_ENOUGH = 0.2  # nothing was accepted and 'none' is not far behind
_SETTLE_MAX = 4
_PREFER_SINGLE = np.log(10.0)
_HELP_TRIES = 4  # named effects tried at each step when something unnamed wins
_MAX_RIVALS = 8
_BOOTSTRAP = 1000


@dataclass(frozen=True)
class ParameterValue:
    name: str
    value: float
    std_err: float
    unit: str


@dataclass(frozen=True)
class EffectFinding:
    """One named effect with its probability.

    accepted: it won against nothing and against the unnamed; helps: it did not win, but held-out poses
    are predicted better with it (the interval of the ratio excludes 1). Both kinds are part of the final
    model; the rest are rivals.
    """

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
    helps: bool = False


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
class Remainder:
    """What the final model leaves: held-out error beside the noise floor, and where it lives."""

    held_pos_m: float
    held_rot_rad: float | None
    floor: NoiseFloor
    where: tuple[Where, ...]


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
    remainder: Remainder
    map_ln_bf: dict[tuple[str, str], float] = field(default_factory=dict)


@dataclass(frozen=True)
class Look:
    """Everything scored at one fit, with its posterior; unknown: the cells that no effect describes."""

    engine: Engine
    scored: list[Scored]
    mapped: list[Scored]
    unknown: list[Scored]
    probability: dict[str, float]

    def named(self, room: int = MAX_COEF) -> list[str]:
        """Effects by probability, best first, that need no more coefficients than there is room for."""
        size = {s.name: len(s.best.parameters) for s in self.scored}
        names = [n for n in self.probability if n not in ("none", "novel") and size[n] <= room]
        return sorted(names, key=lambda n: -self.probability[n])

    def best(self, room: int = MAX_COEF) -> Hypothesis | None:
        """The best effect; one joint alone unless the data clearly ask for all of them."""
        names = self.named(room)
        if not names:
            return None
        top = names[0]
        by_name = {s.name: s for s in self.scored}
        single = next((name for name in names if name.startswith(f"{top}[")), None)
        if single and by_name[single].ln_bf > by_name[top].ln_bf - _PREFER_SINGLE:
            top = single
        return by_name[top].best

    def one_joint(self, h: Hypothesis) -> Hypothesis | None:
        """For an effect at all joints: the joint that explains the data as well alone, if there is one."""
        if h.name != h.effect:
            return None
        by_name = {s.name: s for s in self.scored}
        single = max(
            (s for s in self.scored if s.name.startswith(f"{h.name}[")), key=lambda s: s.ln_bf, default=None
        )
        if single is None or single.ln_bf < by_name[h.name].ln_bf - _PREFER_SINGLE:
            return None
        return single.best

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
    def novel_wins(self) -> bool:
        """Something is missing, and what no effect describes is more likely than each effect."""
        p = self.probability.get("novel", 0.0)
        rival = max((self.presence(n) for n in self.probability if n not in ("none", "novel")), default=0.0)
        return p > ACCEPT_ODDS * self.probability["none"] and p > rival

    @property
    def something_missing(self) -> bool:
        rest = max(p for name, p in self.probability.items() if name != "none")
        return rest > ACCEPT_ODDS * self.probability["none"]


def _key(hypotheses) -> tuple:
    return tuple((h.name, h.constants) for h in hypotheses)


def _posterior(candidates: list[Candidate], scored: list[Scored], cells: list[Scored]) -> dict[str, float]:
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
    if cells:
        single = [s.ln_bf for s in cells if len(s.best.drivers) == 1]
        double = [s.ln_bf for s in cells if len(s.best.drivers) == 2]
        parts = [np.logaddexp.reduce(x) - np.log(len(x)) for x in (single, double) if x]
        ln_bf["novel"] = float(np.logaddexp.reduce(parts) - np.log(len(parts)))
        prior["novel"] = PRIOR_NOVEL
    return posterior(ln_bf, prior)


class _Search:
    """One diagnosis on its way: what does not change (data, candidates, weights), and the steps."""

    def __init__(
        self, comparison: Comparison, library: Library, given: tuple[Hypothesis, ...], dh: bool
    ) -> None:
        self.comparison, self.given, self.dh = comparison, given, dh
        self.base = comparison.fit_all
        self.arm, self.data = self.base.chain.arm, self.base.chain.data
        used = {h.name for h in given}
        self.library = library
        self.candidates, self.lacking = build_candidates(self.arm, self.data, library, used)
        self.weight = robust_weights(self.base, self.candidates)
        self.stated = self.data.cov is not None
        self.twins: dict[str, list[str]] = {}
        for effect in library.effects.values():
            if effect.twin_of:
                self.twins.setdefault(effect.twin_of, []).append(effect.name)
        self.closer: dict[str, list[Hypothesis]] = {}  # effects whose constant was searched closer
        self._held: dict[tuple[str, ...], np.ndarray] = {}
        self._fits: dict[tuple[str, ...], Fit] = {(): self.base}
        self._looks: dict[tuple, Look] = {}

    def refit(self, extra: list[Hypothesis]) -> Fit:
        key = _key(extra)
        if key not in self._fits:
            start = dict(zip(self.base.names, self.base.estimate, strict=True))
            frames = (self.base.base, self.base.tool)
            self._fits[key] = fit_model(
                self.arm, self.data, [*self.given, *extra], dh=self.dh, frames=frames, start=start
            )
        return self._fits[key]

    def room(self, fit: Fit) -> int:
        """Coefficients that flight's table still has room for."""
        return 0 if fit.terms.n_term >= MAX_TERM else MAX_COEF - len(fit.names)

    def look(self, fit: Fit, others: list[Hypothesis], drop: Hypothesis | None = None) -> Look:
        key = (_key(fit.hypotheses), _key(others), drop and drop.name)
        if key not in self._looks:
            self._looks[key] = self._look(fit, others, drop)
        return self._looks[key]

    def _look(self, fit: Fit, others: list[Hypothesis], drop: Hypothesis | None) -> Look:
        engine = Engine(fit, self.weight, self.stated, drop=drop)
        taken = {h.name for h in others}
        # an effect that is in at all joints has nothing to add at one of them
        still_open = [c for c in self.candidates if c.name not in taken and c.effect.name not in taken]
        if drop and drop.name in self.closer:
            tried = self.closer[drop.name]
            still_open = [c.closer(tried) if c.name == drop.name else c for c in still_open]
        scored, mapped = engine.candidates(still_open), engine.map()
        cells = unknown(mapped, scored)
        return Look(engine, scored, mapped, cells, _posterior(still_open, scored, cells))

    def settle(self, h: Hypothesis, accepted: list[Hypothesis]) -> Hypothesis | None:
        """The named effect that still wins when everything is linearised at the fit that contains it; None
        when the unnamed (novel) wins even there, or nothing is needed."""
        for _ in range(_SETTLE_MAX):
            h = self.sharpen(h, accepted)
            fit = self.refit([*accepted, h])
            look = self.look(fit, accepted, drop=h)
            winner = look.best(self.room(fit) + len(h.parameters))
            p = look.probability
            if winner is None or look.presence(winner.name) < max(ACCEPT_ODDS * p["none"], p["novel"]):
                return None
            if winner.name == h.name and winner.constants == h.constants:
                return h
            h = winner
        return h

    def sharpen(self, h: Hypothesis, others: list[Hypothesis]) -> Hypothesis:
        """The effect with its constant searched closer than the grid has it: of a large effect even a small
        error of its moment or period leaves something that looks like another effect."""
        for constant, values in self.library.grid_of(h.name).items():
            fixed = dict(h.constants)
            tried = []
            for value in finer(values, fixed[constant], self.data):
                found = self.library.find(h.name, self.arm, self.data, {**fixed, constant: value})
                tried.append(
                    merged(self.library.effects[h.effect], found) if h.name == h.effect and len(found) > 1
                    else found[0]
                )  # fmt: skip
            if tried:
                engine = Engine(self.refit([*others, h]), self.weight, self.stated, drop=h)
                scored = engine.scores([engine.columns.hypothesis(x) for x in tried])
                h = tried[int(np.argmax([ln_bf for _, ln_bf in scored]))]
                self.closer[h.name] = tried
        return h

    def pair(
        self, look: Look, fit: Fit, first: Hypothesis | None, kept: list[Hypothesis]
    ) -> tuple[Hypothesis, Hypothesis] | None:
        """Two named effects that together beat the unnamed that beats each of them alone: two effects at
        one joint look like one unknown function of both their drivers."""
        if first is None or len(kept) + 2 > MAX_EFFECTS:
            return None
        beside = self.look(self.refit([*kept, first]), [*kept, first])
        second = beside.best(self.room(fit) - len(first.parameters))
        p, q = look.probability, beside.probability
        if second is None or p[first.name] * q[second.name] < ACCEPT_ODDS * p.get("novel", 0.0) * q["none"]:
            return None
        settled = self.settle(second, [*kept, first])
        again = settled and self.settle(first, [*kept, settled])
        return (again, settled) if again else None

    def held_square(self, extra: list[Hypothesis]) -> np.ndarray:
        """(M,) squared position error of the held-out poses, the model fitted to the others only."""
        key = _key(extra)
        if key not in self._held:
            part = self.comparison.fit_part
            fit = fit_model(
                self.arm, part.chain.data, [*self.given, *extra], dh=self.dh, frames=(part.base, part.tool)
            )
            self._held[key] = (fit.predict(self.comparison.held_data)[:, :3] ** 2).sum(axis=1)
        return self._held[key]

    def held_gain(self, kept: list[Hypothesis], h: Hypothesis) -> tuple[float, float, tuple[float, float]]:
        """Held-out position RMS without and with this effect (the other kept ones in both), and a 95 %
        bootstrap interval of the ratio over held-out poses."""
        if not len(self.comparison.split.held):
            return float("nan"), float("nan"), (float("nan"), float("nan"))
        others = [x for x in kept if x.name != h.name]
        a, b = self.held_square(others), self.held_square([*others, h])
        pick = np.random.default_rng(2).integers(0, len(a), (_BOOTSTRAP, len(a)))
        ratio = np.sqrt(b[pick].mean(axis=1) / np.maximum(a[pick].mean(axis=1), 1e-300))
        interval = (float(np.quantile(ratio, 0.025)), float(np.quantile(ratio, 0.975)))
        return float(np.sqrt(a.mean())), float(np.sqrt(b.mean())), interval

    def helpful(self, look: Look, fit: Fit, kept: list[Hypothesis]) -> Hypothesis | None:
        """The most probable named effect that held-out poses are predicted better with, although
        something unnamed explains more. The data have to ask for it beside the unnamed: a mere cousin of
        that explains nothing more once it is granted."""
        if not len(self.comparison.split.held):
            return None
        best = {s.name: s.best for s in look.scored}
        prior = {c.name: c.prior for c in self.candidates}
        named = look.named(self.room(fit))[:_HELP_TRIES]
        unnamed = max(look.unknown, key=lambda s: s.ln_bf)
        engine = Engine(fit, self.weight, self.stated, granted=unnamed.block)
        scored = engine.scores([engine.columns.hypothesis(best[name]) for name in named])
        for name, (_, ln_bf) in zip(named, scored, strict=True):
            odds = np.log(prior[name] / PRIOR_NONE) + ln_bf
            if odds > np.log(ACCEPT_ODDS) and self.held_gain(kept, best[name])[2][1] < 1.0:
                return best[name]
        return None


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
    steps = MAX_EFFECTS + 3
    tell("fit", 0, steps)
    comparison = compare(arm, data, hypotheses, dh=dh)
    search = _Search(comparison, library, tuple(hypotheses), dh)
    current, kept = search.base, []
    tell("evidence", 1, steps)
    first = look = search.look(current, kept)
    while len(kept) < MAX_EFFECTS and look.something_missing:
        named = look.best(search.room(current))
        chosen = None if named is None else search.settle(named, kept)
        if chosen is None and (both := search.pair(look, current, named, kept)):
            kept.append(both[0])
            chosen = both[1]
        chosen = chosen or search.helpful(look, current, kept)
        if chosen is None:
            break
        kept = [h for h in kept if h.effect != chosen.name] + [chosen]  # at all joints: instead of at one
        tell(f"evidence beside {chosen.name}", 1 + len(kept), steps)
        current = search.refit(kept)
        look = search.look(current, kept)
    tell("check", steps - 1, steps)
    return _conclude(search, kept, first, look, current)


def _conclude(search: _Search, kept: list[Hypothesis], first: Look, last: Look, current: Fit) -> Diagnosis:
    p_family = family_p(first.engine, first.scored + first.mapped)
    # Each effect against everything that could stand in its place, the others kept. One that was only
    # taken for its help wins here if what stood against it was another missing effect in disguise.
    kept, own, role = list(kept), {}, {}
    for h in list(kept):
        look = search.look(current, [x for x in kept if x is not h], drop=h)
        one = look.one_joint(h)
        if one is not None:  # beside the others one joint is enough
            kept[kept.index(h)] = h = one
            current = search.refit(kept)
            look = search.look(current, [x for x in kept if x is not h], drop=h)
        winner = look.best(search.room(current) + len(h.parameters))
        if winner and look.presence(winner.name) > ACCEPT_ODDS * look.presence(h.name):
            # it was taken before the others were there; beside them something else fits far better
            kept[kept.index(h)] = h = winner
            current = search.refit(kept)
            look = search.look(current, [x for x in kept if x is not h], drop=h)
        p = look.probability
        wins = look.presence(h.name) >= max(ACCEPT_ODDS * p["none"], p.get("novel", 0.0))
        if wins or search.held_gain(kept, h)[2][1] < 1.0:
            own[h.name], role[h.name] = look, "accepted" if wins else "helps"
        else:
            kept.remove(h)  # backward check: not needed once the others are there
            current = search.refit(kept)
    if last.novel_wins:  # a named cousin of the unnamed often wins a place; it has to prove itself
        doubtful = [h for h in kept if not search.held_gain(kept, h)[2][1] < 1.0]
        if doubtful and len(search.comparison.split.held):
            kept = [h for h in kept if h not in doubtful]
            current = search.refit(kept)
            last = search.look(current, kept)
    p_after = lack_of_fit(current, noise_floor(current))
    novel = _novel(last) if last.novel_wins else None
    adequate = (p_after is None or p_after > ADEQUATE_P) and novel is None
    findings = [
        _finding(search, h, own[h.name], p_family, kept, current, role[h.name], adequate) for h in kept
    ]
    names = {h.name for h in kept}
    findings += [
        _finding(search, h, look, p_family, kept, None, "rival", adequate)
        for h, look in _rivals(names, list(own.values()) or [first])
    ]
    order = {"accepted": 0, "helps": 1, "rival": 2}
    findings.sort(
        key=lambda f: (order["accepted" if f.accepted else "helps" if f.helps else "rival"], -f.probability)
    )
    return Diagnosis(
        comparison=search.comparison,
        verdict=_verdict(first.probability, findings, novel),
        effects=tuple(findings),
        novel=novel,
        not_testable=_not_testable(search, first),
        probability_none=first.probability["none"],
        final=current,
        adequate_after=adequate,
        remainder=_remainder(search, kept, current),
        map_ln_bf={(s.best.locus, " x ".join(s.best.drivers)): s.ln_bf for s in first.mapped},
    )


def _not_testable(search: _Search, first: Look) -> tuple[NotTestable, ...]:
    """Effects that lack a column or a key, whose columns do not vary, or that the fit imitates exactly."""
    out = [NotTestable(*row) for row in search.lacking]
    needs = {c.name: c.effect.needs for c in search.candidates}
    for s in first.scored:
        if s.score.absorbed >= ABSORBED and "[" not in s.name:
            still = [n for n in needs[s.name] if search.data.constant(n)] if not s.block.any() else []
            out.append(NotTestable(s.name, tuple(f"{n} that varies" for n in still)))
    return tuple(out)


def _rivals(kept: set[str], looks: list[Look]) -> list[tuple[Hypothesis, Look]]:
    """Effects outside the model that keep a probability worth a mention, most probable first."""
    effects = {name.partition("[")[0] for name in kept}
    found: dict[str, tuple[float, Look]] = {}
    for look in looks:
        for name, p in look.probability.items():
            effect = name.partition("[")[0]
            if name in ("none", "novel") or name in kept or effect in kept:
                continue
            if name == effect and effect in effects:
                continue  # the same effect at all joints: counted with its joint
            if p > found.get(name, (MENTION, None))[0]:
                found[name] = (p, look)
    best = sorted(found.items(), key=lambda item: -item[1][0])[:_MAX_RIVALS]
    return [(next(s for s in look.scored if s.name == name).best, look) for name, (_, look) in best]


def _remainder(search: _Search, kept: list[Hypothesis], current: Fit) -> Remainder:
    held = search.comparison.held_data
    position, rotation = float("nan"), None
    if held is not None:
        part = search.comparison.fit_part
        frames = (part.base, part.tool)
        fit = fit_model(search.arm, part.chain.data, [*search.given, *kept], dh=search.dh, frames=frames)
        position, rotation = rms(fit.predict(held))
    return Remainder(position, rotation, search.comparison.noise_floor, where_it_fails(current)[:3])


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
    search: _Search,
    h: Hypothesis,
    look: Look,
    p_family: dict[str, float],
    kept: list[Hypothesis],
    fit: Fit | None,
    role: str,
    adequate: bool,
) -> EffectFinding:
    engine = look.engine
    mine = next(s for s in look.scored if s.name == h.name)
    twins = (
        _twins(search, h, look, mine)
        if role != "rival" or mine.score.chi2 > TWIN_CHI2 * engine.scale**2
        else []
    )
    before, after, interval = search.held_gain(kept, h)
    probability = look.probability.get(h.name, 0.0) if role == "rival" else look.presence(h.name)
    # While the model with it does not explain the data, a name may be a cousin of what is missing: its
    # posterior holds only if the truth is among the names, so it is stated no surer than a claim needs.
    unsure = role == "accepted" and not adequate and probability > CLAIM
    probability = CLAIM if unsure else probability
    share = mine.score.chi2 / max(float(engine.wz @ engine.wz), 1e-12)
    gain = "no held-out poses"
    if np.isfinite(after):
        gain = f"held-out error {before * 1e3:.3f} to {after * 1e3:.3f} mm"
    why = (
        f"consistent with {h.label}: its pattern explains {share:.0%} of what the model without it leaves, "
        f"{gain}, probability {probability:.2f}"
    )
    if role == "helps":
        why += "; something unnamed explains more, but held-out poses gain"
    if unsure:
        why += "; the model with it does not explain the data yet, so it is not identified"
    return EffectFinding(
        name=h.name,
        probability=probability,
        p_value=p_family.get(h.name, 1.0),
        delta_bic=float(-mine.score.chi2 / engine.scale**2 + mine.score.rank * np.log(len(engine.wz))),
        held_rms_before_m=before,
        held_rms_after_m=after,
        held_ratio_interval=interval,
        parameters=_values(h, fit),
        confounded_with=tuple(twins),
        why=why,
        accepted=role == "accepted",
        helps=role == "helps",
    )


def _twins(search: _Search, h: Hypothesis, look: Look, mine: Scored) -> list[str]:
    """Effects that these data cannot tell from this one, and those that no data can."""
    out = []
    for other in look.scored:
        if other.name == h.name or other.score.absorbed >= ABSORBED:
            continue
        effect, _, joint = other.name.partition("[")
        if effect == h.effect and (not joint or h.name == h.effect):
            continue  # the same effect, with all joints or one of them
        likely = look.probability.get(other.name, 0.0) > MENTION
        if likely or _same_to_these_data(mine, other, look.engine.scale):
            out.append(other.name)
    out += [name for name in _moved_frames(h, look, mine) if name not in out]
    alone = {name.partition("[")[0] for name in out if "[" in name}
    out = [name for name in out if name not in alone]  # at all joints says no more than at one of them
    return out + [name + h.name[len(h.effect) :] for name in search.twins.get(h.effect, ())]


def _moved_frames(h: Hypothesis, look: Look, mine: Scored) -> list[str]:
    """A base turned and shifted at once imitates a moved camera that never turns; neither alone does."""
    group = [s for s in look.scored if s.name in ("base_tilt", "base_shift")]
    if h.name in ("base_tilt", "base_shift") or len(group) < 2:
        return []
    both = replace(group[0], block=np.hstack([s.block for s in group]))
    return [s.name for s in group] if _same_to_these_data(mine, both, look.engine.scale) else []


def _same_to_these_data(mine: Scored, other: Scored, scale: float) -> bool:
    """Whether the other effect could imitate what was found, at its fitted size: less than 9 units of
    chi^2 stay unexplained (diagnosis.md section 6)."""
    theta = _ridge(mine.columns, mine.signal, scale)
    signal = mine.columns @ theta
    left = signal - other.columns @ _ridge(other.columns, signal, scale)
    return float(left @ left) / scale**2 < TWIN_CHI2


def _ridge(columns: np.ndarray, target: np.ndarray, scale: float) -> np.ndarray:
    inner = columns.T @ columns + (scale / max(LAMBDAS)) ** 2 * np.eye(columns.shape[1])
    return np.linalg.solve(inner, columns.T @ target)


def _values(h: Hypothesis, fit: Fit | None) -> tuple[ParameterValue, ...]:
    if fit is None:
        return ()
    out = []
    for p in h.parameters:
        k = fit.names.index(f"{h.name}.{p.name}")
        out.append(ParameterValue(p.name, float(fit.estimate[k]), float(fit.std_err[k]), p.unit))
    return tuple(out)


def _novel(look: Look) -> NovelFinding:
    top = max(look.unknown, key=lambda s: s.ln_bf)
    cell: Cell = top.best
    return NovelFinding(
        locus=cell.locus,
        depends_on=tuple(cell.drivers),
        suggested_terms=suggest_terms(cell, look.engine),
        p_value=family_p(look.engine, look.mapped)[top.name],
        probability=look.probability["novel"],
    )


def suggest_terms(cell: Cell, engine: Engine, count: int = 3) -> tuple[str, ...]:
    """Simple bases, alone or as a product, that imitate the cell's function best, as TOML lines."""
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
    frame = joint - 1
    comp = 2 if engine.columns.fit.chain.arm.joints[joint - 1].prismatic else 5
    ranked = []
    for text in products:
        try:
            basis = parse_basis(text, {}, "suggestion")
        except BadInput:  # a driver without a basis of its own suggests nothing
            continue
        column = engine.columns.rows_of(engine.columns.term(Term(frame, comp, 1.0, basis)))[:, None]
        ranked.append((engine.score(column * 1e-3).chi2, text))
    ranked.sort(reverse=True)
    return tuple(f'at = "joint[{joint}]", basis = "{text}"' for _, text in ranked[:count])
