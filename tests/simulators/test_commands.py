"""What acts of commands, against sums over the whole history of an episode."""

import numpy as np
import pytest

from skat.simulators.commands import CommandPath, delayed_controls, filtered

DT, N_SUBSTEPS = 0.02, 4


def path(n=1, **changes):
    zeros = dict.fromkeys(("bias", "held", "delay", "lag", "dead_zone"), 0.0)
    parts = zeros | {"scale": 1.0} | changes
    return CommandPath(**{name: np.broadcast_to(value, n).copy() for name, value in parts.items()})


def by_hand(commands, *, held=0.0, delay=0.0, lag=0.0, n_past=100):
    """Return what acts in the time steps of one episode whose first command has held for long."""
    steps = np.repeat(np.r_[np.full(n_past, commands[0]), commands], N_SUBSTEPS)
    moments = np.arange(len(steps)) - delay / (DT / N_SUBSTEPS)
    moments -= np.ceil(held / (DT / N_SUBSTEPS) - 1e-9)
    late = np.interp(moments, np.arange(len(steps)), steps)
    if lag:
        # The solution of a filter's equation at many moments of a step, and the mean of them.
        moments = DT / N_SUBSTEPS * (np.arange(1000) + 0.5) / 1000
        held, shown = late[0], []
        for one in late:
            shown.append(np.mean(one + (held - one) * np.exp(-moments / lag)))
            held = one + (held - one) * np.exp(-DT / N_SUBSTEPS / lag)
        late = np.array(shown)
    return late[n_past * N_SUBSTEPS :].reshape(-1, N_SUBSTEPS)


COMMANDS = np.random.default_rng(0).normal(size=(12, 2))
STARTS = np.array([0] * 5 + [5] * 1 + [6] * 6)


@pytest.mark.parametrize("delay", [0.0, 0.002, 0.005, 0.0125, 0.02, 0.033, 0.06])
@pytest.mark.parametrize("lag", [0.0, 0.007])
@pytest.mark.parametrize("held", [0.0, 0.005, 0.0199])
def test_late_and_filtered_commands_are_those_of_their_own_episode(held, delay, lag):
    mixed = path(2, held=[held, 0.0], delay=[delay, 0.01], lag=[lag, 0.0])
    found = mixed.acting(COMMANDS, STARTS, DT, N_SUBSTEPS)
    assert found.shape == (12, N_SUBSTEPS, 2)
    for rows in (slice(0, 5), slice(5, 6), slice(6, 12)):
        first, second = COMMANDS[rows].T
        np.testing.assert_allclose(
            found[rows, :, 0], by_hand(first, held=held, delay=delay, lag=lag), atol=1e-7
        )
        np.testing.assert_allclose(found[rows, :, 1], by_hand(second, delay=0.01), atol=1e-12)


def test_a_command_is_scaled_and_shifted_before_its_dead_zone_takes_from_it():
    commands = np.array([[-2.0], [-0.5], [0.0], [0.3], [1.0]])
    found = path(scale=2.0, bias=0.1, dead_zone=0.4).acting(commands, np.arange(5), DT, 2)
    np.testing.assert_allclose(found[:, :, 0], np.array([[-3.5, -0.5, 0.0, 0.3, 1.7]]).T * [1.0, 1.0])


@pytest.mark.parametrize(
    ("part", "value"),
    [("scale", 0.9), ("bias", 0.1), ("held", 0.1), ("delay", 0.1), ("lag", 0.1), ("dead_zone", 0.1)],
)
def test_any_part_of_any_actuator_changes_commands(part, value):
    neutral = 1.0 if part == "scale" else 0.0
    assert path(2, **{part: [neutral, value]}).changes
    assert not path(2).changes


@pytest.mark.parametrize(
    ("delay", "n_lags"), [(0.0, 0), (0.001, 1), (0.02, 1), (0.02 + 1e-12, 1), (0.0201, 2), (0.06, 3)]
)
def test_as_many_rows_are_on_the_way_as_the_longest_delay_has_begun(delay, n_lags):
    assert path(2, delay=[delay / 2, delay]).n_lags(DT, N_SUBSTEPS) == n_lags
    assert path(0).n_lags(DT, N_SUBSTEPS) == 0


def test_without_a_delay_or_a_filter_controls_are_what_was_sent():
    sent = np.repeat(COMMANDS[:, None], 3, axis=1)
    np.testing.assert_array_equal(delayed_controls(COMMANDS, None, 0.0, 3), sent)
    np.testing.assert_array_equal(filtered(sent, STARTS, [0.0, 0.0]), sent)
    one = filtered(sent, STARTS, [0.0, 1.5])
    np.testing.assert_array_equal(one[..., 0], sent[..., 0])
    assert np.abs(one - sent)[1:5, :, 1].min() > 0
