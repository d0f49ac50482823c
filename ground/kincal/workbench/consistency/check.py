"""The check: what was recorded, then whether the arm and the poses belong together."""

from __future__ import annotations

import math
from collections.abc import Collection, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import lru_cache

import numpy as np

from kincal_shared.errors import BadInput, CannotAnswer
from kincal_shared.schema.arm import ArmTable

from ..data.measurements import Measurements
from ..data.sums import in_words, matrix, of_file
from ..fit.least_squares import Fit, fit_model, rms
from ..numerics.types import Array, Mask
from .findings import Finding
from .misfit import LEAST_POSES, misfit_of, rms_of_most
from .reading import LENGTH_CODES, Reading, joint_matrix
from .recorded import IN_METRES, IN_RADIANS, TRUE_NOISE_M, TRUE_NOISE_RAD, of_data, stated_m, stated_rad
from .search import FOUND, GOOD_MISFIT, Search, changed, without
from .sentences import READINGS, misread, signs, wrong_sums
from .units import links_in_metres, mixed_units

_MOST_MISFIT = 0.05  # of the motion, left by a fit of all DH errors: the poses are not of this arm
_LARGE = {"rad": 0.1, "m": 0.05}  # a DH correction that is large for the arm that the table describes
_MOST_LARGE = 6.0  # of all DH corrections together (root of the sum of squares), as multiples of these
_DETERMINED = 0.3  # standard error, as such a multiple, below which the data speak of a coefficient
_POSES = 150  # enough for a DH fit
_GROSS = 10.0  # median errors, beyond which (and beyond a good misfit) a pose is off
_MANY_OFF, _MOST_OFF = 0.05, 0.45  # share of the poses: more are no chance; the bulk does not follow the arm
_STILL = 0.02  # [rad or m] from the middle reading: the joint moves
_FEWEST_MOVING = 3  # poses that are off, before a joint that moves in just these is blamed
_JUST_THESE = 0.8  # share that the poses off and those in which a joint moves have in common
_NAMED = 12  # of them in a sentence
_MEDIAN_LENGTH = 1.54  # of three normal numbers of variance 1
_OF_READINGS = {"joint_order", "sign", "offset", "coupled", "joint_type"}  # may lead out of the limits
_FAR_ABOVE = 20.0  # times what a fit leaves: no fit leaves so little of the noise


@dataclass(frozen=True)
class Check:
    """Whether an arm table and measurements belong together.

    arm, source, poses: names of both, and how many poses there are; misfit: share of the measured motion that
    the nominal arm leaves after its frames and joint offsets are fitted, None where there are too few poses
    to say; findings: worst first.
    """

    arm: str
    source: str
    poses: int
    misfit: float | None
    findings: tuple[Finding, ...]

    @property
    def ok(self) -> bool:
        """Nothing has to be put right."""
        return all(finding.severity == "note" for finding in self.findings)

    @property
    def doubts(self) -> tuple[str, ...]:
        """What speaks against it, in words."""
        return tuple(finding.text for finding in self.findings if finding.severity != "note")

    @property
    def errors(self) -> tuple[Finding, ...]:
        """Findings that make every answer wrong."""
        return tuple(finding for finding in self.findings if finding.severity == "error")


def check(arm: ArmTable, data: Measurements, *, thorough: bool = True) -> Check:
    """Look at everything that is recorded, and for a misreading of the files that explains the poses better.

    thorough: also where the arm explains the poses well as it is, so that a mistake about a joint that hardly
    moves is found too. The answer for the same two objects is remembered: a command asks before it computes,
    and its answer shows it.
    """
    return _check(arm, data, thorough)


@lru_cache(maxsize=4)
def _check(arm: ArmTable, data: Measurements, thorough: bool) -> Check:
    found, left, table = list(of_data(arm, data)), None, arm
    arm, links = links_in_metres(table, data)  # what is said of the rest is of an arm of possible size
    mixed = mixed_units(arm, data)
    found += [*links, *mixed]
    if data.n >= LEAST_POSES:
        search = Search(table, data, thorough)
        left = search.misfit(search.given)
        if arm is not table:
            search = Search(arm, data, thorough)
        # mistakes about a joint that moves in few poses, and outliers, hide from the misfit of most poses
        wrong = max(search.misfit(search.given), search.misfit_of_all(search.given)) > GOOD_MISFIT
        impossible = links and arm is table
        if not mixed and not impossible and (thorough or wrong):  # no reading of the whole file mends these
            found += _of_fit(search)
        found += _noise_in_another_unit(arm, data, {finding.code for finding in found})
    else:
        found.append(_too_few(data))
    if mixed or any(finding.code in _OF_READINGS or finding.why.startswith(READINGS) for finding in found):
        found = [finding for finding in found if finding.code != "outside_limits"]  # which that explains
    return Check(arm.name, data.source, data.n, _finite(left), tuple(sorted(found, key=_rank)))


def refuse(answer: Check, arm: ArmTable, todo: str) -> None:
    """BadInput if a finding makes every answer wrong; todo: what to do beside the fixes."""
    if answer.errors:
        raise BadInput(
            "the arm table and the measurements do not belong together:\n    "
            + "\n    ".join(finding.text for finding in answer.errors),
            f"{arm.source or arm.name}, {answer.source}",
            todo,
        )


def _too_few(data: Measurements) -> Finding:
    why = (
        f"{data.n} poses are too few to tell whether the arm explains them: this check takes at least "
        f"{LEAST_POSES}, a fit fewer"
    )
    return Finding("few_poses", why, "measure more poses", severity="warning")


def _rank(finding: Finding) -> tuple[int, float]:
    return ("error", "warning", "note").index(finding.severity), -finding.gain


def _finite(value: float | None) -> float | None:
    return value if value is not None and np.isfinite(value) else None


def _of_fit(search: Search) -> Iterator[Finding]:
    """The misreading that explains the poses, or that the arm table is not of this arm."""
    if sums := _of_sums(search):
        yield from sums
        return
    best = search.best()
    if changed(best) and search.misfit(best) * FOUND <= search.misfit(search.given):
        for kind in changed(best):
            gain = search.misfit(without(best, kind)) / search.misfit(best)
            found = misread(best, kind, gain, search.arm, search.shipped)
            yield _or_signs(found, search, best) if kind == "mirror" else found
    elif (hidden := search.best_of_all()) is not None:
        gain = search.misfit_of_all(search.given) / search.misfit_of_all(hidden)
        yield from (misread(hidden, kind, gain, search.arm, search.shipped) for kind in changed(hidden))
    else:
        yield from _wrong_arm(search)


def _of_sums(search: Search) -> list[Finding]:
    """What the readings are as the file has them, where the map's sums of readings are not that: a wrong sum
    hides what is right, and a finding about its outcome is no line to write. None where the sums are right,
    or do not explain it."""
    sums, before = search.data.sums, search.misfit(search.given)
    if not sums or max(before, search.misfit_of_all(search.given)) <= GOOD_MISFIT:
        return []
    raw = replace(search.data, q=of_file(search.data.q, sums), sums=())
    of_raw = Search(search.arm, raw, search.thorough)
    best = of_raw.best()
    left, stated = of_raw.misfit(best), matrix(sums, search.arm.n)
    if left * FOUND > before or (joint_matrix(best) == stated).all():
        return []
    gains = {kind: of_raw.misfit(without(best, kind)) / left for kind in changed(best)}
    found = [misread(best, kind, gain, search.arm, search.shipped) for kind, gain in gains.items()]
    if not best.coupled:
        return [*found, wrong_sums(in_words(sums), before / left)]
    return [
        replace(f, fix=f"{f.fix}, in the place of {in_words(sums)}") if f.code == "coupled" else f
        for f in found
    ]


def _or_signs(found: Finding, search: Search, mirrored: Reading) -> Finding:
    """The finding of a mirror, with the joints that would look the same if they counted the other way."""
    other = search.alike(mirrored)
    if other is None:
        return found
    return replace(found, fix=f"{found.fix}; or change the sign of {signs(other)}, which looks the same")


def _wrong_arm(search: Search) -> Iterator[Finding]:
    """What a fit of all DH errors says of an arm table that no simple change makes right, and of poses that
    are far off although the others are explained."""
    fit = _calibrated(search.arm, search.data)
    left = misfit_of(fit, search.data) if fit is not None else np.ones(search.data.n)
    off = (left > GOOD_MISFIT) & (left > _GROSS * np.median(left))
    explained = fit is not None and rms_of_most(left[~off]) < _MOST_MISFIT
    if fit is None or not explained or off.mean() > _MOST_OFF:
        rest = f"{rms_of_most(left):.0%}" if fit is not None else "most"
        yield Finding(
            "wrong_arm",
            f"even with all DH errors fitted, {rest} of the measured motion is left unexplained: the arm "
            "table is of another arm, or the poses do not belong to these readings (no change of units, "
            "order, signs or axes explains it)",
            "check the DH table against the data sheet, that each row holds the pose of its own readings, "
            "and that neither base nor measuring device was moved during the session (if so, use a file for "
            "each part)",
        )
        return
    before, after = search.misfit(search.given), rms_of_most(left[~off])
    if off.any():
        yield _outliers(fit, search.data, off)
    elif before > _MOST_MISFIT:
        yield Finding(
            "corrections",
            f"the nominal arm leaves {before:.0%} of the motion, a fit of all DH errors {after:.2%}: its "
            f"largest corrections are {_largest(fit, fit.names, fit.estimate / _large(fit))}",
            "compare the DH table with the data sheet",
            severity="note",
        )
    if before > GOOD_MISFIT and after > GOOD_MISFIT:
        yield Finding(
            "unexplained",
            f"even with all DH errors fitted, {after:.1%} of the measured motion is left: more than any arm "
            "leaves that is described right",
            "check that each row holds the pose of its own readings, that all rows measure the same point of "
            "the tool (several targets mixed in one column), and that neither base nor measuring device was "
            "moved",
            severity="warning",
        )
    names, sizes = _sizes(fit)
    total = float(np.linalg.norm(sizes))
    if total > _MOST_LARGE:
        yield Finding(
            "wrong_arm",
            f"the DH corrections together come to {total:.1f} times {_LARGE['rad']:g} rad or "
            f"{1e3 * _LARGE['m']:.0f} mm ({_largest(fit, names, sizes)}): "
            "that is a wrong arm table, not a correction",
            "check the DH table against the data sheet",
            before / rms_of_most(left),
        )


def _noise_in_another_unit(arm: ArmTable, data: Measurements, found: Collection[str]) -> Iterator[Finding]:
    """Stated noise that is far above what a fit leaves, whatever it is beside the motion; found: codes of
    what explains that already. Rotations of too little weight leave an answer that is worth reading."""
    if data.cov is None:
        return
    metres, radians = stated_m(data.cov), stated_rad(data.cov) if data.components == 6 else 0.0
    far = metres > TRUE_NOISE_M and LENGTH_CODES.isdisjoint(found)
    turned = radians > TRUE_NOISE_RAD and "degrees" not in found
    fit = _calibrated(arm, replace(data, cov=None, whole=None)) if far or turned else None
    if fit is None or fit.data.n * data.components < 2 * len(fit.names):  # a fit leaves nothing of few poses
        return
    r = fit.evaluation.r.reshape(fit.data.n, -1, 3)
    left, *of_rotations = np.median(np.linalg.norm(r, axis=2), axis=0) / _MEDIAN_LENGTH
    if far and metres > _FAR_ABOVE * left:
        yield Finding(
            "millimetres",
            f"the stated noise is {metres:.3g} m, but a fit of the DH errors leaves {left * 1e3:.2g} mm: it "
            "looks like millimetres",
            IN_METRES,
        )
    if turned and radians > _FAR_ABOVE * of_rotations[0]:
        yield Finding(
            "degrees",
            f"the stated noise of rotations is {radians:.3g} rad, but a fit of the DH errors leaves "
            f"{of_rotations[0] * 1e3:.2g} mrad: it looks like degrees",
            IN_RADIANS,
            severity="warning",
        )


def left_m(arm: ArmTable, data: Measurements) -> float:
    """RMS position [m] that a fit of all DH errors leaves of the good poses; infinite if there is none."""
    fit = _calibrated(arm, replace(data, cov=None, whole=None))
    return math.inf if fit is None or not fit.good.any() else rms(fit.evaluation.r[fit.good])[0]


def _calibrated(arm: ArmTable, data: Measurements) -> Fit | None:
    """A fit of all DH errors; None where there is none."""
    rows = np.linspace(0, data.n - 1, min(data.n, _POSES)).astype(int)
    try:
        with np.errstate(all="ignore"):
            fit = fit_model(arm, data.take(rows))
    except (CannotAnswer, ValueError, np.linalg.LinAlgError):
        return None
    return fit if np.isfinite(fit.estimate).all() else None


def _outliers(fit: Fit, data: Measurements, off: Mask) -> Finding:
    """Poses that are far off; that many are no chance."""
    r, names = fit.predict(data), tuple(name for name, out in zip(data.ids, off, strict=True) if out)
    shown = ", ".join(names[:_NAMED]) + (f" and {len(names) - _NAMED} more" if len(names) > _NAMED else "")
    many = off.mean() >= _MANY_OFF
    moving = _moving_alone(data, off)
    alone = f"; they are the poses in which joint {moving} moves" if moving else ""
    cause = f"readings of joint {moving} wrong, or coupled to those of another; " if moving else ""
    return Finding(
        "outliers",
        f"{len(names)} of {data.n} poses are off by {_size(r[off])} (RMS), the others by {_size(r[~off])}: "
        f"{shown}{alone}",
        f"find out what is wrong with them ({cause}target moved or confused with another, rows of another "
        "arm, measured before the arm stood still), correct them or leave them out: "
        f"--exclude {','.join(names)}",
        severity="warning" if many else "note",
        poses=names,
    )


def _moving_alone(data: Measurements, off: Mask) -> int | None:
    """The joint (from 1) that moves in just these poses, and stands still in the others; None if there is
    none."""
    moves = np.abs(data.q - np.median(data.q, axis=0)) > _STILL
    alike = (moves & off[:, None]).sum(axis=0) / np.maximum((moves | off[:, None]).sum(axis=0), 1)
    best = int(alike.argmax())
    return best + 1 if off.sum() >= _FEWEST_MOVING and alike[best] >= _JUST_THESE else None


def _size(r: Array) -> str:
    position, rotation = rms(r)
    return f"{position * 1e3:.1f} mm" + ("" if rotation is None else f", {rotation * 1e3:.1f} mrad")


def _large(fit: Fit) -> np.ndarray:
    """(k,) sizes of coefficients that count as large; infinite for those that are no DH errors."""
    return np.array([
        _LARGE[p.unit] if name.startswith("J") and p.unit in _LARGE else np.inf
        for name, p in zip(fit.names, fit.parameters, strict=True)
    ])  # fmt: skip


def _sizes(fit: Fit) -> tuple[Sequence[str], np.ndarray]:
    """DH corrections that the data determine, as multiples of `_LARGE`; joint offsets may be large."""
    large = _large(fit)
    chosen = [
        k
        for k, name in enumerate(fit.names)
        if name.startswith("J") and not name.endswith("phi_rad") and fit.std_err[k] < _DETERMINED * large[k]
    ]
    return [fit.names[k] for k in chosen], (fit.estimate / large)[chosen]


def _largest(fit: Fit, names: Sequence[str], sizes: np.ndarray) -> str:
    values = dict(zip(fit.names, fit.estimate, strict=True))
    worst = [names[k] for k in np.argsort(-np.abs(sizes))[:3]]
    return ", ".join(f"{name} {values[name]:+.3g}" for name in worst)
