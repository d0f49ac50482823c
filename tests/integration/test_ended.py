"""Why a calibration stopped measuring: every reason, from CONFIG to what people read."""

import shutil

import pytest
from flight import CORE, TABLES

from kincal.flight import tables as codec
from kincal.link.names import ended_text
from kincal.review import coef_names, from_message
from kincal.run.inprocess import Setup, simulate

WISH = {"stop_pos_m": 0.0025, "stop_rot_rad": 0.005}
REASONS = {
    "REQUIREMENT": ("encoder_bias", WISH),
    "NO_CHANGE": ("healthy", WISH),
    "POSES": ("encoder_bias", {"n_poses": 4}),
    "TIME": ("encoder_bias", {"budget_us": 90_000_000}),
    "ENERGY": ("encoder_bias", {"energy_budget_j": 3500.0}),
    # more poses requested than observations can be held
    "OBSERVATIONS": ("encoder_bias", {"n_poses": 64, "extra_obs_max": 0, "stops_max": 0}),
}


def proposal_of(folder, scenario, settings):
    """Proposal and names of the events of a calibration with these fields of CONFIG."""
    shutil.copytree(TABLES, folder / "tables")
    _, config = codec.decode_as("config", (TABLES / "config.tbl").read_bytes())
    for name, value in settings.items():
        setattr(config, name, value)
    (folder / "tables" / "config.tbl").write_bytes(codec.encode("config", config).data)
    run = simulate(scenario, 3, Setup(tables=folder / "tables", poses=settings.get("n_poses", 0)))
    assert not run.contacts
    return run.log.last_session.proposal, [e.name for e in run.log.events]


@pytest.mark.parametrize("reason", REASONS)
def test_the_proposal_says_why_measuring_ended(tmp_path, reason):
    p, _ = proposal_of(tmp_path, *REASONS[reason])
    assert p.ended == CORE.constant(f"KC_ENDED_{reason}")
    review = from_message(p, coef_names(TABLES))
    assert review.ended == ended_text(p.ended) != ""


def test_a_healthy_arm_ends_after_few_poses(tmp_path):
    p, events = proposal_of(tmp_path, "healthy", WISH)
    assert p.verdict == CORE.constant("KC_VERDICT_NO_CHANGE")
    assert p.n_poses <= 10
    assert events.count("CAL_AGREES") == 1


def test_a_wrong_one_is_calibrated_and_good_enough(tmp_path):
    p, events = proposal_of(tmp_path, "encoder_bias", WISH)
    assert events.count("CAL_DISAGREES") == 1
    assert p.verdict == CORE.constant("KC_VERDICT_CHANGE")
    assert p.pred_pos_m < p.bound_pos_m <= WISH["stop_pos_m"]
    assert p.bound_rot_rad <= WISH["stop_rot_rad"]
    assert p.confidence == 0.9 and p.n_checked >= 2
    assert "CAL_CHAIN_LIMIT" not in events  # it was reached


def test_what_the_camera_cannot_reach_is_said_and_never_claimed(tmp_path):
    """Tags measured to 0.7 mm along each axis: 1 mm of the tool cannot be had, whatever the noise."""
    p, events = proposal_of(tmp_path, "encoder_bias", {"stop_pos_m": 0.001})
    assert "CAL_UNREACHABLE" in events and "CAL_CHAIN_LIMIT" in events
    assert p.ended == CORE.constant("KC_ENDED_POSES")
    assert p.pred_noise_pos_m < 0.0005 < 0.001 < p.bound_pos_m
