import numpy as np
import pandas as pd
import pytest
from sklearn.preprocessing import FunctionTransformer

from skat.diagnosis import SimulationDiagnosis, compare_transports
from skat.diagnosis.comparison import (
    EXTENDED,
    NOMINAL,
    TRANSPORTS,
    ceiling_sentence,
    is_beaten,
)
from skat.effects import Effect
from skat.simulators import FunctionSimulator, MujocoSimulator

UNITS = np.array([1.0, 1e3])
SLIDER = """
<mujoco>
  <option timestep="0.005"/>
  <worldbody>
    <body name="cart">
      <joint name="slide" type="slide" axis="1 0 0" damping="1"/>
      <geom size="0.1" mass="1"/>
    </body>
  </worldbody>
  <actuator><motor joint="slide" gear="5"/></actuator>
</mujoco>
"""


def throw(Z, drag):
    """Where something lands that is thrown with speed Z0 at an angle that Z1 gives."""
    speed, angle = 3 + np.tanh(Z[:, 0]), 0.7 + 0.4 * np.tanh(Z[:, 1])
    reach = speed**2 * np.sin(2 * angle) / 9.81
    return np.stack([reach / (1 + drag * reach), speed * np.sin(angle) / (1 + drag * speed**2)], axis=1)


def throw_in_other_units(Z, drag):
    return throw(Z, drag) * UNITS


def throw_along_a_line(Z, drag):
    return np.stack([Z[:, 0], Z[:, 0] - 2 * Z[:, 1]], axis=1) * (1 + drag)


def throw_or_lose(Z, drag):
    return np.where(Z[:, :1] > 1.5, np.nan, throw(Z, drag))


def swing(X, damping):
    rate = X[:, 1] + 0.05 * (X[:, 2] - np.sin(X[:, 0]) - damping * X[:, 1])
    return np.stack([X[:, 0] + 0.05 * rate, rate], axis=1)


def thrower(function=throw):
    drag = Effect("drag", unit="1", neutral=0.0, bounds=(-0.2, 5.0))
    return FunctionSimulator(function, input_names=("z0", "z1"), output_names=("a", "b"), effects=(drag,))


def diagnosed(simulator, causes=(), hidden=(), noise=0.01):
    """Return a diagnosis as fit would leave it, of given causes."""
    diagnosis = SimulationDiagnosis(simulator, hidden=hidden)
    diagnosis.verdict_, diagnosis.computed_velocities_ = "named", ()
    diagnosis.noise_ = np.full(len(simulator.residual_names), noise)
    diagnosis.extended_simulator_ = simulator.extended(dict(causes))
    return diagnosis


def throws(world, n_rows, seed, noise=0.003):
    rng = np.random.default_rng(seed)
    Z = rng.normal(size=(n_rows, 2))
    y = world(Z)
    return Z, y + noise * y.std(axis=0) * rng.normal(size=y.shape)


def with_drag(Z):
    return throw(Z, 0.5)


def turned(Z):
    return throw(Z, 0.0) @ np.array([[0.8, 0.6], [-0.6, 0.8]]) + 1.0


def compared(diagnosis, world, n_fit=200, n_test=300, **options):
    fit, test = throws(world, n_fit, 0), throws(world, n_test, 1)
    return compare_transports(diagnosis, *fit, *test, random_state=0, **options)


def test_errors_of_the_simulations_are_those_of_the_formula():
    diagnosis = diagnosed(thrower(), {"drag": 0.4})
    frame = compared(diagnosis, with_drag).set_index("method")
    (Z, y), spread = throws(with_drag, 300, 1), throws(with_drag, 200, 0)[1].std(axis=0)
    for method, drag in ((NOMINAL, 0.0), (EXTENDED, 0.4)):
        misses = y - throw(Z, drag)
        assert frame.loc[method, "error"] == pytest.approx(
            np.sqrt(np.mean((misses / spread) ** 2)), rel=1e-12
        )
        by_output = frame.loc[method, ["a", "b"]].to_numpy(dtype=float)
        np.testing.assert_allclose(by_output, np.sqrt(np.mean(misses**2, axis=0)), rtol=1e-12)


def test_methods_and_columns_are_those_documented():
    frame = compared(diagnosed(thrower()), with_drag)
    assert list(frame["method"]) == [NOMINAL, *TRANSPORTS, EXTENDED]
    assert list(frame) == ["method", "error", "ratio", "ratio_low", "ratio_high", "n_rows", "note", "a", "b"]
    assert list(frame["n_rows"]) == [0, 200, 200, 200, 200, 200, 0]
    assert np.isfinite(frame["error"]).all()


def test_the_mean_has_error_one():
    fit = throws(with_drag, 5_000, 0)
    middle = FunctionTransformer(lambda rows: np.zeros_like(rows))
    frame = compare_transports(
        diagnosed(thrower()), *fit, *throws(with_drag, 5_000, 1), methods={"mean": middle}, random_state=0
    )
    assert frame["error"][1] == pytest.approx(1.0, abs=0.05)


def test_a_right_cause_is_not_beaten():
    frame = compared(diagnosed(thrower(), {"drag": 0.5}), with_drag)
    assert not is_beaten(frame)
    assert ceiling_sentence(frame).startswith("No transport beats the extended simulation")


def test_what_is_an_affine_change_of_the_output_is_found_by_a_transport_where_no_cause_explains_it():
    frame = compared(diagnosed(thrower(), {"drag": 0.5}), turned)
    assert is_beaten(frame)
    sentence = ceiling_sentence(frame)
    assert "beats the extended simulation" in sentence
    assert "Something is left" in sentence
    assert frame.set_index("method").loc["ProcrustesAffineTransport", "error"] < 0.01


def test_an_advantage_within_its_interval_or_below_what_noise_can_give_is_none():
    frame = pd.DataFrame(
        {
            "method": ["CORAL", "AffineTransport", EXTENDED],
            "error": [0.8, 0.97, 1.0],
            "ratio": [0.8, 0.97, 1.0],
            "ratio_low": [0.6, 0.96, 1.0],
            "ratio_high": [1.1, 0.98, 1.0],
        }
    )
    assert not is_beaten(frame)
    frame.loc[0, "ratio_high"] = 0.99
    assert is_beaten(frame)


def test_ratio_intervals_cover_the_ratio_of_long_logs():
    diagnosis = diagnosed(thrower(), {"drag": 0.4})
    options = {"methods": []}
    fit = throws(with_drag, 50, 0)
    long_run = compare_transports(diagnosis, *fit, *throws(with_drag, 20_000, 1), **options)["ratio"][0]
    covered = 0
    for seed in range(100):
        row = compare_transports(
            diagnosis, *fit, *throws(with_drag, 200, 2 + seed), random_state=seed, **options
        ).iloc[0]
        covered += row["ratio_low"] <= long_run <= row["ratio_high"]
    assert covered >= 86  # of 100: the 0.1 % quantile at 94 %, as a bootstrap loses a little


def test_errors_do_not_depend_on_units():
    plain = compared(diagnosed(thrower()), with_drag)
    scaled = compared(diagnosed(thrower(throw_in_other_units)), lambda Z: with_drag(Z) * UNITS)
    np.testing.assert_allclose(plain["error"], scaled["error"], rtol=1e-6)


def test_constant_and_duplicated_columns_have_answers():
    def wide(X, drag):
        y = throw(X[:, :2], drag)
        return np.column_stack([y, y[:, 0], np.full(len(y), 7.0)])

    simulator = FunctionSimulator(
        wide,
        input_names=("z0", "z1", "copy", "constant"),
        output_names=("a", "b", "copy of a", "constant out"),
        effects=thrower()._effects,
    )
    logs = []
    for seed in (0, 1):
        Z, _ = throws(with_drag, 200, seed)
        X = np.column_stack([Z, Z[:, 0], np.full(len(Z), 3.0)])
        logs += [X, wide(X, 0.5)]
    frame = compare_transports(diagnosed(simulator, {"drag": 0.4}), *logs, random_state=0)
    assert np.isfinite(frame["error"]).all(), frame[["method", "note"]]
    assert (frame["error"][1:-1] < 1).all()


def test_a_linear_simulation_of_a_noisy_world_has_answers_and_says_how():
    frame = compared(diagnosed(thrower(throw_along_a_line)), with_drag)
    assert np.isfinite(frame["error"]).all()
    assert (frame["error"] < 30).all()
    assert frame["note"][1:-1].str.contains("noise added to the simulated rows").all()
    assert (frame["note"].iloc[[0, -1]] == "").all()


def test_exact_transport_is_fitted_to_a_part_of_a_long_log_and_says_so(monkeypatch):
    monkeypatch.setattr("skat.diagnosis.comparison.MOST_EXACT_ROWS", 150)
    frame = compared(diagnosed(thrower()), with_drag, methods=["CORAL", "ExactTransport"])
    assert list(frame["n_rows"]) == [0, 200, 150, 0]
    assert frame["note"][2] == "fitted to 150 of 200 rows, drawn at random"


def test_the_same_random_state_gives_the_same_table():
    first, second = (compared(diagnosed(thrower(throw_along_a_line)), with_drag) for _ in range(2))
    pd.testing.assert_frame_equal(first, second)


def test_rows_that_diverge_are_left_out_and_said():
    diagnosis = diagnosed(thrower(throw_or_lose))
    frame = compared(diagnosis, with_drag)
    lost = int((throws(with_drag, 300, 1)[0][:, 0] > 1.5).sum())
    assert frame["note"][0] == f"{lost} rows left out, in which a simulation diverges"
    assert np.isfinite(frame["error"]).all()


def test_nothing_but_diverging_rows_is_an_error():
    Z, y = throws(with_drag, 50, 0)
    with pytest.raises(ValueError, match="diverges in every row of X_test"):
        compare_transports(diagnosed(thrower(throw_or_lose)), Z, y, Z + 100, y)


def test_an_estimator_without_an_answer_leaves_a_note():
    def refuse(rows):
        raise ValueError("no map for these rows")

    frame = compared(diagnosed(thrower()), with_drag, methods={"mine": FunctionTransformer(refuse)})
    assert np.isnan(frame["error"][1])
    assert frame["note"][1] == "no answer: no map for these rows"
    assert ceiling_sentence(frame) == "No transport could be fitted to these data."


def test_unknown_methods_list_those_that_exist():
    with pytest.raises(ValueError, match=r"'Affine'.*AffineTransport, ProcrustesAffineTransport"):
        compared(diagnosed(thrower()), with_drag, methods=["Affine"])
    with pytest.raises(ValueError, match="always compared"):
        compared(diagnosed(thrower()), with_drag, methods={NOMINAL: FunctionTransformer()})


def pendulum_log(n_episodes, seed, damping=0.6):
    rng = np.random.default_rng(seed)
    states = [np.column_stack([rng.uniform(-2, 2, n_episodes), rng.normal(size=n_episodes)])]
    pushes = rng.normal(size=(n_episodes, 40))
    for step in range(40):
        states.append(swing(np.column_stack([states[-1], pushes[:, step]]), damping))
    states = np.stack(states, axis=1)
    states += 0.01 * rng.normal(size=states.shape)
    X = np.concatenate([states[:, :-1], pushes[:, :, None]], axis=2).reshape(-1, 3)
    return X, states[:, 1:].reshape(-1, 2), np.repeat(np.arange(n_episodes), 40)


def pendulum():
    damping = Effect("damping", unit="1/s", neutral=0.0, bounds=(0.0, 5.0))
    names = ("angle", "rate")
    return FunctionSimulator(
        swing, input_names=(*names, "push"), output_names=names, state_names=names, effects=(damping,)
    )


def test_where_channels_are_hidden_whole_trajectories_are_compared():
    diagnosis = diagnosed(pendulum(), {"damping": 0.6}, hidden=("rate",))
    (X, y, groups), (X_new, y_new, groups_new) = pendulum_log(6, 0), pendulum_log(4, 1)
    X[:, 1], X_new[:, 1], y[:, 1], y_new[:, 1] = 0.0, 0.0, 0.0, 0.0
    frame = compare_transports(
        diagnosis, X, y, X_new, y_new, groups_fit=groups, groups_test=groups_new, random_state=0
    )
    assert list(frame)[7:] == ["angle"]
    extended = frame.set_index("method").loc[EXTENDED]
    assert extended["angle"] == pytest.approx(0.01, rel=0.15)  # the noise, and nothing else
    assert frame["ratio"][0] > 5
    # Four episodes do not say how much the ratio varies from one to the next, and nothing is claimed of it.
    assert frame[["ratio_low", "ratio_high"]].isna().all(axis=None)
    assert not is_beaten(frame)
    assert "(95 %" not in ceiling_sentence(frame)


def test_what_was_not_measured_may_be_nan_as_well_as_hidden_or_computed():
    by_name = diagnosed(pendulum(), {"damping": 0.6}, hidden=("rate",))
    computed = diagnosed(pendulum(), {"damping": 0.6})
    computed.computed_velocities_ = ("rate",)
    fit, test = pendulum_log(5, 0), pendulum_log(5, 1)
    options = {"groups_fit": fit[2], "groups_test": test[2], "methods": ["CORAL"], "random_state": 0}
    first, same = (compare_transports(one, *fit[:2], *test[:2], **options) for one in (by_name, computed))
    pd.testing.assert_frame_equal(first, same)
    for X, y, _ in (fit, test):
        X[:, 1], y[:, 1] = np.nan, np.nan
    second = compare_transports(diagnosed(pendulum(), {"damping": 0.6}), *fit[:2], *test[:2], **options)
    pd.testing.assert_frame_equal(first, second)


def test_rows_with_a_sample_that_is_missing_are_left_out():
    diagnosis = diagnosed(pendulum(), {"damping": 0.6})
    (X, y, groups), test = pendulum_log(4, 0), pendulum_log(4, 1)
    X[7, 0], X[90, 1], y[6, 0], y[89, 1] = np.nan, np.nan, np.nan, np.nan
    frame = compare_transports(
        diagnosis, X, y, *test[:2], groups_fit=groups, groups_test=test[2], methods=["CORAL"], random_state=0
    )
    assert list(frame["n_rows"]) == [0, len(X) - 4, 0]
    assert not frame["note"].str.contains("diverges").any()
    assert np.isfinite(frame["error"]).all()


def test_hidden_channels_need_episodes():
    X, y, _ = pendulum_log(2, 0)
    with pytest.raises(ValueError, match=r"rate were not measured.*groups_fit="):
        compare_transports(diagnosed(pendulum(), hidden=("rate",)), X, y, X, y)


def test_delay_needs_episodes():
    simulator = MujocoSimulator(SLIDER, frame_skip=4)
    rng = np.random.default_rng(0)
    commands = rng.normal(size=(8, 60, 1))
    states = simulator.rollout(
        0.1 * rng.normal(size=(8, 2)), commands, n_steps=60, effects={"delay[action]": 0.02}
    )
    states += 1e-4 * rng.normal(size=states.shape)
    X, y = np.concatenate([states[:, :-1], commands], axis=-1).reshape(-1, 3), states[:, 1:].reshape(-1, 2)
    groups = np.repeat(np.arange(8), 60)
    diagnosis = diagnosed(simulator, {"delay[action]": 0.02})
    table = compare_transports(
        diagnosis,
        X,
        y,
        X,
        y,
        groups_fit=groups,
        groups_test=groups,
        methods=["AffineTransport"],
        random_state=0,
    )
    assert not is_beaten(table)
    with pytest.raises(ValueError, match="pass groups_fit="):
        compare_transports(diagnosis, X, y, X, y, methods=["AffineTransport"])


def test_orientations_are_compared_as_rotations():
    spinning = MujocoSimulator(
        "<mujoco><worldbody><body><freejoint name='box'/><geom type='box' size='.1 .2 .3' mass='1'/>"
        "</body></worldbody></mujoco>",
        frame_skip=10,
    )
    rng = np.random.default_rng(0)
    logs = []
    for n_rows in (300, 200):
        X = rng.normal(size=(n_rows, 13))
        X[:, 3:7] /= np.linalg.norm(X[:, 3:7], axis=1, keepdims=True)
        y = spinning.predict(X, effects={"gravity": 0.5})
        signs = np.where(rng.random(n_rows) < 0.5, -1.0, 1.0)
        y[:, 3:7] *= signs[:, None]  # q and -q are the same orientation
        logs += [X, y]
    frame = compare_transports(diagnosed(spinning, {"gravity": 0.5}), *logs, random_state=0)
    assert list(frame)[7:] == list(spinning.residual_names)
    by_method = frame.set_index("method")
    assert by_method.loc[EXTENDED, "error"] < 1e-9
    assert by_method.loc[NOMINAL, "qvel.box.vz"] == pytest.approx(0.5 * 9.81 * spinning.dt, rel=1e-6)
    assert by_method.loc[NOMINAL, "qpos.box.rx"] < 1e-9
    assert np.isfinite(frame["error"]).all()
