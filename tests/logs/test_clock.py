"""Clocks of logs: their unit, the even grid behind them, what is lost, and grids of another step."""

from dataclasses import replace

import numpy as np
import pytest

from skat.logs.clock import even_times, evened, in_seconds, pieces, refined, resampled, usual_step
from skat.logs.errors import LogError

TICK = 1 / 64  # s, exact in binary


def placed(times, labels=None, names=("run",), dt=TICK, moves=None):
    """Return pieces, their step and notes of rows whose positions need not be asked for."""
    labels = np.zeros(len(times), dtype=int) if labels is None else np.asarray(labels)

    def positions():
        assert moves is not None, "an even clock asks for no positions"
        return moves

    return pieces(np.asarray(times, float), labels, list(names), dt, "row {}".format, positions)


@pytest.mark.parametrize("rate", [2.5, 10.0, 50.0, 400.0, 2000.0])
@pytest.mark.parametrize(("unit", "size"), [("s", 1.0), ("ms", 1e-3), ("us", 1e-6), ("ns", 1e-9)])
def test_the_unit_of_a_clock_is_one_in_which_a_robot_logs(rate, unit, size):
    seconds = np.arange(40) / rate
    if unit == "ms" and rate > 1000:
        return  # half a millisecond from row to row may as well be half a second
    found, said, origin = in_seconds(seconds / size, None, "column t")
    assert (said, origin) == (unit, 0.0)
    np.testing.assert_allclose(found, seconds, rtol=1e-12)


def test_a_row_each_second_is_no_robots_log_and_one_each_millisecond_is():
    assert in_seconds(np.arange(9.0), None, "t")[1] == "ms"
    assert in_seconds(np.arange(9) * 0.99, None, "t")[1] == "s"
    assert in_seconds(np.arange(9) * 500.0, None, "t")[1] == "us"
    assert in_seconds(np.arange(9) * 499.0, None, "t")[1] == "ms"


@pytest.mark.parametrize("unit", ["s", "ms", "us", "ns"])
def test_dates_in_any_unit_begin_at_zero(unit):
    factor = {"s": 1.0, "ms": 1e3, "us": 1e6, "ns": 1e9}[unit]
    stamps = (1.7e9 + np.arange(50) / 64) * factor
    found, said, origin = in_seconds(stamps, None, "t")
    assert said == unit
    assert origin * int(factor) == stamps[0]
    np.testing.assert_allclose(found, np.arange(50) / 64, atol=1e-6)
    # The dates of another stream of the log count from the same moment.
    later, _, same = in_seconds(stamps + 3 * factor, unit, "t", origin)
    np.testing.assert_allclose(later - found, 3.0, atol=1e-6)
    assert same == origin


@pytest.mark.parametrize("kind", ["s", "ms", "us", "ns", "ISO 8601"])
@pytest.mark.parametrize("other", ["s", "ms", "us", "ns", "ISO 8601"])
def test_dates_of_two_streams_count_from_one_moment_whatever_their_units(kind, other):
    def written(unit, steps):
        if unit == "ISO 8601":
            return np.array([f"2024-05-01T12:00:{step / 64:09.6f}Z" for step in steps], dtype=object)
        return (1714564800 + steps / 64) * {"s": 1.0, "ms": 1e3, "us": 1e6, "ns": 1e9}[unit]

    steps = np.arange(3, 20)
    found, unit, origin = in_seconds(written(kind, steps), None, "t")
    assert unit == kind
    np.testing.assert_allclose(found, (steps - 3) / 64, rtol=0, atol=1e-6)
    later, unit, same = in_seconds(written(other, steps + 5), None, "t", origin)
    assert (unit, same) == (other, origin)
    np.testing.assert_allclose(later, (steps + 2) / 64, rtol=0, atol=1e-6)


def test_clocks_since_the_machine_was_switched_on_keep_their_numbers():
    stamps = 86_400 + np.arange(20) / 64
    found, unit, origin = in_seconds(stamps, None, "t")
    assert (unit, origin) == ("s", 0.0)
    np.testing.assert_array_equal(found, stamps)
    np.testing.assert_allclose(in_seconds(stamps, "s", "t", 86_400.0)[0], np.arange(20) / 64)
    milliseconds, unit, origin = in_seconds(stamps * 1e3, "ms", "t")
    assert (unit, origin) == ("ms", 0.0)
    np.testing.assert_allclose(milliseconds, stamps, rtol=1e-14)


def test_a_missing_first_stamp_hides_neither_date_nor_unit():
    stamps = np.r_[np.nan, 1.7e12 + np.arange(20) * 10.0]
    found, unit, origin = in_seconds(stamps, None, "t")
    assert (unit, origin) == ("ms", 1.7e9)
    np.testing.assert_allclose(found[1:], np.arange(20) * 0.01, atol=1e-6)


def test_texts_are_seconds_since_the_first_of_them():
    texts = np.array([None, "2024-05-01T12:00:00.010Z", "2024-05-01T12:00:01.510Z", None], dtype=object)
    found, unit, origin = in_seconds(texts, None, "t")
    assert unit == "ISO 8601"
    np.testing.assert_allclose(found, [np.nan, 0.0, 1.5, np.nan], atol=1e-6)
    later, _, _ = in_seconds(texts[2:3], None, "t", origin)
    np.testing.assert_allclose(later, [1.5], atol=1e-6)


@pytest.mark.parametrize("unit", ["m", "rad", "fortnight"])
def test_a_unit_of_something_else_is_refused(unit):
    with pytest.raises(LogError, match="none of time"):
        in_seconds(np.arange(9.0), unit, "t")


def test_usual_step_is_that_within_episodes():
    times = np.r_[np.arange(10) * 0.1, 50 + np.arange(10) * 0.1]
    apart = np.zeros(20, dtype=bool)
    apart[[0, 10]] = True
    assert usual_step(times, apart, "t") == pytest.approx(0.1)
    two = np.array([0.0, 7.0, 7.5])
    assert usual_step(two, np.array([True, True, False]), "t") == pytest.approx(0.5)


def test_five_steps_of_a_hundred_may_go_back():
    def clock(n_back):
        steps = np.ones(100)
        steps[10 : 10 + 2 * n_back : 2] = -1
        return np.r_[0, np.cumsum(steps)]

    apart = np.r_[True, np.zeros(100, dtype=bool)]
    assert usual_step(clock(5), apart, "t") == 1.0
    with pytest.raises(LogError, match="6% of the steps go back"):
        usual_step(clock(6), apart, "t")
    with pytest.raises(LogError, match="it stands still"):
        usual_step(np.zeros(101), apart, "t")


def test_an_even_clock_is_its_own_grid():
    (piece,), dt, notes = placed(3.0 + np.arange(30) * TICK)
    assert notes == []
    assert dt == pytest.approx(TICK, rel=1e-12)
    assert (piece.name, piece.size, piece.spacing, piece.slip) == ("run", 30, dt, 0.0)
    assert piece.start == pytest.approx(3.0)
    np.testing.assert_array_equal(piece.slots, np.arange(30))
    np.testing.assert_array_equal(piece.rows, np.arange(30))
    np.testing.assert_allclose(piece.command_times, piece.times, atol=1e-12)


@pytest.mark.parametrize("n_lost", [1, 2, 9, 10])
def test_lost_rows_leave_their_places_empty(n_lost):
    places = np.r_[np.arange(20), 20 + n_lost + np.arange(15)]
    (piece,), _, notes = placed(places * TICK)
    np.testing.assert_array_equal(piece.slots, places)
    assert piece.size == 35 + n_lost
    assert notes[-1].startswith(f"{n_lost} of {35 + n_lost} rows are lost ({n_lost / (35 + n_lost):.2g} ")


def test_a_gap_of_more_than_ten_rows_begins_another_episode():
    places = np.r_[np.arange(20), 31 + np.arange(15)]
    (first, second), dt, notes = placed(places * TICK)
    assert "1 gaps of more than 10 rows" in notes[0]
    assert len(notes) == 1
    assert (first.name, second.name) == ("run", "run (2)")
    assert (first.size, second.size) == (20, 15)
    assert second.start == pytest.approx(31 * TICK)
    np.testing.assert_array_equal(second.rows, np.arange(20, 35))
    assert dt == pytest.approx(TICK, rel=1e-12)


@pytest.mark.parametrize("offset", [0, 1, 2])
def test_a_clock_that_restarts_begins_an_episode(offset):
    places = np.r_[np.arange(20), offset + np.arange(25)]
    (first, second), _, notes = placed(places * TICK)
    assert notes == ["The clock starts anew 1 times: an episode each."]
    assert (first.size, second.size) == (20, 25)
    assert second.start == pytest.approx(offset * TICK)


def test_a_clock_that_goes_back_to_the_middle_is_refused_at_its_row():
    places = np.r_[np.arange(20), 3 + np.arange(25)]
    with pytest.raises(LogError, match=r"row 20: time goes back by 0.25 s"):
        placed(places * TICK)
    # A restart before it excuses it not, nor one after it.
    with pytest.raises(LogError, match="row 40: time goes back"):
        placed(np.r_[np.arange(20), np.arange(20), 9 + np.arange(25)] * TICK)
    # The same within the second of two episodes, whose beginning is not the first's.
    labels = np.r_[np.zeros(10, int), np.ones(35, int)]
    with pytest.raises(LogError, match="row 30: time goes back"):
        placed(np.r_[np.arange(10), 5 + np.arange(20), 8 + np.arange(15)] * TICK, labels, ("a", "b"))


def test_rows_that_repeat_a_time_are_left_out():
    places = np.r_[0, 0, np.arange(1, 12), 11, 11, 12]
    (piece,), _, notes = placed(places * TICK, moves=np.sin(places)[:, np.newaxis])
    assert notes == ["3 rows repeat the time of the row before: left out."]
    np.testing.assert_array_equal(piece.slots, np.arange(13))
    np.testing.assert_array_equal(places[piece.rows], np.arange(13))


def test_a_clock_that_is_too_coarse_for_its_rows_is_refused_with_their_rate():
    rows = np.arange(200)
    stamps = 1.7e9 + (rows + 7) // 40
    seconds, unit, _ = in_seconds(stamps, None, "t")
    assert unit == "s"
    with pytest.raises(LogError, match=r"row 1: 97% of the rows repeat the time .* positions move") as caught:
        placed(seconds, dt=1.0, moves=np.sin(rows)[:, np.newaxis])
    assert caught.value.options == {"columns": {"time": "-"}, "rate": 40.0}
    assert "a column of times that are finer" in str(caught.value)
    # Few such rows, or copies, are left out.
    few = np.delete(np.arange(101), 50)[np.r_[0:50, 49, 50:100]]
    assert len(placed(few * TICK)[0][0].rows) == 100
    twice = np.repeat(np.arange(50), 2)
    assert len(placed(twice * TICK, moves=np.sin(twice)[:, np.newaxis])[0][0].rows) == 50


def test_microseconds_since_a_controllers_start_are_no_date():
    assert in_seconds(1.2e9 + 1e4 * np.arange(9), None, "t")[1] == "us"
    assert in_seconds(1.2e9 + np.arange(9), None, "t")[1] == "s"


def test_episodes_keep_their_labels_names_and_beginnings():
    labels = np.repeat([1, 0, 1], 12)
    times = np.r_[np.arange(12), 100 + np.arange(12), 200 + np.arange(12)] * TICK
    found, _, notes = placed(times, labels, ("left", "right"))
    assert [piece.name for piece in found] == ["right", "left", "right (2)"]
    assert [piece.start for piece in found] == pytest.approx([0.0, 100 * TICK, 200 * TICK])
    assert notes == []


@pytest.mark.parametrize("is_late", [True, False])
def test_positions_tell_whether_stamps_or_samples_jitter(is_late):
    rng = np.random.default_rng(3)
    even = np.arange(200) * TICK
    stamps = even + rng.uniform(-0.2, 0.2, size=200) * TICK
    seen = even if is_late else stamps
    moves = np.column_stack([np.sin(3 * seen), np.cos(2 * seen), np.zeros(200)])
    (piece,), dt, notes = placed(stamps, moves=moves)
    assert dt == pytest.approx(TICK, rel=1e-3)
    assert "ms" in notes[0]
    assert float(notes[0].split("by up to ")[1].split(" ms")[0]) == pytest.approx(0.2e3 * TICK, rel=0.15)
    if is_late:
        assert "stamps jitter" in notes[0]
        np.testing.assert_array_equal(piece.slots, np.arange(200))
    else:
        assert "interpolated" in notes[0]
        assert piece.slots is None
        assert piece.start == stamps[0]
        np.testing.assert_array_equal(piece.command_times, stamps)


@pytest.mark.parametrize("seed", range(6))
def test_samples_whose_clock_has_no_beat_are_uneven(seed):
    """Each row follows the one before, however late that was."""
    rng = np.random.default_rng(seed)
    stamps = np.r_[0, np.cumsum(1 + rng.uniform(-0.1, 0.1, size=199))] * TICK
    moves = np.sin(4 * stamps)[:, np.newaxis] + 5e-4 * rng.normal(size=(200, 1))
    (piece,), _, _ = placed(stamps, moves=moves)
    assert piece.slots is None


@pytest.mark.parametrize("seed", range(6))
def test_stamps_that_jitter_at_rest_leave_rows_as_they_were_measured(seed):
    rng = np.random.default_rng(seed)
    places = np.arange(200)
    stamps = (places + np.where(places < 5, rng.uniform(-0.4, 0.4, size=200), 0)) * TICK
    moves = np.sin(np.maximum(places - 20, 0) * TICK)[:, np.newaxis] + 1e-4 * rng.normal(size=(200, 1))
    (piece,), _, notes = placed(stamps, moves=moves)
    np.testing.assert_array_equal(piece.slots, places)
    assert "stamps jitter" in notes[0]


@pytest.mark.parametrize("share", [0.005, 0.02])
def test_a_hundredth_of_a_row_is_no_jitter(share):
    rng = np.random.default_rng(4)
    stamps = (np.arange(100) + share * rng.choice([-1.0, 1.0], size=100)) * TICK
    moves = np.sin(stamps)[:, np.newaxis]
    (piece,), _, notes = placed(stamps, moves=moves)
    assert (piece.slots is not None) == (share < 0.01)
    assert bool(notes) == (share > 0.01)


@pytest.mark.parametrize("guess", [0.995, 1.0, 1.01])
def test_a_refined_step_is_that_of_all_pieces_whatever_their_beginnings(guess):
    times = np.r_[np.arange(30) * TICK, 17.3 + np.arange(40) * TICK, 99.0]
    groups = [np.arange(30), np.arange(30, 70), np.array([70])]
    assert refined(times, groups, guess * TICK) == pytest.approx(TICK, rel=1e-12)
    assert refined(times, [np.arange(2)], 1.01 * TICK) == 1.01 * TICK
    assert refined(times, [np.arange(3)], 1.01 * TICK) == pytest.approx(TICK)


@pytest.mark.parametrize("lateness", [0.05, 0.1])
@pytest.mark.parametrize(("n_rows", "n_lost"), [(300, 0), (300, 1), (5000, 60)])
def test_late_stamps_change_no_step_and_take_no_place(lateness, n_rows, n_lost):
    rng = np.random.default_rng(8)
    places = np.delete(np.arange(n_rows), rng.choice(np.arange(20, n_rows - 20), n_lost, replace=False))
    stamps = (places + rng.exponential(lateness, size=len(places))) * TICK
    (piece,), dt, notes = placed(stamps, moves=np.sin(places * TICK)[:, np.newaxis])
    assert dt == pytest.approx(TICK, rel=2 * lateness / n_rows)
    assert "stamps jitter" in notes[0]
    assert piece.size == n_rows
    # A stamp that is late by half a row may stand on the other side of a row that is lost beside it.
    assert np.mean(piece.slots == places) > 0.998


def test_a_row_lost_in_the_very_middle_is_lost():
    places = np.delete(np.arange(101), 50)
    (piece,), dt, _ = placed(places * TICK)
    np.testing.assert_array_equal(piece.slots, places)
    assert dt == pytest.approx(TICK, rel=1e-12)


@pytest.mark.parametrize("n_rows", [300, 5000])
def test_a_step_in_whole_milliseconds_is_that_of_all_rows(n_rows):
    stamps = np.round(np.arange(n_rows) / 60, 3)
    step = refined(stamps, [np.arange(n_rows)], float(np.median(np.diff(stamps))))
    assert step == pytest.approx(1 / 60, rel=0.1 / n_rows)


def test_error_of_even_times_is_what_is_said_of_it():
    rng = np.random.default_rng(5)
    even = np.arange(400) * TICK
    errors, said = [], []
    for _ in range(200):
        stamps = even + 0.05 * TICK * rng.normal(size=400)
        found, slip = even_times(stamps, refined(stamps, [np.arange(400)], TICK))
        errors.append(found - even)
        said.append(slip)
    assert np.sqrt(np.mean(np.square(errors))) == pytest.approx(np.mean(said), rel=0.2)


def test_two_samples_at_one_place_have_no_even_times():
    assert even_times(np.array([0.0, 1.0, 2.0, 2.2, 3.0, 4.0]) * TICK, TICK) is None


def test_an_even_grid_begins_and_ends_within_the_samples():
    rng = np.random.default_rng(6)
    stamps = 2.0 + (np.arange(50) + rng.uniform(-0.2, 0.2, size=50)) * TICK
    moves = np.sin(stamps)[:, np.newaxis]
    (piece,), dt, _ = placed(stamps, moves=moves)
    found = evened(piece)
    last = found.start + (found.size - 1) * dt
    assert piece.times[0] - 0.01 * dt <= found.start < piece.times[0] + dt
    assert piece.times[-1] - dt < last <= piece.times[-1] + 0.01 * dt
    np.testing.assert_allclose(found.command_times, 2.0 + np.arange(50) * TICK, atol=0.1 * TICK)
    np.testing.assert_array_equal(found.command_times, found.acts)
    # The grid is that from whose places commands act.
    places = (found.start - found.acts) / dt
    np.testing.assert_allclose(places, np.rint(places), atol=1e-9)
    assert evened(replace(piece, times=np.zeros(50))) is None


@pytest.mark.parametrize("every", [2, 3])
def test_a_whole_factor_is_a_coarser_grid_from_the_first_row_on(every):
    late = np.random.default_rng(9).uniform(0, 0.2, size=29) * TICK
    places = np.r_[np.arange(12), np.arange(14, 31)]
    found, dt, _ = placed(1.0 + places * TICK + late, moves=np.sin(places * TICK)[:, np.newaxis])
    (piece,), how = resampled(found, dt, every * dt)
    assert how == f"Of {every} rows one is taken, with the mean command over them."
    assert (piece.start, piece.spacing) == (found[0].start, pytest.approx(every * dt))
    assert piece.size == len(range(0, 31, every))
    # All rows stay, at their even times: what is between those that are taken tells the commands.
    np.testing.assert_array_equal(piece.rows, found[0].rows)
    np.testing.assert_allclose(piece.times, piece.start + dt * places, rtol=1e-12)


def test_the_same_step_takes_the_rows_as_they_are():
    found, dt, _ = placed(np.arange(30) * TICK)
    assert resampled(found, dt, TICK) == (found, "")
    assert resampled(found, dt, 1.0005 * TICK) == (found, "")
    assert resampled(found, dt, 1.2 * TICK, same=True) == (found, "")
    assert "Interpolated from 64 to " in resampled(found, dt, 1.2 * TICK)[1]
    uneven = [replace(found[0], slots=None)]
    (piece,), how = resampled(uneven, dt, TICK)
    assert (piece.size, how) == (30, "")
    assert "Interpolated" in resampled(uneven, dt, 2 * TICK)[1]


@pytest.mark.parametrize("step", [0.5, 0.7, 1.5, 2.01])
def test_interpolated_grid_begins_with_the_samples_and_ends_before_them(step):
    found, dt, _ = placed(4.0 + np.arange(31) * TICK)
    (piece,), how = resampled(found, dt, step * TICK)
    assert how == f"Interpolated from 64 to {64 / step:.6g} rows per second."
    assert piece.slots is None
    assert (piece.start, piece.spacing) == (pytest.approx(4.0), step * TICK)
    assert piece.size == len(np.arange(0, 30 + 1e-3, step))


def test_one_uneven_episode_makes_the_clock_uneven():
    stamps = 50 + (np.arange(100) + np.random.default_rng(7).uniform(-0.2, 0.2, size=100)) * TICK
    times = np.r_[np.arange(100) * TICK, stamps]
    moves = np.sin(3 * times)[:, np.newaxis]
    for order in (slice(None), slice(None, None, -1)):
        labels = np.repeat([0, 1], 100)
        both = [times[:100], times[100:]][order]
        places = [moves[:100], moves[100:]][order]
        found, _, notes = placed(np.concatenate(both), labels, ("a", "b"), moves=np.concatenate(places))
        assert "interpolated" in notes[0]
        assert all(piece.slots is None for piece in found)
