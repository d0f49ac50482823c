"""An effect at all joints cut down to the fewest joints that explain the data as well."""

from __future__ import annotations

from collections.abc import Sequence

from ..evidence.scoring import Scorer
from ..model.effects import Hypothesis
from ..model.hypotheses import at_joints, joints_of

_LN_NEEDED = 1.0  # ln Bayes factor that a joint has to be worth to stay: below it is not worth a mention


def fewest_joints(scorer: Scorer, whole: Hypothesis) -> Hypothesis | None:
    """The effect at two or more of its joints, taken out backwards while what leaves is worth nothing; None
    where no joint can leave. `whole` at all joints or at some; scorer: without it in the nuisance."""
    joints = joints_with(whole)
    before, now = joints, whole
    while len(joints) > 2:
        without = [at_joints(whole, [k for k in joints if k != j]) for j in joints]
        (_, ln_now), *rest = scorer.hypotheses([now, *without])
        (_, best), now_best = max(zip(rest, without, strict=True), key=lambda pair: pair[0][1])
        if best < ln_now - _LN_NEEDED:
            break
        now, joints = now_best, joints_of(now_best.name)
    return None if joints == before else now


def joints_with(whole: Hypothesis) -> Sequence[int]:
    """Joints of an effect at all or some joints, by the names of its parameters: A[2], A[3]."""
    return tuple(dict.fromkeys(j for p in whole.parameters for j in joints_of(p.name)[:1]))
