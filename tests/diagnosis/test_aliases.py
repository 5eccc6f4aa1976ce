"""What a log cannot tell from a named effect is said, and what it can is not."""

import mujoco
import numpy as np
import pytest

from skat.diagnosis import SimulationDiagnosis
from skat.effects import Effect
from skat.simulators import FunctionSimulator, MujocoSimulator

CART = """
<mujoco>
  <option timestep="0.01"/>
  <worldbody>
    <body name="cart">
      <joint name="rail" type="slide" axis="1 0 0"/>
      <geom type="box" size="0.1 0.1 0.1" mass="1"/>
    </body>
  </worldbody>
  <actuator><motor name="motor" joint="rail"/></actuator>
</mujoco>
"""
N_SUBSTEPS = 5


def driven(mass=1.0, gear=1.0, n_episodes=8, n_steps=20):
    """Return X, y and groups of a cart of another mass and gear, stepped by plain MuJoCo, with 1 % of noise."""
    model = mujoco.MjModel.from_xml_string(CART)
    model.body_mass[1] *= mass
    model.actuator_gear[0, 0] *= gear
    data = mujoco.MjData(model)
    mujoco.mj_setConst(model, data)
    rng = np.random.default_rng(0)
    forces = np.cumsum(0.3 * rng.normal(size=(n_episodes, n_steps, 1)), axis=1) + rng.normal(
        size=(n_episodes, n_steps, 1)
    )
    states = np.empty((n_episodes, n_steps + 1, 2))
    for episode in range(n_episodes):
        mujoco.mj_resetData(model, data)
        data.qpos[0], data.qvel[0] = 0.5 * rng.normal(size=2)
        states[episode, 0] = data.qpos[0], data.qvel[0]
        for step in range(n_steps):
            data.ctrl[0] = forces[episode, step, 0]
            mujoco.mj_step(model, data, nstep=N_SUBSTEPS)
            states[episode, step + 1] = data.qpos[0], data.qvel[0]
    states += 0.01 * states.std(axis=(0, 1)) * rng.normal(size=states.shape)
    X = np.concatenate([states[:, :-1], forces], axis=2).reshape(-1, 3)
    return X, states[:, 1:].reshape(-1, 2), np.repeat(np.arange(n_episodes), n_steps)


def names(cause):
    """Return what may be behind a cause, itself first."""
    return {cause.name, *(alias.name for alias in cause.aliases)}


@pytest.mark.parametrize(
    "truth",
    [
        {"mass": 0.5},
        *(
            pytest.param(one, marks=pytest.mark.long)
            for one in ({"mass": 0.35}, {"gear": 2.5}, {"gear": 0.6})
        ),
    ],
)
def test_half_the_mass_and_twice_the_gain_are_the_same(truth):
    """They are exactly, however far from neutral they are, and however the noise was taken for at first."""
    X, y, groups = driven(**truth)
    diagnosis = SimulationDiagnosis(MujocoSimulator(CART, frame_skip=N_SUBSTEPS), random_state=0)
    (cause,) = diagnosis.fit(X, y, groups=groups).causes_
    assert diagnosis.verdict_ == "ambiguous"
    assert {"mass[cart]", "gain[motor]"} <= names(cause)


def limited(X, first=2.5, second=2.5):
    """Return two limits in a row, of which the lower one acts."""
    limit = min(first, second)
    return (X[:, 0] + np.clip(X[:, 1], -limit, limit))[:, None]


@pytest.mark.parametrize("truth", ["first", "second"])
@pytest.mark.parametrize("limit", [1.0, 2.0])
def test_a_limit_that_hides_behind_another_is_its_alias(truth, limit):
    rng = np.random.default_rng(0)
    effects = [Effect(name, unit="1", neutral=2.5, bounds=(0.1, 5.0)) for name in ("first", "second")]
    simulator = FunctionSimulator(limited, input_names=("x", "u"), output_names=("p",), effects=effects)
    X = rng.uniform(-2.2, 2.2, size=(300, 2))
    y = X[:, :1] + np.clip(X[:, 1:], -limit, limit) + 0.05 * rng.normal(size=(300, 1))
    diagnosis = SimulationDiagnosis(simulator, random_state=0).fit(X, y)
    (cause,) = diagnosis.causes_
    assert names(cause) == {"first", "second"}, truth
    assert cause.value == pytest.approx(limit, abs=0.05)


def six_limits(X, **limits):
    ends = np.array([limits[f"limit{k}"] for k in range(6)])
    return X[:, :6] + np.clip(X[:, 6:], -ends, ends)


@pytest.mark.parametrize(
    "seed", [19, 63, 86, *(pytest.param(seed, marks=pytest.mark.long) for seed in (119, 137, 139, 161))]
)
def test_a_limit_that_is_never_reached_is_not_named(seed):
    """Far from neutral in standard errors it always is; these seeds named one, by the Wald statistic."""
    names = [f"limit{k}" for k in range(6)]
    simulator = FunctionSimulator(
        six_limits,
        input_names=tuple(f"x{k}" for k in range(6)) + tuple(f"u{k}" for k in range(6)),
        output_names=tuple(f"p{k}" for k in range(6)),
        effects=[Effect(name, unit="1", neutral=2.5, bounds=(0.1, 5.0)) for name in names],
    )
    rng = np.random.default_rng(seed)
    X = rng.uniform(-2.2, 2.2, size=(300, 12))
    y = X[:, :6] + X[:, 6:] + 0.05 * rng.normal(size=(300, 6))
    assert SimulationDiagnosis(simulator, random_state=seed).fit(X, y).verdict_ == "nothing detected"


def near_copies(X, truth=0.0, **copies):
    shares = [copies.get(f"copy{k}", 0.0) * (X[:, 0] + 0.005 * X[:, 1 + k]) for k in range(6)]
    return (truth * X[:, 0] + sum(shares))[:, None]


@pytest.mark.parametrize("seeds", [range(5), pytest.param(range(5, 30), marks=pytest.mark.long)])
def test_what_hardly_differs_from_the_truth_does_not_drive_it_out(seeds):
    """One of seven models that predict the same within a tenth of the noise is always best, by next to nothing."""
    effects = ["truth", *(f"copy{k}" for k in range(6))]
    simulator = FunctionSimulator(
        near_copies,
        input_names=("u", *(f"w{k}" for k in range(6))),
        output_names=("p",),
        effects=[Effect(name, unit="1", neutral=0.0, bounds=(-3.0, 3.0)) for name in effects],
    )
    for seed in seeds:
        rng = np.random.default_rng(seed)
        X = rng.normal(size=(300, 7))
        y = X[:, :1] + 0.1 * rng.normal(size=(300, 1))
        diagnosis = SimulationDiagnosis(simulator, effects=effects, random_state=seed, test_size=0).fit(X, y)
        (cause,) = diagnosis.causes_
        assert "truth" in names(cause), seed
