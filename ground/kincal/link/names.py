"""Names of the numbers that messages carry, from the headers of flight; for people where they read better."""

from __future__ import annotations

from functools import cache

from kincal.flight import library

VERDICTS = {"NO_CHANGE": "no change needed", "CHANGE": "change proposed", "POOR": "poor fit"}
SEVERITIES = {"WARN": "warning"}


@cache
def _names(enum: str, prefix: str) -> dict[int, str]:
    return {number: name for name, number in library("flight").enum(enum, prefix).items()}


def _name(enum: str, prefix: str, number: int) -> str:
    """Name of an enumerator without its prefix, in capitals; "?9" if there is none."""
    return _names(enum, prefix).get(number, f"?{number}")


def state_name(number: int) -> str:
    """State of the executive, "IDLE" ..."""
    return _name("kc_state_t", "KC_ST_", number)


def verdict_key(number: int) -> str:
    """Verdict of a calibration as scenarios write it: "no_change", "change", "poor"."""
    return _name("kc_verdict_t", "KC_VERDICT_", number).lower()


def verdict_name(number: int) -> str:
    """Verdict of a calibration for people, "change proposed" ..."""
    return VERDICTS.get(_name("kc_verdict_t", "KC_VERDICT_", number), f"?{number}")


def frame_name(number: int) -> str:
    """Where a correction has to be right: "camera" or "lander"."""
    return _name("kc_right_in_t", "KC_RIGHT_IN_", number).lower()


def ended_text(number: int, verdict: int | None = None) -> str:
    """Why a calibration stopped measuring, as a sentence without its full stop; "" if flight did not say.
    verdict: of the same proposal; an accuracy that a poor fit states is not reached."""
    flight = library("flight")
    text = flight.text(flight.lib.kc_ended_text(number))
    if number == flight.lib.KC_ENDED_REQUIREMENT and verdict == flight.lib.KC_VERDICT_POOR:
        return f"{text} by a fit that is poor: its accuracy does not count"
    return text


def tested_early(number: int) -> bool:
    """Whether a calibration that ended so has tested the table in force before its end, each time at half of
    no_change_p; other ends leave it open."""
    lib = library("flight").lib
    return number in (lib.KC_ENDED_REQUIREMENT, lib.KC_ENDED_NO_CHANGE)


def coef_status_name(number: int) -> str:
    """Status of a coefficient, "estimated", "at lower bound" ..."""
    name = _name("kc_coef_status_t", "KC_COEF_", number).lower()
    return f"{name.replace('_', ' ')} bound" if name.startswith("at_") else name


def acquisition_name(number: int) -> str:
    """How poses are chosen: "ucb", "random", "dopt", "vopt", "rate"."""
    return _name("kc_acq_t", "KC_ACQ_", number).lower()


def severity_name(number: int) -> str:
    """Severity of an event: "debug", "info", "warning", "error"."""
    name = _name("kc_severity_t", "KC_SEV_", number)
    return SEVERITIES.get(name, name.lower())


def opcode(name: str) -> int:
    """Number of a command, e.g. "TABLE_DUMP". KeyError if there is none."""
    return library("flight").enum("kc_opcode_t", "KC_CMD_")[name]
