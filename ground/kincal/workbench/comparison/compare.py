"""Does the model explain the data, and if not, where does it fail?"""

from __future__ import annotations

from collections.abc import Callable, Collection, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property, partial

import numpy as np

from kincal_shared.errors import BadInput, CannotAnswer
from kincal_shared.schema.arm import ArmTable

from ..consistency import Check, check, reach_m
from ..data.measurements import Measurements
from ..data.split import Split, choose_split
from ..evidence.adequacy import (
    STRUCTURE_P,
    NoiseFloor,
    Outliers,
    TurnedFrame,
    Where,
    WorstPose,
    explained,
    find_outliers,
    lack_of_fit,
    near_poses_alike,
    noise_floor,
    structure,
    turned_frame,
    unseen_p,
    where_it_fails,
    worst_poses,
)
from ..evidence.constants import Anew
from ..evidence.neighbours import Alike
from ..fit.identifiability import Axis, Identifiability, identifiability, residual_axes
from ..fit.least_squares import Fit, find_frames, fit_model, rms, whitener
from ..fit.length_scale import LengthScale, length_scale
from ..model.effects import Hypothesis
from ..model.parameters import given_no_beta, is_beta
from ..numerics.background import Begin, when_asked
from ..numerics.types import Array
from ..prediction.reachable import PosRot, Reachable, reachable

_MIN_POSES = 4
_MIN_DOF = 1.5
_MIN_RANK_SHARE = 1.0 / 3.0  # of the coefficients; seven joints that move freely give 28 of 28
_STILL = 0.02  # [rad or m], a joint that moves less stands still


@dataclass(frozen=True)
class TableErrors:
    """Errors of a DH table [m], [rad] on the held-out poses. held: of a table that was fitted to the other
    poses; exported: of that which is exported, fitted to all poses unless the file keeps some back. It leaves
    other turns out than the first, and its error may be smaller or larger."""

    held: PosRot
    exported: PosRot


@dataclass(frozen=True)
class Comparison:
    """A model beside measurements.

    arm, source: names of the arm and of the data; poses, components: N and c (6, or 3 for positions only);
    data: all poses; held_data: the held-out ones, None if there are none; skipped: malformed rows left out;
    rms: "nominal", "fit" and "held" errors; chi2_per_dof: of all poses, in units of the stated noise;
    p_lack_of_fit: of the size of the leftover, None where nothing says how large the noise is;
    still_joints: joints (from 1) that the poses do not move; fit_all: fitted to every pose (to the fit
    poses if the file keeps some back); fit_part: fitted to the fit poses; black_box: gives `reachable`.
    What tests of the leftover say is computed when it is asked for.
    """

    arm: str
    source: str
    poses: int
    components: int
    split: Split
    data: Measurements
    held_data: Measurements | None
    skipped: int
    noise_floor: NoiseFloor
    rms: dict[str, PosRot]
    chi2_per_dof: float
    p_lack_of_fit: float | None
    still_joints: tuple[int, ...]
    fit_all: Fit
    fit_part: Fit
    black_box: Callable[[], Reachable | None] = field(repr=False)

    @cached_property
    def where(self) -> tuple[Where, ...]:
        """Where the leftover follows which recorded variable, best first."""
        return where_it_fails(self.fit_all)

    @property
    def p_structure(self) -> float:
        """p-value that the leftover follows some recorded variable somewhere, over all variables."""
        return structure(self.where)

    @cached_property
    def alike(self) -> Alike | None:
        """What near poses have in common of the leftover, None where they are too few."""
        return near_poses_alike(self.fit_all)

    @cached_property
    def turned(self) -> TurnedFrame | None:
        """Of the measured orientations against the positions."""
        return turned_frame(self.fit_all)

    @property
    def kept_back(self) -> Measurements | None:
        """Poses that the file keeps back, None if it keeps none."""
        return self.held_data if self.split.given else None

    @cached_property
    def outliers(self) -> Outliers:
        """Poses that noise does not explain."""
        return find_outliers(self.fit_all, self.kept_back)

    @cached_property
    def worst_poses(self) -> tuple[WorstPose, ...]:
        """The poses farthest from the model, worst first."""
        return worst_poses(self.fit_all)

    @cached_property
    def p_unseen(self) -> float | None:
        """p-value that poses which the file keeps back are predicted as well as noise allows."""
        return None if self.kept_back is None else unseen_p(self.fit_all, self.kept_back, self.outliers)

    @cached_property
    def adequate(self) -> bool:
        """All of these are likely enough, nothing is turned, and outliers are few and in no cluster."""
        small = explained(self.p_lack_of_fit, self.p_structure, self.alike, self.p_unseen)
        return small and self.outliers.may_be_chance and self.turned is None

    @property
    def structured(self) -> bool:
        """What is left follows a recorded variable, or is alike at near poses."""
        return self.p_structure <= STRUCTURE_P or (self.alike is not None and self.alike.shown)

    @cached_property
    def identifiability(self) -> Identifiability:
        """What all poses together determine of the model's coefficients."""
        return identifiability(self.fit_all)

    @cached_property
    def length_scale(self) -> LengthScale | None:
        """The factor by which all lengths of the arm are wrong, None where they are not."""
        return length_scale(self.fit_all)

    @cached_property
    def errors(self) -> dict[str, PosRot]:
        """Errors of the "nominal" arm, after "DH" calibration alone and of its "model" with effects (if it
        has some), on the held-out poses; on the fitted ones where none are held out."""
        return self.errors_without(())

    def errors_without(self, ids: Collection[str]) -> dict[str, PosRot]:
        """`errors` without the poses of these ids."""
        usual = self.measured.are_not(ids)
        return {name: rms(r[usual]) for name, r in self._left.items()}

    @property
    def measured(self) -> Measurements:
        """The poses of `errors`."""
        return self.fit_part.data if self.held_data is None else self.held_data

    @cached_property
    def _left(self) -> dict[str, Array]:
        """(M, c) residuals of the poses of `errors` by model."""
        part = self.fit_part
        arm, frames = part.arm, (part.base, part.tool)
        fits = {"nominal": fit_model(arm, part.data, dh=False, frames=frames)}
        dh = any(name.startswith("J1.") for name in part.names)
        if dh:
            fits["DH"] = fit_model(arm, part.data, frames=frames) if part.hypotheses else part
        if part.hypotheses or not dh:
            fits["model"] = part
        held = self.held_data
        return {name: fit.evaluation.r if held is None else fit.predict(held) for name, fit in fits.items()}

    @cached_property
    def table_errors(self) -> TableErrors | None:
        """Errors of what a DH table holds of a calibration without effects, where that is less than all of
        it: no turns between parallel axes. None otherwise, or if no poses are held out."""
        held = self.held_data
        if held is None or self.fit_all.hypotheses or not any(map(is_beta, self.fit_all.names)):
            return None

        def of_table(fit: Fit) -> PosRot:
            table = replace(fit, estimate=given_no_beta(fit.names, fit.estimate, fit.cov))
            return rms(table.predict(held))

        return TableErrors(of_table(self.fit_part), of_table(self.fit_all))

    @cached_property
    def consistency(self) -> Check:
        """Whether arm table and measurements belong together; computed when first asked for."""
        return check(self.fit_all.arm, self.data, thorough=False)

    @cached_property
    def residual_axes(self) -> dict[str, tuple[Axis, ...]]:
        """Residuals by axis of the "fit" and of the "held" poses."""
        held = () if self.held_data is None else residual_axes(self.fit_part.predict(self.held_data))
        return {"fit": residual_axes(self.fit_part.evaluation.r), "held": held}

    @cached_property
    def reachable(self) -> Reachable | None:
        """What a black box predicts of the held-out error (half a second of work for 100 poses); None where
        no poses are held out."""
        return self.black_box()


def compare(
    arm: ArmTable,
    data: Measurements,
    hypotheses: Sequence[Hypothesis] = (),
    *,
    dh: bool = True,
    begin: Begin = when_asked,
    anew: Anew | None = None,
) -> Comparison:
    """Robust fit on the fit poses, its error on the held-out ones, lack of fit, and where it fails.

    hypotheses: effects in the model; dh: DH errors too; begin: how the work for `reachable` begins; anew:
    these effects for the fit poses alone (absent: as they are). BadInput if the units look wrong;
    CannotAnswer if the poses are too few or too similar.
    """
    check_units(arm, data)
    split = choose_split(data)
    part = data.take(split.fit)
    _check_number(part)
    frames = find_frames(arm, part)
    of_part = hypotheses if anew is None else anew(part)
    fit_part = fit_model(arm, part, of_part, dh=dh, frames=frames)
    _check_design(fit_part, dh)
    black_box = begin(partial(reachable, fit_part, data, split.fit, split.held))
    # the whole model is tested on every pose unless the file keeps some back
    fit_all = fit_part if split.given else fit_model(arm, data, hypotheses, dh=dh, frames=frames)
    held = data.take(split.held) if len(split.held) else None
    floor = noise_floor(fit_all)
    return Comparison(
        arm=arm.name,
        source=data.source,
        poses=data.n,
        components=data.components,
        split=split,
        data=data,
        held_data=held,
        skipped=len(data.skipped),
        noise_floor=floor,
        rms={
            "nominal": rms(fit_model(arm, part, dh=False, frames=frames).evaluation.r),
            "fit": rms(fit_part.evaluation.r),
            "held": rms(fit_part.predict(held)) if held is not None else (float("nan"), None),
        },
        chi2_per_dof=fit_all.scale**2,
        p_lack_of_fit=lack_of_fit(fit_all, floor),
        still_joints=still_joints(data),
        fit_all=fit_all,
        fit_part=fit_part,
        black_box=black_box,
    )


def _rank_without_misfit(fit: Fit) -> int:
    """Directions that the poses would determine if the fit explained them to their noise, stated or usual:
    what is left of a fit counts as noise, and a large one hides how well the joints are moved."""
    whiten = whitener(fit.data)
    rows = fit.J.reshape(fit.data.n, -1, len(fit.names))
    return replace(fit, J=(whiten @ np.linalg.solve(fit.whiten, rows)).reshape(fit.J.shape), scale=1.0).rank


def still_joints(data: Measurements) -> tuple[int, ...]:
    """Joints (from 1) that the poses do not move: nothing about them can be estimated."""
    return tuple(int(j) + 1 for j in np.flatnonzero(np.ptp(data.q, axis=0) < _STILL))


def check_units(arm: ArmTable, data: Measurements) -> None:
    """BadInput where most joint angles look like degrees or most positions like millimetres; a few rows are
    outliers to the fit, and `check` names them."""
    found = [*_degrees(arm, data), *_millimetres(arm, data)]
    if found:
        raise BadInput(f"{data.source}: " + "; ".join(found))


def _degrees(arm: ArmTable, data: Measurements) -> list[str]:
    limits = np.array([[joint.q_min, joint.q_max] for joint in arm.joints])
    turning = np.array([not joint.prismatic for joint in arm.joints])
    out = (data.q < limits[:, 0] - 0.1) | (data.q > limits[:, 1] + 0.1)
    if not turning.any() or np.abs(data.q[:, turning]).max() <= 2.2 * np.pi or out.mean() <= 0.2:
        return []
    return [
        f"joint angles reach {np.abs(data.q[:, turning]).max():.1f}: they look like degrees; "
        "q1..qN must be radians (multiply by pi/180)"
    ]


def _millimetres(arm: ArmTable, data: Measurements) -> list[str]:
    reach = reach_m(arm)
    spread = float(np.median(np.linalg.norm(data.p_m - np.median(data.p_m, axis=0), axis=1)))
    if reach <= 0 or spread <= 20.0 * reach:
        return []
    return [
        f"positions spread over {spread:.0f}, the arm reaches about {reach:.1f} m: they look like "
        "millimetres; px,py,pz must be metres"
    ]


def _check_number(part: Measurements) -> None:
    different = part.n if part.replicate is None else len(np.unique(part.replicate))
    if different < _MIN_POSES:
        raise CannotAnswer(
            f"{different} different poses to fit; a fit takes at least {_MIN_POSES}",
            part.source,
            "measure more poses; repeated measurements of a pose count once",
        )


def _check_design(fit: Fit, dh: bool) -> None:
    """CannotAnswer where the poses leave nothing to test the model with, or do not determine it."""
    if fit.dof < _MIN_DOF:
        raise CannotAnswer(
            f"{fit.data.n} poses leave no degree of freedom beside the {len(fit.names)} coefficients",
            fit.data.source,
            "measure more poses",
        )
    least = _MIN_RANK_SHARE * len(fit.names)
    if dh and fit.rank < least <= _rank_without_misfit(fit):
        raise CannotAnswer(
            f"no fit explains the poses: {1e3 * rms(fit.evaluation.r)[0]:.3g} mm are left with all DH errors "
            f"fitted, and as noise that lets them determine {fit.rank} of {len(fit.names)} directions",
            fit.data.source,
            "`kincal model check` names some causes; several targets may be mixed in one column, or the arm "
            "table be of another arm",
        )
    if dh and fit.rank < least:
        raise CannotAnswer(
            f"singular design: the poses determine {fit.rank} of {len(fit.names)} directions of the model",
            fit.data.source,
            "move more joints, and farther",
        )
