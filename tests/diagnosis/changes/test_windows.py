"""Windows as sums of products: laws of what is integrated out and drawn."""

import numpy as np
import pytest

from skat.diagnosis.changes.force_space import Rows
from skat.diagnosis.changes.windows import BAGS, Windows, drawn_windows, integrated

SPREAD = np.array([0.3, 2.0])


def rows_of(seed, *, windows=4, n=12, k=3):
    rng = np.random.default_rng(seed)
    stretch = np.repeat(np.arange(windows), n)
    zeros = np.zeros(len(stretch))
    target, columns = rng.normal(size=len(stretch)), rng.normal(size=(len(stretch), k))
    return Rows(target, columns, zeros.astype(int), zeros, stretch, zeros), rng.uniform(0.5, 2, len(stretch))


def covariance_of(rows, noise):
    """Return the covariance of rows whose first effects differ from window to window."""
    N = rows.columns[:, : len(SPREAD)]
    return np.diag(noise**2) + (N * SPREAD) @ N.T * (rows.stretch[:, None] == rows.stretch)


def test_windows_are_sums_of_products_of_whitened_rows():
    rows, noise = rows_of(0)
    windows = Windows.of(rows, noise)
    for place in range(4):
        own = rows.stretch == place
        N, weight = rows.columns[own], np.diag(noise[own] ** -2)
        np.testing.assert_allclose(windows.products[place], N.T @ weight @ N)
        np.testing.assert_allclose(windows.projections[place], N.T @ weight @ rows.target[own])


def test_without_effects_of_their_own_rows_have_the_covariance_that_these_make():
    rows, noise = rows_of(1)
    products, projections = Windows.of(rows, noise).without(SPREAD).every()
    covariance = covariance_of(rows, noise)
    np.testing.assert_allclose(products, rows.columns.T @ np.linalg.solve(covariance, rows.columns))
    np.testing.assert_allclose(projections, rows.columns.T @ np.linalg.solve(covariance, rows.target))


def test_effects_of_windows_take_their_share_of_what_is_left():
    rows, noise = rows_of(2)
    whole = np.sum((rows.target / noise) ** 2)
    left = rows.target @ np.linalg.solve(covariance_of(rows, noise), rows.target)
    assert Windows.of(rows, noise).own_share(SPREAD) == pytest.approx(whole - left, rel=1e-9)


def test_a_window_that_is_drawn_twice_counts_twice():
    rows, noise = rows_of(3)
    windows = Windows.of(rows, noise)
    products, projections = windows.drawn(np.array([2.0, 0.0, 1.0, 0.0]))
    np.testing.assert_allclose(products, 2 * windows.products[0] + windows.products[2])
    np.testing.assert_allclose(projections, 2 * windows.projections[0] + windows.projections[2])
    np.testing.assert_allclose(windows.every()[0], windows.products.sum(axis=0))
    np.testing.assert_allclose(windows.every()[1], windows.projections.sum(axis=0))


def test_each_log_of_drawn_windows_has_as_many_as_there_are():
    sides = [Windows.of(*rows_of(seed, windows=n)) for seed, n in ((4, 5), (5, 9))]
    drawn = drawn_windows(sides)
    assert len(drawn) == BAGS
    for side, n in enumerate((5, 9)):
        times = np.array([one[side] for one in drawn])
        assert times.shape == (BAGS, n)
        assert (times.sum(axis=1) == n).all()
        assert len(np.unique(times, axis=0)) > BAGS / 2
        # The number of times that a window is drawn has mean 1 and variance 1 - 1 / n.
        np.testing.assert_allclose(times.mean(axis=0), 1.0, atol=4 / np.sqrt(BAGS))
    assert all(
        np.array_equal(a, b) for one, two in zip(drawn, drawn_windows(sides)) for a, b in zip(one, two)
    )


def test_what_is_held_at_its_mean_is_integrated_out_to_nothing():
    rows, noise = rows_of(6)
    products, projections = Windows.of(rows, noise).every()
    held = integrated(products, projections, np.array([1]), np.array([1e12]))
    np.testing.assert_allclose(held[0], products, rtol=1e-6)
    np.testing.assert_allclose(held[1], projections, rtol=1e-6)


def test_units_that_differ_by_far_are_integrated_out_alike():
    rows, noise = rows_of(7)
    units = np.array([1e-9, 1e9, 1.0])
    products, projections = Windows.of(rows, noise).every()
    plain = integrated(products, projections, np.arange(2), 1 / SPREAD)
    scaled = integrated(
        products * units * units[:, None], projections * units, np.arange(2), units[:2] ** 2 / SPREAD
    )
    np.testing.assert_allclose(scaled[0] / units / units[:, None], plain[0], atol=1e-9)
    np.testing.assert_allclose(scaled[1] / units, plain[1], atol=1e-9)
