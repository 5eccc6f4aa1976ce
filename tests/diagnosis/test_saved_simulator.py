"""A simulator as a file has it: what tells another one from it, and what an effect's record says."""

from dataclasses import replace

import numpy as np
import pytest

from skat.diagnosis.archive import bare, digest, opened, write_archive
from skat.diagnosis.fitting import first_fit
from skat.diagnosis.log import Log
from skat.diagnosis.saving import SavedSimulator, _with_plain_labels, _without_rows, is_like
from skat.diagnosis.statespace import state_space
from skat.effects import Effect
from skat.simulators import FunctionSimulator

DRAG = Effect("drag", unit="1/s", neutral=0.0, bounds=(0.0, 2.0), typical=0.1)


def sliding(function=None, *, effects=(DRAG,), names=("x", "v"), inputs=("u",)):
    def slide(X, drag=0.0, **others):
        return np.c_[X[:, 0] + 0.1 * X[:, 1], X[:, 1] * (1 - 0.1 * drag)]

    return FunctionSimulator(
        function or slide,
        input_names=(*names, *inputs),
        output_names=names,
        state_names=names,
        effects=effects,
    )


def a_log(n=40):
    X = np.random.default_rng(0).normal(size=(n, 3))
    return Log(X, X[:, :2], np.arange(n) // 10, True, None, sliding())


@pytest.fixture
def saved():
    return SavedSimulator.of(sliding(), a_log())


def test_a_simulator_is_known_by_its_first_rows_and_no_code_is_saved(saved):
    assert saved.kind == "FunctionSimulator"
    assert saved.parameters is None
    np.testing.assert_array_equal(saved.rows, a_log().X[:20])
    np.testing.assert_array_equal(saved.groups, np.repeat([0, 1], 10))
    np.testing.assert_array_equal(saved.outputs, sliding().predict(saved.rows))
    assert "drag" in [one.name for one in saved.effects]
    assert saved.difference(sliding()) == ""


def moved(by, row=3):
    """Return a simulation that ends elsewhere from one of the saved rows."""
    place = a_log().X[row, 0]

    def slide(X, drag=0.0):
        return np.c_[
            X[:, 0] + 0.1 * X[:, 1] + np.where(X[:, 0] == place, by, 0.0), X[:, 1] * (1 - 0.1 * drag)
        ]

    return sliding(slide)


EXTRA = tuple(replace(DRAG, name=f"extra[{one}]") for one in "abcdefg")


@pytest.mark.parametrize(
    ("other", "told"),
    [
        (sliding(inputs=("w",)), "its input_names are x, v, w and were x, v, u"),
        (sliding(inputs=()), "its input_names are x, v and were x, v, u"),
        (sliding(effects=()), "it has no drag"),
        (
            sliding(effects=[replace(DRAG, unit="Hz")]),
            "drag is in Hz, neutral at 0, bounds (0.0, 2.0), and was in 1/s, neutral at 0, bounds (0.0, 2.0)",
        ),
        (
            sliding(effects=[replace(DRAG, bounds=(0.0, 2.1))]),
            "drag is in 1/s, neutral at 0, bounds (0.0, 2.1), and was in 1/s, neutral at 0, bounds (0.0, 2.0)",
        ),
        (sliding(effects=[replace(DRAG, bounds=(0.0, 2.0 + 1e-9))]), ""),
        (sliding(effects=[DRAG, *EXTRA]), ""),
        (moved(1e-7), ""),
    ],
)
def test_what_tells_another_simulator_is_told(saved, other, told):
    assert saved.difference(other) == told


def test_of_many_effects_that_lack_five_are_named():
    for n, told in (
        (5, "extra[a], extra[b], extra[c], extra[d], extra[e]"),
        (6, "extra[a], extra[b], extra[c], extra[d], extra[e] ..."),
    ):
        saved = SavedSimulator.of(sliding(effects=[DRAG, *EXTRA[:n]]), a_log())
        assert saved.difference(sliding()) == f"it has no {told}"


@pytest.mark.parametrize("by", [1e-3, np.nan])
def test_the_first_row_that_ends_elsewhere_is_named_with_both_ends(saved, by):
    was = saved.outputs[3, 0]
    told = f"in row 3 of the log it predicts {was + by:g} for x, and predicted {was:g}"
    assert saved.difference(moved(by)) == told


def test_rows_in_which_both_diverge_are_the_same():
    saved = SavedSimulator.of(moved(np.nan), a_log())
    assert saved.difference(moved(np.nan)) == ""
    assert saved.difference(sliding()).startswith("in row 3 of the log it predicts")


def test_what_is_written_of_an_effect_comes_back_as_that_of_the_simulator_at_hand(tmp_path):
    written = replace(DRAG, typical=0.7, odds=0.25)
    write_archive(tmp_path / "value", "value", {"value": (written, bare(written))})
    with opened(tmp_path / "value", "value") as file:
        alone, _ = file.read("value")
        back, _ = file.read("value", sliding())
    assert (alone.typical, alone.odds, alone.bounds) == (0.7, 0.25, DRAG.bounds)
    assert (back.name, back.typical, back.odds, back.bounds) == ("drag", 0.7, 0.25, DRAG.bounds)
    assert alone.apply is None


@pytest.mark.parametrize(
    ("changes", "alike"),
    [
        ({}, True),
        ({"typical": 9.0, "odds": 0.1}, True),
        ({"neutral": 1e-13}, True),
        ({"neutral": 1e-3}, False),
        ({"bounds": (0.0, 2.0 + 1e-7)}, True),
        ({"bounds": (0.0, 2.0 + 1e-5)}, False),
        ({"bounds": (-1e-3, 2.0)}, False),
        ({"unit": "1"}, False),
    ],
)
def test_values_of_an_effect_mean_the_same_where_unit_neutral_and_bounds_do(changes, alike):
    assert is_like(replace(DRAG, **changes), DRAG) == alike


def test_digests_tell_values_types_and_shapes_apart():
    array = np.arange(400.0)
    different = [
        array,
        array + 1e-12,
        array.astype(np.float32),
        array.reshape(20, 20),
        array[:20],
        array[:20].reshape(4, 5),
    ]
    different += [list(array), tuple(array[:3]), 1, 1.0, True, "1", None, {"a": 1}, {"a": 2}]
    assert len({digest(one) for one in different}) == len(different)
    assert digest(array) == digest(array.copy())


def test_episodes_are_called_by_numbers_or_text_in_a_file():
    log = Log(np.zeros((4, 1)), np.zeros((4, 1)), np.arange(4), True, ("a", 1, 2.5, (3, "b")))
    assert _with_plain_labels(log).labels == ("a", 1, 2.5, "(3, 'b')")
    assert _with_plain_labels(replace(log, labels=None)).labels is None


def test_of_a_fit_the_laws_of_its_noise_are_kept_and_no_row():
    simulator = FunctionSimulator(lambda X: X, input_names=("a",), output_names=("b",))
    X = np.random.default_rng(0).normal(size=(30, 1))
    space = state_space(simulator, X, X + 0.1, np.arange(30), consecutive=False)
    fitted = first_fit(space, {})
    kept = _without_rows(fitted)
    noise, own = kept.estimate.noise, fitted.estimate.noise
    for name in ("force", "error", "force_nu", "error_nu"):
        np.testing.assert_array_equal(getattr(noise, name), getattr(own, name))
    assert (kept.bound, kept.values) == (fitted.bound, fitted.values)
    for part in (
        kept.linear,
        kept.linear.chains,
        kept.linear.by_row,
        kept.chains,
        kept.estimate.filtered,
        kept.estimate.smoothed,
    ):
        arrays = [one for one in vars(part).values() if isinstance(one, np.ndarray) and one.ndim > 1]
        assert arrays
        assert all(len(one) == 0 for one in arrays)
    assert all(len(one) == 0 for one in (noise.law, noise.force_weights, noise.error_weights))
    np.testing.assert_array_equal(kept.chains.prior, fitted.chains.prior)
