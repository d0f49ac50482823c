"""Whether an arm table and measurements belong together, as text and as JSON."""

from __future__ import annotations

from typing import Any

from kincal.workbench.consistency import Check, Finding

_MOST_GAIN = 1e6  # JSON has no infinity


def as_json(answer: Check) -> dict[str, Any]:
    """`kincal model check --json`."""
    return {
        "ok": answer.ok,
        "arm": answer.arm,
        "data": answer.source,
        "poses": answer.poses,
        "misfit": answer.misfit,
        "findings": [_finding_json(finding) for finding in answer.findings],
    }


def _finding_json(finding: Finding) -> dict[str, Any]:
    return {
        "code": finding.code,
        "severity": finding.severity,
        "why": finding.why,
        "fix": finding.fix,
        "gain": min(finding.gain, _MOST_GAIN),
        **({"poses": list(finding.poses)} if finding.poses else {}),
    }


def lines(answer: Check) -> str:
    """The verdict, then each finding with what to do about it."""
    verdict = "belong together" if not answer.errors else "do NOT belong together"
    if answer.misfit is None and not answer.errors:
        verdict = "cannot be compared"
    elif not answer.ok and not answer.errors:
        verdict += ", but something has to be corrected first"
    left = (
        ""
        if answer.misfit is None
        else f"; the nominal arm leaves {answer.misfit:.2%} of the motion unexplained"
    )
    head = f"{answer.arm} and {answer.source} ({answer.poses} poses) {verdict}{left}"
    return "\n".join([head, *(line for finding in answer.findings for line in _finding(finding))])


def _finding(finding: Finding) -> list[str]:
    todo = [f"          to do: {finding.fix}"] if finding.fix else []
    return [f"{finding.severity:<8}  {finding.code}: {finding.why}", *todo]
