"""A log as blocks of smooth motion and rows of cosine coefficients, by hand; columns in another order."""

from types import SimpleNamespace

import numpy as np
import pytest
from scipy import signal

from skat.diagnosis.changes.mixups import _mixed_up
from skat.diagnosis.forces import force_space
from skat.diagnosis.forces.force_space import (
    KEPT,
    MOTION,
    Motion,
    Rows,
    _busy,
    _fewer,
    _log_variance,
    joined,
    smooth_motion,
    transformed,
)
from skat.diagnosis.forces.smoothing import smooth_coordinate

DT = 0.01


def machine(touching=()):
    """Return what is asked of a simulator of two joints, at some instants of which contacts push."""
    names = ("qpos.a", "qpos.b", "qvel.a", "qvel.b")

    def constrained(states):
        return np.isin(np.arange(len(states)), touching)

    return SimpleNamespace(
        dt=DT,
        state_names=names,
        residual_names=names,
        input_names=(*names, "ctrl.a", "ctrl.b"),
        units={"qpos.a": "rad", "qpos.b": "rad"},
        constrained=constrained,
    )


def rising(lengths=(400,)):
    """Return X, y and groups of two joints, of which each rises along a parabola anew in each episode."""
    tables, time = [], DT * np.arange(max(lengths) + 1)
    for length in lengths:
        q = np.column_stack([1 + 2 * time + 3 * time**2, -time - 0.5 * time**2])[: length + 1]
        tables.append((np.column_stack([q[:-1], np.full((length, 2), np.nan), q[:-1]]), q[1:]))
    X, y = (np.concatenate(one) for one in zip(*tables))
    return X, np.column_stack([y, np.full(y.shape, np.nan)]), np.repeat(np.arange(len(lengths)), lengths)


# -- blocks ----------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("lengths", [(400,), (300, 500)])
def test_blocks_have_the_mean_place_speed_and_acceleration_of_what_is_within_them(lengths):
    X, y, groups = rising(lengths)
    motion = smooth_motion(machine(), X, y, groups, window=1.0)
    n = motion.rows.shape[1]
    assert motion.duration == pytest.approx(n * DT)
    assert (np.diff(motion.rows, axis=1) == 1).all()
    assert (groups[motion.rows[:, 0]] == groups[motion.rows[:, -1]]).all()
    begin = DT * (motion.rows[:, 0] - np.r_[0, np.cumsum(lengths)][groups[motion.rows[:, 0]]])
    end = begin + motion.duration
    np.testing.assert_allclose(motion.accelerations, np.tile([6.0, -1.0], (len(begin), 1)), atol=1e-3)
    np.testing.assert_allclose(motion.states[:, 2], 2 + 3 * (begin + end), atol=1e-4)
    np.testing.assert_allclose(motion.states[:, 3], -1 - (begin + end) / 2, atol=1e-4)
    at = begin[:, None] + DT * np.arange(n + 1)
    means = np.trapezoid(1 + 2 * at + 3 * at**2, axis=1) / n
    np.testing.assert_allclose(motion.states[:, 0], means, atol=1e-5)
    np.testing.assert_array_equal(motion.commands, X[:, 4:])
    np.testing.assert_array_equal(motion.episodes, groups)
    # All of an episode but for what no whole block is left of.
    used = np.isin(np.arange(len(X)), motion.rows)
    assert [int((~used[groups == one]).sum()) for one in range(len(lengths))] == [
        length % n for length in lengths
    ]


def test_a_block_has_sixteen_in_a_window_at_least_and_stretches_are_about_a_window():
    X, y, groups = rising((800,))
    for window in (0.5, 1.0, 2.0):
        motion = smooth_motion(machine(), X, y, groups, window=window)
        assert window / motion.duration >= 16
        sizes = np.bincount(motion.stretches)
        assert np.ptp(sizes) <= 1
        assert sizes.mean() * motion.duration == pytest.approx(window, rel=0.2)
        assert (np.diff(motion.stretches) >= 0).all()
        assert (motion.cutoff <= 0.5 / motion.duration).all()


@pytest.mark.parametrize("touching", [[200], [0], [400], [150, 300]])
def test_two_instants_about_a_contact_are_left_out_with_it(touching):
    X, y, groups = rising()
    motion = smooth_motion(machine(touching), X, y, groups, window=0.32)
    n = motion.rows.shape[1]
    lost = np.zeros(401, dtype=bool)
    for one in touching:
        lost[max(one - 2, 0) : one + 3] = True
    usable = ~lost[:-1] & ~lost[1:]
    assert usable[motion.rows].all()
    # Between contacts blocks begin at once.
    starts = np.flatnonzero(usable & np.r_[True, ~usable[:-1]])
    assert set(starts) <= set(motion.rows[:, 0])
    assert usable.sum() - motion.rows.size < n * len(starts)
    stretches = [set(motion.stretches[motion.rows[:, 0] < start]) for start in starts[1:]]
    assert all(
        not own & set(motion.stretches[motion.rows[:, 0] >= start])
        for own, start in zip(stretches, starts[1:])
    )


def test_of_short_stretches_and_of_what_was_not_measured_nothing_is_left():
    X, y, groups = rising((60,))
    # 12 blocks of a row each.
    assert len(smooth_motion(machine([48]), X, y, groups, window=0.16).rows) == 45
    assert smooth_motion(machine(range(14, 61, 14)), X, y, groups, window=0.16) is None
    X[:, 0], y[:, 0] = np.nan, np.nan
    assert smooth_motion(machine(), X, y, groups, window=0.16) is None


@pytest.mark.parametrize("frequency", [2.0, 5.0])
@pytest.mark.parametrize(("share", "seen"), [(0.04, False), (0.06, True)])
def test_most_of_a_motion_is_below_its_fastest_part_that_is_not_small(frequency, share, seen):
    time = DT * (np.arange(1000) + 0.5)
    slow, fast = np.cos(2 * np.pi * frequency * time), np.cos(2 * np.pi * 20.0 * time)
    speed = np.sqrt(1 - share) * slow + np.sqrt(share) * fast
    for speeds, episodes in ((speed, np.zeros(1000)), (np.tile(speed, 2), np.repeat([0, 1], 1000))):
        assert _busy(speeds, episodes, DT, 0.95) == pytest.approx(20.0 if seen else frequency, rel=1e-6)
    assert np.isfinite(_busy(np.zeros(10), np.zeros(10), DT, 0.95))


def test_a_joint_is_compared_up_to_where_it_is_kept_and_busy():
    """The first is read with much noise, so that less is kept of it than it is fast; the second exactly."""
    rng, time = np.random.default_rng(0), DT * np.arange(601)
    q = np.column_stack(
        [np.sin(30 * time) + 0.3 * rng.normal(size=601), np.sin(5 * time) + 1e-6 * rng.normal(size=601)]
    )
    X, y = (np.column_stack([one, np.full((600, 2), np.nan)]) for one in (q[:-1], q[1:]))
    motion = smooth_motion(
        machine(), np.column_stack([X, np.zeros((600, 2))]), y, np.zeros(600, int), window=1.0
    )
    smooth = [smooth_coordinate(one, np.zeros(601), DT) for one in q.T]
    kept = [one.cutoff(KEPT, DT) for one in smooth]
    busy = [2 * _busy(one.velocity, np.zeros(601), DT, MOTION) for one in smooth]
    assert kept[0] < busy[0]
    assert kept[1] > busy[1]
    np.testing.assert_allclose(motion.cutoff, np.minimum([kept[0], busy[1]], 0.5 / motion.duration))
    np.testing.assert_allclose(motion.slip, [one.velocity_error for one in smooth])
    assert motion.rows.shape[1] == max(
        1, min(int(1 / (4 * DT * max(kept[0], busy[1]))), int(1.0 / (16 * DT)))
    )


@pytest.mark.parametrize("episodes", [1, 2])
@pytest.mark.parametrize("filtered", [None, 3.0])
def test_measured_efforts_are_compared_as_far_as_they_change(filtered, episodes):
    """Both joints swing once a second; the first motor drives the second joint too, which has none of its own."""
    rng, time = np.random.default_rng(0), DT * np.arange(2001)
    q = np.column_stack([np.sin(6 * time), np.sin(6 * time + 1)])
    q += 1e-3 * rng.normal(size=q.shape)
    efforts = np.column_stack([np.sign(np.cos(6 * time)), 1e-6 * rng.normal(size=len(time))])
    if filtered:
        taps = signal.butter(8, filtered, fs=1 / DT, output="sos")
        efforts[:, 0] = signal.sosfiltfilt(taps, efforts[:, 0])
    X, y = (np.column_stack([one, np.full((2000, 2), np.nan)]) for one in (q[:-1], q[1:]))
    groups = np.repeat(np.arange(episodes), 2000 // episodes)
    moments = np.array([[2.0, -3.0], [0.0, 0.0]])
    arm = machine()
    arm.missing_forces = lambda states, accelerations, commands, values: 1.0 - commands @ moments
    motion = smooth_motion(arm, np.column_stack([X, efforts[:-1]]), y, groups, window=2.0, measured=True)
    kept = [one.cutoff(KEPT, DT) for one in _smooth(X, y, groups)]
    if filtered:
        assert (motion.cutoff < filtered).all()
        assert (motion.cutoff > 0.5 * filtered).all()
    else:
        np.testing.assert_allclose(motion.cutoff, np.minimum(kept, 0.5 / motion.duration))
    assert min(kept) > 1.5 * 3.0


def _smooth(X, y, groups):
    """Return both joints' smoothed motion, an instant more in each episode than it has rows."""
    ends = np.flatnonzero(np.r_[np.diff(groups) != 0, True])
    instants = np.insert(X[:, :2], ends + 1, y[ends, :2], axis=0)
    episodes = np.insert(groups, ends + 1, groups[ends])
    return [smooth_coordinate(one, episodes, DT) for one in instants.T]


def test_of_a_long_log_stretches_from_all_over_it_are_compared(monkeypatch):
    monkeypatch.setattr(force_space, "MOST_BLOCKS", 100)
    stretch = np.repeat(np.arange(40), 5)
    rows = np.arange(200)[:, None]
    kept, own = _fewer(rows, stretch)
    assert len(kept) == 100
    assert own.tolist() == np.repeat(np.arange(20), 5).tolist()
    first = kept[::5, 0] // 5
    assert (first[0], first[-1]) == (0, 39)
    assert np.ptp(np.diff(first)) <= 1
    same, _ = _fewer(rows[:100], stretch[:100])
    assert same is not rows
    assert len(same) == 100
    few, _ = _fewer(rows, np.repeat([0, 1], 100))
    assert few[:, 0].tolist() == list(range(100))


# -- rows ------------------------------------------------------------------------------------------------------------


def motion_of(stretches, cutoff, duration=0.05):
    n = len(stretches)
    return Motion(
        np.zeros((n, 4)), np.zeros((n, 2)), np.zeros((n, 2)), np.zeros((n, 2, 2)), np.zeros((n, 2)), np.zeros(n, int),
        np.arange(n)[:, None], np.asarray(stretches), duration, np.zeros(2), np.asarray(cutoff),
    )  # fmt: skip


def test_rows_are_cosines_of_each_stretch_up_to_the_cutoff_of_each_joint():
    rng, stretches = np.random.default_rng(0), np.repeat([0, 1], [8, 5])
    forces = rng.normal(size=(13, 2, 3))
    motion = motion_of(stretches, [10.0, 5.0])
    coefficients, joint, frequency, stretch = transformed(motion, forces)
    for which, n in ((0, 8), (1, 5)):
        for one in range(2):
            mine = (joint == one) & (stretch == which)
            expected = np.arange(n) / (2 * n * 0.05)
            expected = expected[expected <= [10.0, 5.0][one]]
            np.testing.assert_allclose(frequency[mine], expected)
            place = (np.arange(n) + 0.5) * 0.05
            waves = np.cos(2 * np.pi * expected[:, None] * place)
            waves *= np.where(expected > 0, np.sqrt(2 / n), np.sqrt(1 / n))[:, None]
            np.testing.assert_allclose(
                coefficients[mine], waves @ forces[stretches == which, one], atol=1e-12
            )
    # Nothing is lost where no frequency is.
    whole = transformed(motion_of(stretches, [10.0, 10.0]), forces)[0]
    assert np.sum(whole**2) == pytest.approx(np.sum(forces**2))


def rows_of(n, start=0):
    own = start + np.arange(n)
    return Rows(own + 0.5, np.column_stack([own, -own]), own % 3, own / 10, own // 2, own**2.0)


def test_rows_of_two_logs_stand_one_after_the_other_and_parts_are_of_all():
    both = joined([rows_of(3), rows_of(4, 10)])
    assert both.target.tolist() == [0.5, 1.5, 2.5, 10.5, 11.5, 12.5, 13.5]
    part = both.part(np.arange(7) % 2 == 1)
    assert part.target.tolist() == [1.5, 10.5, 12.5]
    assert part.columns.tolist() == [[1, -1], [10, -10], [12, -12]]
    assert part.joint.tolist() == [1, 1, 0]
    assert part.frequency.tolist() == [0.1, 1.0, 1.2]
    assert part.stretch.tolist() == [0, 5, 6]
    assert part.nominal.tolist() == [1.0, 100.0, 144.0]
    z, N = part.whitened(np.array([1.0, 2.0, 4.0]))
    assert z.tolist() == [1.5, 5.25, 3.125]
    assert N.tolist() == [[1, -1], [5, -5], [3, -3]]


def test_a_curve_of_variances_is_the_likeliest():
    """The slope of the likelihood of squares vanishes there, wherever they begin."""
    rng, place = np.random.default_rng(0), np.linspace(0, 1, 80)
    curves = np.column_stack([np.ones(80), np.log(place + 0.02), place**2])
    squares = np.exp(curves @ [8.0, -1.0, 3.0]) * rng.chisquare(1, 80)
    found = _log_variance(curves, squares)
    np.testing.assert_allclose(curves.T @ (squares * np.exp(-curves @ found) - 1), 0, atol=0.1)
    np.testing.assert_allclose(_log_variance(curves, 1e6 * squares) - found, [np.log(1e6), 0, 0], atol=0.02)


# -- columns in another order ----------------------------------------------------------------------------------------


def a_half(seed=0):
    rng = np.random.default_rng(seed)
    return Motion(
        rng.normal(size=(6, 4)), rng.normal(size=(6, 2)), rng.normal(size=(6, 2)), rng.normal(size=(6, 3, 2)),
        rng.normal(size=(12, 2)), np.zeros(12, int), np.arange(12).reshape(6, 2), np.zeros(6, int), 0.1, np.ones(2),
        np.array([3.0, 5.0]),
    )  # fmt: skip


def parts(half):
    velocities = half.velocities.mean(axis=1)
    return np.column_stack([half.states, half.accelerations, velocities, half.speeds]), half.commands


def test_columns_may_have_their_sign_turned_or_be_in_each_other_s_place():
    half, both = a_half(), parts(a_half())
    expected = {
        "ctrl.a has its sign turned": (list(range(10)), np.ones(10), [0, 1], [-1, 1]),
        "ctrl.b has its sign turned": (list(range(10)), np.ones(10), [0, 1], [1, -1]),
        "ctrl.a and ctrl.b are swapped": (list(range(10)), np.ones(10), [1, 0], [1, 1]),
        "qpos.a has its sign turned": (list(range(10)), np.tile([-1, 1], 5), [0, 1], [1, 1]),
        "qpos.b has its sign turned": (list(range(10)), np.tile([1, -1], 5), [0, 1], [1, 1]),
        "qpos.a and qpos.b are swapped": ([1, 0, 3, 2, 5, 4, 7, 6, 9, 8], np.ones(10), [0, 1], [1, 1]),
    }
    found = _mixed_up(machine(), half)
    assert [name for name, _ in found] == list(expected)
    for name, other in found:
        order, signs, order_of_commands, signs_of_commands = expected[name]
        moved, commands = parts(other)
        np.testing.assert_array_equal(moved, both[0][:, order] * signs)
        np.testing.assert_array_equal(commands, both[1][:, order_of_commands] * signs_of_commands)
        # What two joints have in each other's place is told up to where either is.
        cutoff = [3.0, 3.0] if name.startswith("qpos.a and") else [3.0, 5.0]
        assert other.cutoff.tolist() == cutoff
        # Mixed up once more, it is as it was.
        again = dict(_mixed_up(machine(), other))[name]
        for one, own in zip(parts(again), both):
            np.testing.assert_array_equal(one, own)


def test_only_joints_of_one_unit_are_taken_for_each_other():
    one = machine()
    one.units["qpos.b"] = "m"
    assert "qpos.a and qpos.b are swapped" not in dict(_mixed_up(one, a_half()))
