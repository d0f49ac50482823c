"""Sessions whose clocks began anew are put one after another."""

import numpy as np
import pytest

from kincal import workbench as wb
from kincal.workbench.data.clock import one_clock
from kincal.workbench.data.readers import read_measurements

N = 40


def session(seed, *, jitter=0.2, first="a"):
    """Poses every 6 s, more or less, from 0 on."""
    rng = np.random.default_rng(seed)
    t_s = np.cumsum(6.0 * np.exp(jitter * rng.normal(size=N)))
    q = rng.uniform(-1, 1, (N, 2))
    return wb.Measurements(
        source="made", ids=tuple(f"{first}{k}" for k in range(N)), q=q, p_m=q[:, [0, 1, 1]], t_s=t_s - t_s[0]
    )


def both(a, b):
    """Rows of two sessions in one file."""
    return wb.Measurements(
        source="made", ids=a.ids + b.ids, q=np.vstack([a.q, b.q]), p_m=np.vstack([a.p_m, b.p_m]),
        t_s=np.concatenate([a.t_s, b.t_s]),
    )  # fmt: skip


@pytest.mark.parametrize("jitter", [0.0, 0.2, 0.6])
def test_a_clock_that_begins_anew_in_a_file_goes_on_after_a_break(jitter):
    a, b = session(1, jitter=jitter), session(2, jitter=jitter, first="b")
    data = one_clock(both(a, b))
    np.testing.assert_array_equal(data.t_s[:N], a.t_s)
    np.testing.assert_allclose(np.diff(data.t_s[N:]), np.diff(b.t_s))
    assert data.t_s[N] - data.t_s[N - 1] == pytest.approx(10 * np.median(np.diff(a.t_s)))
    assert "t_s starts again where another session begins" in data.notes[-1]


@pytest.mark.parametrize("jitter", [0.0, 0.2, 0.6])
def test_one_session_in_two_parts_keeps_its_times(jitter):
    whole = session(1, jitter=jitter)
    rng = np.random.default_rng(3)
    for chosen in (rng.permutation(N) < N // 2, rng.permutation(N) < N // 4, np.arange(N) % 2 == 0):
        parts = both(whole.take(chosen), whole.take(~chosen))
        assert one_clock(parts) is parts
    shuffled = whole.take(rng.permutation(N))
    assert one_clock(shuffled) is shuffled
    later = session(2, jitter=jitter)
    later.t_s[:] += 1000.0
    together = both(whole, later)
    assert one_clock(together) is together


def written(data, file):
    rows = np.column_stack([data.t_s, data.q, data.p_m])
    text = "\n".join(f"{k}," + ",".join(f"{x:.9f}" for x in row) for k, row in enumerate(rows))
    file.write_text("id,t_s,q1,q2,px,py,pz\n" + text + "\n")
    return file


def test_files_are_sessions_in_the_order_given(tmp_path):
    a, b = (written(session(seed), tmp_path / f"{seed}.csv") for seed in (1, 2))
    data = read_measurements([b, a], 2)
    assert (np.diff(data.t_s) > 0.0).all()
    np.testing.assert_allclose(data.q[:N], session(2).q, atol=1e-8)
    assert sum("t_s starts again" in note for note in data.notes) == 1
    one = read_measurements(a, 2)  # a part of a file beside it is no session of its own
    assert (
        read_measurements([a, written(session(1).take(np.arange(10, 30)), tmp_path / "p.csv")], 2).n == one.n
    )


def test_three_sessions_in_one_file_are_approached_from_where_each_was():
    parts = [session(seed) for seed in (1, 2, 3)]
    data = one_clock(both(both(parts[0], parts[1]), parts[2]))
    assert (np.diff(data.t_s) > 0.0).all()
    assert "2 other sessions begin" in data.notes[-1]


def test_readings_at_rest_do_not_hide_that_a_clock_starts_again():
    def read_twice(data, seconds):
        twice = data.take(np.repeat(np.arange(N), 2))
        twice.t_s[1::2] += seconds
        return wb.Measurements(source="made", ids=tuple(f"{name}{k}" for k, name in enumerate(twice.ids)),
                               q=twice.q, p_m=twice.p_m, t_s=twice.t_s)  # fmt: skip

    a, b = read_twice(session(1), 0.5), read_twice(session(2, first="b"), 0.5)
    assert (np.diff(one_clock(both(a, b)).t_s) > 0.0).all()


def test_twelve_short_sessions():
    parts = [session(seed, first=f"{seed}.").take(np.arange(8)) for seed in range(12)]
    data = parts[0]
    for part in parts[1:]:
        data = both(data, part)
    assert (np.diff(one_clock(data).t_s) > 0.0).all()


def test_seconds_of_the_day_go_on_over_midnight():
    data = session(1)
    data.t_s[:] = (data.t_s + 86400.0 - 100.0) % 86400.0
    found = one_clock(data)
    assert (np.diff(found.t_s) > 0.0).all() and "seconds of the day" in found.notes[-1]
    np.testing.assert_allclose(np.diff(found.t_s), np.diff(session(1).t_s))


def test_seconds_of_three_days(tmp_path):
    days = [session(seed) for seed in (1, 2, 3)]
    for day, hour in zip(days, (14, 10, 12), strict=True):
        day.t_s[:] += 3600.0 * hour
    files = [written(day, tmp_path / f"{k}.csv") for k, day in enumerate(days)]
    assert (np.diff(read_measurements(files, 2).t_s) > 0.0).all()
    a, b = session(1), session(2)
    b.t_s[:] += 1000.0  # one clock, the later part first
    data = read_measurements([written(b, tmp_path / "b.csv"), written(a, tmp_path / "a.csv")], 2)
    assert data.t_s[0] == pytest.approx(1000.0) and data.t_s[N] == 0.0
