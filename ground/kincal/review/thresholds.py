"""The threshold of each number of a proposal, and whether it is kept."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from kincal.flight import library
from kincal.flight.tables import decode_as

from . import OF_A_GOOD_FIT, P_FIT_MIN, Review, poor_fit

DOES_NOT_HOLD = "does not hold: the fit is poor"
SIGMA_DOES_NOT_HOLD = (
    "the fit is poor: sigma, correlations, predicted error, its bound and p_no_change assume that the model "
    "explains the data, and do not hold; the error can be much larger"
)


@dataclass(frozen=True)
class Limits:
    """What the configuration table asks of a correction. no_change_p: chance above which nothing is
    proposed; early_p: the same where the table in force is tested before the end too (no_change_p if it never
    is); rank_tol: least relative size of a direction that counts; outlier_max: poses that may be rejected."""

    no_change_p: float
    early_p: float
    rank_tol: float
    outlier_max: int


@dataclass(frozen=True)
class Threshold:
    """What a number has to be, in words; kept: None where nothing is asked of it; holds: False where the
    number says nothing, which the text says then."""

    text: str
    kept: bool | None = None
    holds: bool = True


def read_limits(tables_dir: Path) -> Limits | None:
    """From the configuration table of a folder; None if it has none."""
    file = tables_dir / "config.tbl"
    if not file.is_file():
        return None
    _, c = decode_as("config", file.read_bytes(), str(file))
    lib = library("flight").lib
    early = c.no_change_power > 0.0 and bool(lib.kc_fit_required(c))
    return Limits(c.no_change_p, lib.kc_verdict_level(c, early), c.est.rank_tol, c.est.outlier_max)


def thresholds(review: Review, limits: Limits | None) -> dict[str, Threshold]:
    """By the names of NUMBERS, and n_outliers; a number without an entry is for information."""
    k = review.numbers
    free = f"all {k['n_free']:.0f} asked for"
    out = {
        "rank": Threshold(free, k["rank"] == k["n_free"]),
        "dof": Threshold("above 0", k["dof"] > 0),
        "chi2": Threshold("judged by p_fit"),
        "noise_scale": Threshold("judged by p_fit"),
        "p_fit": Threshold(f"at least {P_FIT_MIN:g}", k["p_fit"] >= P_FIT_MIN),
        "fit_pos_m": Threshold("below before_pos_m", k["fit_pos_m"] <= k["before_pos_m"]),
        "fit_rot_rad": Threshold("below before_rot_rad", k["fit_rot_rad"] <= k["before_rot_rad"]),
    }
    if limits is not None:
        out |= _configured(review, limits)
    if poor_fit(review):
        out |= {key: Threshold(DOES_NOT_HOLD, holds=False) for key in OF_A_GOOD_FIT}
    return out


def _configured(review: Review, limits: Limits) -> dict[str, Threshold]:
    k, change = review.numbers, review.changes_something
    most, widest = limits.early_p if review.tested_early else limits.no_change_p, 1.0 / limits.rank_tol
    early = f" ({limits.early_p:g} if it was tested before)" if limits.early_p < most else ""
    return {
        "p_no_change": Threshold(
            f"at most {most:g} for a change{early}", k["p_no_change"] <= most or not change
        ),
        "cond": Threshold(f"at most {widest:g}", k["cond"] <= widest),
        "n_outliers": Threshold(
            f"fewer than {limits.outlier_max}, the most that flight rejects",
            review.n_outliers < limits.outlier_max,
        ),
    }
