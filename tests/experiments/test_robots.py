import numpy as np
import pandas as pd
import pytest

from skat.experiments import domain_matrix, replay_transitions
from skat.experiments.robots import MEASURES, STARTS
from skat.simulators import make_simulator

WORLDS = ("normal", "heavy", "inverted")
SMALL = {
    "conditions": WORLDS,
    "n_transitions": 300,
    "n_test": 200,
    "n_scored": 50,
    "methods": ["none", "affine", "procrustes_whitened", "least_squares"],
}


@pytest.fixture(scope="module")
def hopper():
    return domain_matrix("hopper", n_repeats=2, **SMALL)


@pytest.mark.parametrize(("robot", "n_features"), [("hopper", 25), ("halfcheetah", 40), ("ant", 62)])
def test_rows_have_the_papers_columns_and_one_context_in_every_world(robot, n_features):
    replay = replay_transitions(robot, n_transitions=60, conditions=("normal", "light"))
    normal, light = replay.rows("normal"), replay.rows("light")
    assert normal.shape == light.shape == (60, n_features)
    np.testing.assert_array_equal(normal[:, : replay.context], light[:, : replay.context])
    assert np.abs(normal - light)[:, replay.context :].max() > 0.01


def test_transitions_of_the_normal_world_follow_each_other_in_episodes_of_50_steps():
    replay = replay_transitions("hopper", n_transitions=120, conditions=("normal",))
    same = replay.groups[1:] == replay.groups[:-1]
    assert list(np.bincount(replay.groups)) == [50, 50, 20]
    n_states = replay.y["normal"].shape[1]
    np.testing.assert_array_equal(replay.X[1:][same][:, :n_states], replay.y["normal"][:-1][same])


@pytest.mark.parametrize(("robot", "name"), [("hopper", "Hopper-v5"), ("ant", "Ant-v5")])
def test_episodes_start_as_gymnasium_starts_them(robot, name):
    gymnasium = pytest.importorskip("gymnasium")
    env = gymnasium.make(name).unwrapped
    names = make_simulator(robot).state_names
    assert [STARTS[robot].pose.get(channel, 0.0) for channel in names[: len(env.init_qpos)]] == list(
        env.init_qpos
    )
    drawn = []
    for seed in range(40):
        env.reset(seed=seed)
        drawn.append(np.r_[env.data.qpos - env.init_qpos, env.data.qvel])
    env.close()
    n_positions, noise = len(env.init_qpos), STARTS[robot].noise
    positions, speeds = np.abs(np.array(drawn))[:, :n_positions], np.array(drawn)[:, n_positions:]
    assert 0.95 * noise < positions.max() <= noise
    # 240 speeds or more: the standard deviation of uniform noise is noise / sqrt(3).
    expected = noise if STARTS[robot].normal_speeds else noise / np.sqrt(3)
    np.testing.assert_allclose(speeds.std(), expected, rtol=0.15)


def test_a_row_for_each_source_target_and_method(hopper):
    assert len(hopper) == 6 * 4
    assert not hopper.duplicated(["source", "target", "method"]).any()
    assert (hopper["source"] != hopper["target"]).all()
    assert np.isfinite(hopper[[*MEASURES, *(f"{name}_std" for name in MEASURES)]]).all(axis=None)


def test_doing_nothing_leaves_the_error_before(hopper):
    none = hopper[hopper["method"] == "none"]
    np.testing.assert_allclose(none["error_after"], none["error_before"], rtol=1e-12)
    pd.testing.assert_series_equal(
        hopper.groupby(["source", "target"])["error_before"].nunique(),
        hopper.groupby(["source", "target"])["error_before"].size() // 4,
        check_names=False,
    )


def test_pairs_tell_more_than_moments(hopper):
    median = hopper.groupby("method")["error_after"].median()
    assert median["procrustes_whitened"] < 0.5 * median["affine"]
    assert median["affine"] < median["none"]


def test_a_seed_repeats_the_table_whatever_other_methods_run(hopper):
    fewer = domain_matrix("hopper", n_repeats=2, **{**SMALL, "methods": ["affine"]})
    expected = hopper[hopper["method"] == "affine"].reset_index(drop=True)
    pd.testing.assert_frame_equal(fewer, expected)
    other = domain_matrix("hopper", n_repeats=2, random_state=1, **{**SMALL, "methods": ["affine"]})
    assert not np.allclose(other["error_after"], expected["error_after"], rtol=1e-3)


def test_rows_can_be_carried_from_some_worlds_only(hopper):
    some = domain_matrix("hopper", n_repeats=2, sources=["normal"], **SMALL)
    expected = hopper[hopper["source"] == "normal"].reset_index(drop=True)
    pd.testing.assert_frame_equal(some, expected)


def test_whole_episodes_can_be_set_aside_for_the_test():
    rows = domain_matrix("hopper", n_repeats=1, split="episodes", **{**SMALL, "methods": ["affine"]})
    assert rows["error_after_std"].isna().all()
    assert (rows["error_after"] > 0).all()


def test_progress_is_reported_to_the_end():
    calls = []
    domain_matrix(
        "hopper",
        n_repeats=1,
        **{**SMALL, "methods": ["none"]},
        progress=lambda *call: calls.append(call),
    )
    assert calls[0] == ("simulating", 0, 1)
    assert calls[-1] == ("carrying", 6, 6)


@pytest.mark.long
def test_the_diagnosis_is_one_of_the_methods_and_predicts_by_the_extended_simulator():
    table = domain_matrix(
        "hopper",
        n_transitions=60,
        n_test=50,
        n_scored=50,
        n_repeats=1,
        conditions=("normal", "heavy"),
        sources=["normal"],
        methods=["diagnosis", "least_squares"],
    ).set_index("method")
    assert table.loc["diagnosis", "error_after"] < 0.01 * table.loc["least_squares", "error_after"]


@pytest.mark.parametrize(
    ("robot", "options", "message"),
    [
        ("walker", {}, r"unknown robot 'walker'\. There are: hopper, halfcheetah, ant"),
        ("hopper", {"split": "halves"}, r'split must be "rows" or "episodes"; it is \'halves\''),
        ("hopper", {"conditions": ["normal"]}, "two worlds or more; conditions has 1"),
        ("hopper", {"conditions": ["normal", "lunar"]}, r"unknown condition of hopper 'lunar'"),
        ("hopper", {"sources": ["lunar"]}, r"sources must be some of the conditions, \['normal', .*lunar"),
        ("hopper", {"methods": ["magic"]}, r"unknown method 'magic'"),
    ],
)
def test_what_does_not_exist_is_refused(robot, options, message):
    with pytest.raises(ValueError, match=message):
        domain_matrix(robot, **options)


def test_no_episode_is_fitted_and_tested():
    with pytest.raises(ValueError, match="n_transitions must be a multiple of that; it is 310"):
        domain_matrix("hopper", split="episodes", **{**SMALL, "n_transitions": 310})
