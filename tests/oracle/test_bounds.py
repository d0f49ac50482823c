"""kc_bounds.c: no correction term does more than its stated size, at any posture and in any surroundings that
the header states, and what TERMS may describe is what the search space was verified for."""

from pathlib import Path

import numpy as np
import pytest

from kincal.flight import library
from kincal.flight import tables as codec
from kincal.flight.bounds import Flown, shared_bounds

FLIGHT = library("flight")
BIN = Path(__file__).resolve().parents[2] / "tables" / "bin"
VARIABLES = FLIGHT.enum("kc_var_t", "KC_VAR_")
FUNCTIONS = FLIGHT.enum("kc_fn_t", "KC_FN_")
OF_JOINT = ("Q", "TAU", "DIR", "QDOT", "TAU_PAYLOAD")
OF_LINK = ("MX", "MY", "MZ", "GX", "GY", "GZ")


@pytest.fixture(scope="module")
def flown():
    return Flown.read(BIN)


def indices(name, n):
    if name in OF_JOINT:
        return range(1, n + 1)
    if name in OF_LINK:
        return range(n + 1)
    if name.startswith("LEV"):
        return [16 * link + body for link in range(n) for body in (0, *range(link + 1, n + 1))]
    return [0]


def surroundings(arm, rng):
    """A context at the limits of what the header states, as often as inside."""

    def between(lo, hi):
        return lo + (hi - lo) * np.clip(rng.uniform(-0.2, 1.2), 0.0, 1.0)

    far = FLIGHT.decimal("KC_BOUNDS_DISTANCE_M")
    ctx = FLIGHT.new("kc_ctx_t")
    for j in range(arm.n_joints):
        joint = arm.joint[j]
        ctx.q[j], ctx.qdot[j] = between(joint.q_min, joint.q_max), between(-joint.speed_max, joint.speed_max)
        ctx.dir[j] = rng.choice([-1.0, 0.0, 1.0])
    down = rng.standard_normal(3)
    ctx.g_m_s2[0:3] = (down * np.linalg.norm(list(arm.gravity_m_s2)) / np.linalg.norm(down)).tolist()
    ctx.temp_c = between(FLIGHT.decimal("KC_BOUNDS_TEMP_MIN_C"), FLIGHT.decimal("KC_BOUNDS_TEMP_MAX_C"))
    ctx.payload_kg = between(0.0, FLIGHT.decimal("KC_BOUNDS_PAYLOAD_KG"))
    ctx.range_m, ctx.incid_rad = between(0.0, far), between(0.0, 0.5 * np.pi)
    ctx.u_norm, ctx.v_norm, ctx.tag = between(-1, 1), between(-1, 1), rng.choice([0.0, 0.5, 1.0])
    ctx.pan_rad, ctx.tilt_rad = between(-np.pi, np.pi), between(-np.pi, np.pi)
    ctx.p_cam_tool_m[0:3] = [between(-far, far) for _ in range(3)]
    return ctx


def test_no_basis_is_larger_than_its_size(flown):
    arm, rng = flown.arm, np.random.default_rng(3)
    terms, loads, term = FLIGHT.new("kc_terms_t"), FLIGHT.new("kc_loads_t"), FLIGHT.new("kc_term_t")
    at = [surroundings(arm, rng) for _ in range(60)]
    held = []
    for ctx in at:
        FLIGHT.lib.kc_model_loads(arm, terms, FLIGHT.ffi.NULL, ctx, loads)
        held.append(FLIGHT.copy(loads))
    checked = 0
    for name, var in VARIABLES.items():
        if name.startswith("PNP"):  # flight's tables hold none
            continue
        for index in indices(name, arm.n_joints):
            for fn in FUNCTIONS.values():
                basis = term.basis[0]
                basis.fn, basis.var, basis.index = fn, var, index
                basis.c0, basis.c1, term.gain = rng.uniform(-2, 2), rng.uniform(-3, 3), rng.uniform(-5, 5)
                size = FLIGHT.lib.kc_bounds_size(arm, term)
                for ctx, loads in zip(at, held, strict=True):
                    ctx.t_s = basis.c0 + rng.uniform(-1, 1) * FLIGHT.decimal("KC_BOUNDS_TIME_S")
                    value = term.gain * FLIGHT.lib.kc_basis_eval(FLIGHT.address(basis), ctx, loads)
                    assert abs(value) <= size * (1 + 1e-12), (name, index, fn)
                    checked += 1
    assert checked > 50_000


def test_the_size_of_a_torque_is_not_far_from_what_the_arm_meets(flown):
    arm, rng = flown.arm, np.random.default_rng(4)
    terms, loads, term = FLIGHT.new("kc_terms_t"), FLIGHT.new("kc_loads_t"), FLIGHT.new("kc_term_t")
    largest = np.zeros(arm.n_joints)
    for _ in range(2000):
        FLIGHT.lib.kc_model_loads(arm, terms, FLIGHT.ffi.NULL, surroundings(arm, rng), loads)
        largest = np.maximum(largest, np.abs(list(loads.tau)[: arm.n_joints]))
    for j in (1, 3):  # the joints that lift
        term.gain, term.basis[0].var, term.basis[0].index, term.basis[0].c1 = (
            1.0,
            VARIABLES["TAU"],
            j + 1,
            1.0,
        )
        assert largest[j] > 0.6 * FLIGHT.lib.kc_bounds_size(arm, term)


def test_the_tables_that_ship_belong_together(flown):
    terms = codec.decode_as("terms", (BIN / "terms.tbl").read_bytes())[1]
    assert flown.excess(terms) is None
    for number, name, frame in ((0, "J1.phi_rad", 0), (27, "J7.d_m", 6), (25, "J7.alpha_rad", 7)):
        wide = FLIGHT.copy(terms)
        assert FLIGHT.text(wide.coef[number].name) == name
        wide.coef[number].ub *= 1.001
        found = flown.excess(wide)
        assert found is not None and found.coefficient == name
        assert name in found.place and f"frame {frame}" in found.place
        assert found.sum == wide.coef[number].ub
        assert found.sum == pytest.approx(1.1 * 1.001 * found.verified)


def test_shared_bounds_use_all_that_is_allowed_and_no_more(flown):
    """Any coefficients at any place: flight accepts the bounds, and some place is full for each DH error."""
    rng = np.random.default_rng(5)
    for _ in range(50):
        terms = FLIGHT.new("kc_terms_t")
        FLIGHT.lib.kc_terms_add_dh(terms, 7, [1.0, 1.0, 1.0, 1.0])
        wanted = {}
        for c in range(28, 28 + rng.integers(1, 12)):
            wanted[c] = 10.0 ** rng.uniform(-5, 1)
            terms.coef[c].scale = terms.coef[c].enabled = 1
            terms.n_coef = c + 1
            for _ in range(rng.integers(1, 4)):
                term = terms.term[terms.n_term]
                terms.n_term += 1
                term.coef, term.frame, term.comp = c, rng.integers(0, 12), rng.integers(0, 6)
                term.frame = (
                    term.frame if term.frame <= 7 else FLIGHT.constant("KC_FRAME_TOOL") + term.frame % 3
                )
                term.gain = rng.uniform(-2, 2)
                term.basis[0].var, term.basis[0].index = VARIABLES["TAU"], rng.integers(1, 8)
                term.basis[0].c1 = 1.0
        bounds = shared_bounds(flown, terms, wanted)
        for c, bound in enumerate(bounds):
            terms.coef[c].lb, terms.coef[c].ub = -bound, bound
            assert bound > 0.0
            assert c < 28 or bound <= wanted[c]
        assert flown.excess(terms) is None
        for c in range(28):  # with a bit more of any DH error something is too wide
            terms.coef[c].ub *= 1.01
            assert flown.excess(terms) is not None
            terms.coef[c].ub = bounds[c]
