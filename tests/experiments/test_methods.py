import numpy as np
import pytest
from sklearn.linear_model import LinearRegression

from skat import AffineTransport
from skat.experiments.methods import (
    DIAGNOSIS,
    METHODS,
    Method,
    RegressionTransport,
    chosen_methods,
    fitted_transport,
    of_repeat,
)
from skat.experiments.scores import covariance_errors, pointwise_errors

CONTEXT = 2


@pytest.fixture
def pairs():
    """Rows (context, outcome) whose target outcome is affine in the source row."""
    rng = np.random.default_rng(0)
    source = rng.normal(size=(60, 5))
    target = source.copy()
    target[:, CONTEXT:] = 1.0 + source @ rng.normal(size=(5, 3))
    return source, target


@pytest.mark.parametrize("name", METHODS)
def test_every_method_carries_rows_to_rows(name, pairs):
    carried = fitted_transport(METHODS[name], *pairs, CONTEXT).transform(pairs[0])
    assert carried.shape == pairs[1].shape
    assert np.isfinite(carried).all()


@pytest.mark.parametrize("name", [name for name in METHODS if name.startswith(("least", "ridge"))])
def test_regressions_recover_an_affine_relation_of_the_rows(name, pairs):
    carried = fitted_transport(METHODS[name], *pairs, CONTEXT).transform(pairs[0])
    np.testing.assert_allclose(carried, pairs[1], atol=1e-3 if "ridge" in name else 1e-9)


def test_target_only_makes_no_use_of_the_simulated_outcome(pairs):
    transport = fitted_transport(METHODS["target_only"], *pairs, CONTEXT)
    other = pairs[0].copy()
    other[:, CONTEXT:] = 7.0
    np.testing.assert_array_equal(transport.transform(other), transport.transform(pairs[0]))


def test_a_regression_on_the_residual_predicts_what_is_missing(pairs):
    direct = RegressionTransport(LinearRegression(), context=CONTEXT).fit(*pairs)
    residual = RegressionTransport(LinearRegression(), context=CONTEXT, residual=True).fit(*pairs)
    # For least squares the two are the same thing, since the source's outcome is a predictor.
    np.testing.assert_allclose(direct.transform(pairs[0]), residual.transform(pairs[0]), atol=1e-9)


def test_a_disjoint_method_sees_halves_that_share_no_row(pairs):
    method = METHODS["conditional_disjoint"]
    changed = [rows.copy() for rows in pairs]
    changed[0][30:] = np.nan
    changed[1][:30] = np.nan
    np.testing.assert_array_equal(
        fitted_transport(method, *pairs, CONTEXT).transform(pairs[0]),
        fitted_transport(method, *changed, CONTEXT).transform(pairs[0]),
    )


@pytest.mark.parametrize(("n_source", "n_target"), [(60, 12), (12, 60), (40, 40)])
def test_halves_of_unlike_numbers_of_rows_share_none(n_source, n_target):
    seen = []

    class Seeing(AffineTransport):
        def fit(self, X, y):
            seen.extend([X, y])
            return self

    method = Method("seeing", lambda context: Seeing(), disjoint=True)
    numbers = np.arange(60)[:, np.newaxis]
    fitted_transport(method, numbers[:n_source], numbers[:n_target], CONTEXT)
    source, target = (set(rows.ravel()) for rows in seen)
    assert target == set(range(n_target // 2, n_target))
    assert source == set(range(n_source)) - target


def test_methods_are_chosen_by_name_and_own_ones_are_cloned(pairs):
    own = AffineTransport()
    chosen = chosen_methods({"mine": own}, METHODS)
    assert list(chosen) == ["mine"]
    fitted_transport(chosen["mine"], *pairs, CONTEXT)
    assert not hasattr(own, "coef_")
    assert list(chosen_methods(["none", DIAGNOSIS], METHODS)) == ["none", DIAGNOSIS]
    assert list(chosen_methods(None, METHODS)) == list(METHODS)


def test_slow_methods_run_in_the_first_repeat_only():
    chosen = chosen_methods(["affine", "exact_transport", DIAGNOSIS], METHODS)
    assert list(of_repeat(chosen, 0)) == list(chosen)
    assert list(of_repeat(chosen, 1)) == ["affine"]


@pytest.mark.parametrize(
    ("methods", "message"),
    [
        (["afine"], r"unknown method 'afine'\. There are: none, affine, .*, diagnosis"),
        ("affine", r"methods must be a list of names; it is 'affine'\. Give \['affine'\]"),
        ([], "no methods to compare; there are: none, affine"),
    ],
)
def test_methods_that_cannot_be_compared_are_refused(methods, message):
    with pytest.raises(ValueError, match=message):
        chosen_methods(methods, METHODS)


def test_errors_are_distances_of_outcomes():
    rows, target = np.array([[9.0, 3.0, 4.0], [9.0, 0.0, 0.0]]), np.zeros((2, 3))
    np.testing.assert_array_equal(pointwise_errors(rows, target, 1), [5.0, 0.0])


@pytest.mark.parametrize("context", [0, 1])
def test_covariance_errors_are_zero_for_equal_outcomes_whatever_the_context(context):
    target = np.random.default_rng(0).normal(size=(50, 3))
    errors = covariance_errors(target * ([1.0] * 3 if not context else [7.0, 1.0, 1.0]), target, context)
    np.testing.assert_allclose(list(errors.values()), 0.0, atol=1e-12)


def test_covariance_errors_of_doubled_columns_by_hand():
    target = np.random.default_rng(0).normal(size=(50, 3))
    target -= target.mean(axis=0)
    errors = covariance_errors(2.0 * target, target, 0)
    # C = 4 C_t; and the distance between N(0, 4 C) and N(0, C) is (2 - 1)^2 tr C.
    expected = {"covariance_error": 3.0, "covariance_error_raw": 3.0, "covariance_error_affine": 3.0}
    expected |= {"normal_distance": 1.0, "normal_distance_raw": 1.0}
    assert errors == pytest.approx(expected, rel=1e-9)


def test_covariance_errors_depend_on_units_only_where_they_say_so():
    rng = np.random.default_rng(0)
    rows, target = rng.normal(size=(2, 50, 3))
    units, mixed = np.array([1e-3, 1.0, 1e3]), rng.normal(size=(3, 3))
    one, scaled = covariance_errors(rows, target, 0), covariance_errors(rows * units, target * units, 0)
    turned = covariance_errors(rows @ mixed, target @ mixed, 0)
    for name in one:
        same = not name.endswith("_raw")
        assert (scaled[name] == pytest.approx(one[name], rel=1e-8)) == same, name
        assert (turned[name] == pytest.approx(one[name], rel=1e-8)) == name.endswith("_affine"), name


def test_covariance_errors_leave_out_directions_in_which_the_target_does_not_vary():
    rows, target = np.random.default_rng(0).normal(size=(2, 50, 3))
    rows[:, 2] = target[:, 2] = 5.0
    whole, part = covariance_errors(rows, target, 0), covariance_errors(rows[:, :2], target[:, :2], 0)
    assert whole == pytest.approx(part, rel=1e-9)
