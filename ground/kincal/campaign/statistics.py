"""What the cases of a campaign show: shares and quantiles with exact bounds, requirements, influences.

Bounds of shares are Clopper and Pearson's: they hold for any number of cases, also where none or all succeed.
Bounds of quantiles are order statistics, by the same binomial distribution. A case that died met no
requirement, whatever it is given for: nobody knows what it would have come to."""

from __future__ import annotations

import re
import shlex
from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy import stats

from kincal_shared import installation
from kincal_shared.errors import BadInput
from kincal_shared.schema.campaign import ALL, OUTCOME, Condition, Requirement

from .function import DIED, DISPERSED
from .store import Results, Row, is_outcome

Floats = NDArray[np.float64]
CONFIDENCE = 0.95  # two-sided, of what is no requirement
WORST = 20
QUANTILES = (0.05, 0.5, 0.95, 0.99)
SHOWN = ("before_pos_m", "after_pos_m", "after_rot_rad", "proposed_pos_m", "poses", "mission_s", "p_fit")
_NUMBER = re.compile(r"(?<![\w.])-?\d+(\.\d+)?(e-?\d+)?")
PASS, FAIL, OPEN = "pass", "fail", "not shown"


# ---- shares, requirements


@dataclass(frozen=True)
class Share:
    """k of n, with its bounds."""

    k: int
    n: int
    low: float
    high: float

    @property
    def value(self) -> float:
        """The share itself; nan of nothing."""
        return self.k / self.n if self.n else float("nan")


def share(k: int, n: int, confidence: float = CONFIDENCE) -> Share:
    """A share with its two-sided bounds of Clopper and Pearson."""
    if n == 0:
        return Share(0, 0, 0.0, 1.0)
    found = stats.binomtest(k, n).proportion_ci(confidence, method="exact")
    return Share(k, n, float(found.low), float(found.high))


@dataclass(frozen=True)
class Evaluated:
    """A requirement and what the cases say. low, high: one-sided bounds of the probability, each at the
    confidence of the requirement; verdict: pass (low reaches the probability asked for), fail (high does
    not), or not shown; needed: cases without a single failure that would show it."""

    requirement: Requirement
    share: Share
    low: float
    high: float
    verdict: str
    needed: int
    died: int


def evaluate(
    requirement: Requirement, outcomes: Sequence[Row], columns: Mapping[str, type] = OUTCOME
) -> Evaluated:
    """Whether the cases show that a requirement is met. columns: that its conditions may name."""
    holds = Condition(requirement.holds, columns)
    given = None if requirement.given == ALL else Condition(requirement.given, columns)
    n = k = died = 0
    for outcome in outcomes:
        dead = outcome["ended"] == DIED
        if not dead and given is not None and not given.holds(outcome):
            continue
        n, died = n + 1, died + dead
        k += not dead and holds.holds(outcome) is True
    c, p = requirement.confidence, requirement.probability
    low = float(stats.beta.ppf(1.0 - c, k, n - k + 1)) if k else 0.0
    high = float(stats.beta.ppf(c, k + 1, n - k)) if k < n else 1.0
    verdict = PASS if low >= p else FAIL if high < p else OPEN
    needed = int(np.ceil(np.log1p(-c) / np.log(p)))
    return Evaluated(requirement, share(k, n), low, high, verdict, needed, died)


# ---- distributions


@dataclass(frozen=True)
class Quantile:
    """A quantile with order statistics as its bounds; inf where there are too few cases for one."""

    p: float
    value: float
    low: float
    high: float


@dataclass(frozen=True)
class Distribution:
    """A column of the outcome. values: sorted (n,); missing: cases that have none."""

    column: str
    values: Floats
    missing: int
    quantiles: tuple[Quantile, ...]

    def bounds(self, confidence: float = CONFIDENCE) -> tuple[Floats, Floats]:
        """(n,) bounds of the share of cases up to each value, Clopper and Pearson's."""
        n, k = len(self.values), np.arange(1, len(self.values) + 1)
        tail = 0.5 * (1.0 - confidence)
        high = np.ones(n)
        high[:-1] = stats.beta.ppf(1.0 - tail, k[:-1] + 1, n - k[:-1])
        return np.array(stats.beta.ppf(tail, k, n - k + 1), float), high


def distribution(column: str, values: Sequence[float | None]) -> Distribution:
    """Of a column, with its quantiles."""
    known = np.sort([float(v) for v in values if v is not None and v == v])
    return Distribution(column, known, len(values) - len(known), tuple(_quantiles(known)))


def _quantiles(values: Floats) -> Iterator[Quantile]:
    n, tail = len(values), 0.5 * (1.0 - CONFIDENCE)
    for p in QUANTILES if n else ():
        below = int(stats.binom.ppf(tail, n, p))  # rank, from 1; 0: no value is surely below
        above = int(stats.binom.ppf(1.0 - tail, n, p)) + 1
        low = float(values[below - 1]) if below >= 1 else -float("inf")
        high = float(values[above - 1]) if above <= n else float("inf")
        yield Quantile(p, float(np.quantile(values, p, method="inverted_cdf")), low, high)


# ---- influences


@dataclass(frozen=True)
class Influence:
    """How an outcome goes with a dispersed value. rank: Spearman's correlation with the value; size: with its
    distance from the median, because an error of either sign is one, and None of a key with two values,
    which says nothing else there; p: probability of the larger of the two by chance, times the number of
    correlations that were tried; sobol: first-order Sobol index with its confidence, if asked for."""

    key: str
    rank: float
    size: float | None
    p: float
    sobol: tuple[float, float] | None = None

    @property
    def strength(self) -> float:
        """What they are ordered by."""
        return max(abs(self.rank), abs(self.size or 0.0))


def influences(results: Results, column: str, sobol: bool = False) -> tuple[Influence, ...]:
    """Of all dispersed numbers on a column of the outcome, the strongest first. BadInput if there are too few
    cases for Sobol indices."""
    keys, X, y = _numbers(results, column)
    if len(y) < 4 or not keys or np.ptp(y) == 0.0:
        return ()
    indices = _sobol(keys, X, y) if sobol else {}
    sized = [len(np.unique(x)) > 2 for x in X.T]
    tries, found = len(keys) + sum(sized), []
    for key, x, is_sized in zip(keys, X.T, sized, strict=True):
        tests = [stats.spearmanr(x, y)]
        if is_sized:
            tests.append(stats.spearmanr(np.abs(x - np.median(x)), y))
        p = min(1.0, tries * min(float(test.pvalue) for test in tests))
        rank, size = float(tests[0].statistic), float(tests[1].statistic) if is_sized else None
        found.append(Influence(key, rank, size, p, indices.get(key)))
    return tuple(sorted(found, key=lambda one: -one.strength))


def _numbers(results: Results, column: str) -> tuple[list[str], Floats, Floats]:
    """Keys with more than one number, their values (n, keys), and the outcome (n,), of cases that have
    one."""
    y = np.array([np.nan if v is None else float(v) for v in results.columns[column]])
    use = np.isfinite(y)
    columns = {}
    for key in results.plan.keys:
        values = results.columns[DISPERSED + key]
        if all(isinstance(v, (int, float)) for v in values):
            x = np.array(values, float)[use]
            if len(x) and np.ptp(x) > 0.0:
                columns[key] = x
    X = np.array(list(columns.values()), float).reshape(len(columns), int(use.sum())).T
    return list(columns), X, y[use]


def _sobol(keys: list[str], X: Floats, y: Floats) -> dict[str, tuple[float, float]]:
    """First-order Sobol indices by RBD-FAST, which takes any independent sample."""
    installation.require("campaign", "a Sobol index")
    from SALib.analyze import rbd_fast

    harmonics = 10
    if len(y) <= 4 * harmonics**2 // 2:
        todo = f"fly more than {2 * harmonics**2} cases, or leave --sobol out"
        raise BadInput(f"{len(y)} cases are too few for Sobol indices", todo=todo)
    bounds = [[float(x.min()), float(x.max())] for x in X.T]
    problem = {"num_vars": len(keys), "names": keys, "bounds": bounds}
    found = rbd_fast.analyze(problem, X, y, M=harmonics, num_resamples=100, seed=1)
    return {k: (float(s), float(c)) for k, s, c in zip(keys, found["S1"], found["S1_conf"], strict=True)}


# ---- the whole


@dataclass(frozen=True)
class Bad:
    """One of the worst cases, with the command that flies it again."""

    index: int
    seed: int
    ended: str
    reason: str
    value: float | None
    command: str


@dataclass(frozen=True)
class Report:
    """A campaign in numbers. column: the outcome by which cases are good or bad; "": none is a number."""

    results: Results
    column: str
    died: int
    ends: tuple[tuple[str, Share], ...]
    requirements: tuple[Evaluated, ...]
    distributions: tuple[Distribution, ...]
    influences: tuple[Influence, ...]
    worst: tuple[Bad, ...]

    @property
    def complete(self) -> bool:
        """Whether all cases of the campaign were flown."""
        return self.results.n == self.results.plan.spec.cases

    @property
    def ok(self) -> bool:
        """Whether all is flown, and every requirement is shown to be met."""
        return self.complete and all(r.verdict == PASS for r in self.requirements)


def report(results: Results, column: str = "", sobol: bool = False) -> Report:
    """What the cases show. column: number by which they are good or bad ("": after_pos_m; of a function, its
    first number, or none if it gave none). BadInput if there is no number of that name in an outcome."""
    numbers = [name for name in results.columns if is_outcome(name) and _is_number(results, name)]
    if column and column not in numbers:
        known = f"known: {', '.join(numbers)}" if numbers else "no case gave a number; leave it out"
        raise BadInput(f"an outcome has no number {column!r}", "--outcome", known)
    column = column or ("after_pos_m" if "after_pos_m" in numbers else next(iter(numbers), ""))
    outcomes, spec = list(results.outcomes()), results.plan.spec
    alive = [o for o in outcomes if o["ended"] != DIED]
    for name in spec.columns:
        if alive and all(o.get(name) is None for o in alive):
            todo = "change the function, or [columns] of the campaign"
            raise BadInput(f"no case has a value of the column {name!r}", str(results.folder), todo)
    ends = Counter(_NUMBER.sub("…", _end(o)) for o in outcomes)  # alike but for their numbers: the same end
    as_first = {_NUMBER.sub("…", end): end for end in map(_end, reversed(outcomes))}
    first = (column,) if column else ()
    shown = dict.fromkeys((*first, *(name for name in SHOWN if name in numbers)))
    return Report(
        results,
        column,
        sum(o["ended"] == DIED for o in outcomes),
        tuple((as_first[end], share(k, len(outcomes))) for end, k in ends.most_common()),
        tuple(evaluate(r, outcomes, spec.outcome) for r in spec.requirement),
        tuple(distribution(name, results.columns[name]) for name in shown),
        influences(results, column, sobol) if column else (),
        tuple(_worst(results, column)),
    )


def _is_number(results: Results, column: str) -> bool:
    if column in OUTCOME and not results.plan.spec.function:
        return OUTCOME[column] in (float, int)
    return any(type(value) in (float, int) for value in results.columns[column])


def _end(outcome: Row) -> str:
    words = (outcome["ended"], outcome.get("verdict"), outcome["reason"])
    return ": ".join(str(word) for word in words if word)


def _worst(results: Results, column: str) -> Iterator[Bad]:
    """Cases that died, then those that came to no end, then by the outcome, not-a-number first, then the
    largest (of p_fit, the smallest)."""
    c, sign = results.columns, 1.0 if column == "p_fit" else -1.0
    values: list[float | None] = c[column] if column else [None] * results.n

    def badness(k: int) -> tuple[Any, ...]:
        value = values[k]
        return (
            c["ended"][k] != DIED,
            c["ended"][k] != "no end",
            0.0 if value is None else sign * value if value == value else -np.inf,
            c["index"][k],
        )

    for k in sorted(range(results.n), key=badness)[:WORST]:
        command = shlex.join(["kincal", "campaign", "replay", str(results.folder), str(c["index"][k])])
        yield Bad(c["index"][k], c["seed"][k], c["ended"][k], c["reason"][k] or "", values[k], command)


# ---- two campaigns


@dataclass(frozen=True)
class Compared:
    """A requirement in two campaigns. p: probability of shares as different as these if both were alike
    (Fisher's exact test)."""

    name: str
    a: Evaluated
    b: Evaluated
    p: float


@dataclass(frozen=True)
class Comparison:
    """Two campaigns. different: what differs in what was flown; requirements: those that both have, alike;
    p_outcome: probability of distributions of the outcome as different as these if both were alike (Mann and
    Whitney)."""

    a: Report
    b: Report
    different: tuple[str, ...]
    requirements: tuple[Compared, ...]
    p_outcome: float


def compare(a: Report, b: Report) -> Comparison:
    """Two campaigns side by side. BadInput if their outcomes have no number in common to compare."""
    if a.column != b.column:
        here, there = (r.column or "no number" for r in (a, b))
        what = f"the outcome here is {here}, that of {b.results.folder} is {there}"
        raise BadInput(what, str(a.results.folder), "name a number of both with --outcome")
    theirs = {_meaning(r.requirement): r for r in b.requirements}
    pairs = [
        (r, theirs[_meaning(r.requirement)]) for r in a.requirements if _meaning(r.requirement) in theirs
    ]
    found = tuple(Compared(x.requirement.name, x, y, _fisher(x.share, y.share)) for x, y in pairs)
    one, two = (next((d.values for d in r.distributions if d.column == a.column), ()) for r in (a, b))
    p = float(stats.mannwhitneyu(one, two).pvalue) if len(one) and len(two) else float("nan")
    return Comparison(a, b, tuple(_different(a.results, b.results)), found, p)


def _meaning(r: Requirement) -> tuple[str, str]:
    return r.holds, r.given


def _fisher(a: Share, b: Share) -> float:
    return float(stats.fisher_exact(np.array([[a.k, a.n - a.k], [b.k, b.n - b.k]])).pvalue)


def _different(a: Results, b: Results) -> Iterator[str]:
    here, there = a.software, b.software
    yield from (
        f"{k}: {here.get(k)}, {there.get(k)}" for k in sorted({*here, *there}) if here.get(k) != there.get(k)
    )
    one, two = a.plan.contents(), b.plan.contents()
    for part in ("spec", "scenario", "tables"):
        keys = sorted({*one[part], *two[part]})
        yield from (f"{part} {key}".strip() for key in keys if one[part].get(key) != two[part].get(key))
