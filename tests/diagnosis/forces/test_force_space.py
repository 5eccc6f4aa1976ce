"""Regression in force space: laws of the smoother, of inverse dynamics, of sets of causes, and small machines."""

import mujoco
import numpy as np
import pytest

from skat.diagnosis.changes import find_changes
from skat.diagnosis.evidence import Gram, Priors, Weigher, weigh
from skat.diagnosis.forces.force_space import Rows, noise_of, smooth_squares
from skat.diagnosis.forces.smoothing import smooth_coordinate
from skat.diagnosis.search import alternatives, search_sets
from skat.simulators import MujocoSimulator

ARM = """
<mujoco>
  <option timestep="0.002" integrator="implicitfast"/>
  <worldbody>
    <body name="upper">
      <joint name="shoulder" axis="0 1 0"/>
      <geom type="capsule" fromto="0 0 0 0 0 -0.3" size="0.02" mass="0.6"/>
      <body name="lower" pos="0 0 -0.3">
        <joint name="elbow" axis="0 1 0"/>
        <geom type="capsule" fromto="0 0 0 0 0 -0.3" size="0.02" mass="0.5"/>
      </body>
    </body>
  </worldbody>
  <actuator><motor name="shoulder" joint="shoulder"/><motor name="elbow" joint="elbow"/></actuator>
</mujoco>"""
JOINTS = ("shoulder", "elbow")


def log_of(
    seed,
    *,
    friction=(0.0, 0.0),
    damping=(0.0, 0.0),
    gain=(1.0, 1.0),
    mass=1.0,
    rows=1200,
    noise=0.002,
    held=((), 0, 0.0),
):
    """Return (X, y, groups) of the arm by plain MuJoCo, with noise of positions, ten times of speeds, rows of 10 ms.

    ``held`` are rows in which somebody holds a joint back, by so many N m s/rad.
    """
    model = mujoco.MjModel.from_xml_string(ARM)
    model.dof_frictionloss[:], model.dof_damping[:] = friction, damping
    model.actuator_gainprm[:, 0] = gain
    model.body_mass[2] *= mass
    model.body_inertia[2] *= mass
    data, rng = mujoco.MjData(model), np.random.default_rng(seed)
    phases, rates = rng.uniform(0, 6, (2, 3)), rng.uniform(0.3, 1.5, (2, 3))
    states, commands = [], []
    for row in range(rows + 1):
        command = np.array([1.2, 0.5]) * np.sin(2 * np.pi * rates * 0.01 * row + phases).mean(axis=1) * 2
        states.append(np.r_[data.qpos, data.qvel])
        commands.append(command)
        data.ctrl[:] = command
        data.qfrc_applied[held[1]] = -held[2] * data.qvel[held[1]] if row in held[0] else 0.0
        mujoco.mj_step(model, data, 5)
    states = np.array(states) + noise * rng.normal(size=(rows + 1, 4)) * [1, 1, 10, 10]
    return np.column_stack([states[:-1], commands[:-1]]), states[1:], np.zeros(rows, dtype=int)


def test_smoother_finds_noise_and_motion():
    rng = np.random.default_rng(0)
    time = 0.01 * np.arange(1500)
    truth = 0.6 * np.sin(4 * time) + 0.2 * np.sin(9 * time + 1)
    speed = 2.4 * np.cos(4 * time) + 1.8 * np.cos(9 * time + 1)
    read = truth + 0.003 * rng.normal(size=1500)
    read[rng.random(1500) < 0.05] = np.nan
    smooth = smooth_coordinate(read, np.zeros(1500), 0.01)
    assert smooth.position_noise == pytest.approx(0.003, rel=0.08)
    assert np.std(smooth.velocity - speed) == pytest.approx(smooth.velocity_error, rel=0.5)


def test_smoother_leaves_a_parabola_as_it_is():
    time = 0.01 * np.arange(60)
    smooth = smooth_coordinate(1 + 2 * time + 3 * time**2, np.zeros(60), 0.01)
    np.testing.assert_allclose(smooth.velocity, 2 + 6 * time, atol=1e-6)
    np.testing.assert_allclose(smooth.acceleration, 6.0, atol=1e-4)


@pytest.mark.parametrize("n", [30, 3000])
def test_squares_of_rows_become_a_curve_over_frequency_and_a_level_of_few(n):
    rng, place = np.random.default_rng(0), np.linspace(0.01, 1, n)
    variance = 0.3 * np.exp(2 * place**2) * (place + 0.02) ** -0.7
    squares = variance * rng.chisquare(1, n)
    rows = Rows(np.zeros(n), np.zeros((n, 0)), np.zeros(n, int), place, np.zeros(n, int), np.full(n, 1e-3))
    found = smooth_squares(rows, squares)
    if n == 30:
        np.testing.assert_allclose(found, squares.mean(), rtol=1e-2)
        return
    np.testing.assert_allclose(found[n // 10 :], variance[n // 10 :], rtol=0.2)
    np.testing.assert_allclose(smooth_squares(rows, squares, flat=True), squares.mean(), rtol=1e-2)


def test_no_row_is_known_better_than_a_share_of_the_force_that_is_missing():
    n = 60
    rows = Rows(
        np.zeros(n), np.zeros((n, 0)), np.repeat([0, 1], 30), np.tile(np.arange(30.0), 2), np.zeros(n, int),
        np.repeat([2.0, 0.01], 30),
    )  # fmt: skip
    found = noise_of(rows, np.full(n, 1e-4))
    np.testing.assert_allclose(found[:30], 0.03 * 2.0, rtol=1e-3)
    np.testing.assert_allclose(found[30:], 1e-2, rtol=1e-3)


def test_missing_force_is_that_of_inverse_dynamics():
    simulator = MujocoSimulator(ARM, frame_skip=5)
    rng = np.random.default_rng(1)
    states, pulls, commands = rng.normal(size=(7, 4)), rng.normal(size=(7, 2)), rng.normal(size=(7, 2))
    values = {"armature[elbow]": 0.02, "damping[shoulder]": 0.3, "gain[elbow]": 1.2, "mass[lower]": 1.5}
    found = simulator.missing_forces(states, pulls, commands[None], [values])[0]
    model = simulator.compiled(values)
    data = mujoco.MjData(model)
    for row in range(7):
        data.qpos[:], data.qvel[:] = states[row, :2], states[row, 2:]
        data.qacc[:], data.ctrl[:] = pulls[row], commands[row]
        mujoco.mj_inverse(model, data)
        mujoco.mj_fwdActuation(model, data)
        np.testing.assert_allclose(found[row], data.qfrc_inverse - data.qfrc_actuator, atol=1e-9)


def test_no_force_is_missing_under_the_acceleration_of_forward_dynamics():
    simulator = MujocoSimulator(ARM, frame_skip=5)
    rng = np.random.default_rng(2)
    states, commands = rng.normal(size=(5, 4)), rng.normal(size=(5, 2))
    values = {"dry_friction[elbow]": 0.3}
    model = simulator.compiled(values)
    data, pulls = mujoco.MjData(model), []
    for row in range(5):
        data.qpos[:], data.qvel[:], data.ctrl[:] = states[row, :2], states[row, 2:], commands[row]
        mujoco.mj_forward(model, data)
        pulls.append(data.qacc.copy())
    missing = simulator.missing_forces(states, np.array(pulls), commands[None], [values])[0]
    np.testing.assert_allclose(missing, 0.0, atol=1e-6)


def random_problem(seed, n=300, k=12, members=(1, 2, 3, 4, 8)):
    rng = np.random.default_rng(seed)
    N, truth = rng.normal(size=(n, k)), np.zeros(k)
    truth[list(members)] = rng.choice([-1, 1], len(members)) * rng.uniform(0.5, 1, len(members))
    z = N @ truth + rng.normal(size=n)
    names = tuple(f"cause[{place}]" for place in range(k))
    priors = Priors(names, np.full(k, 0.5), np.full(k, -np.log(k + 1.0)), np.full(k, -9.0), np.full(k, 9.0))
    return Gram(N.T @ N, N.T @ z, np.zeros(k)), priors


@pytest.mark.parametrize("seed", range(3))
def test_sets_come_back_when_data_are_simulated_from_them(seed):
    gram, priors = random_problem(seed)
    assert search_sets(Weigher(gram, priors)).members == (1, 2, 3, 4, 8)


def test_quick_weighing_is_that_of_the_evidence():
    gram, priors = random_problem(5)
    worth = Weigher(gram, priors)
    for members in ((1,), (1, 2, 3), (0, 4, 8, 11)):
        assert worth(members).evidence == pytest.approx(weigh(gram, priors, members).evidence, abs=0.02)


@pytest.mark.parametrize("size", [0.1, 1.0, 3.0, 10.0])
def test_a_promise_is_what_a_further_effect_gains_where_the_others_hardly_move(size):
    """The weigher takes the others' priors to be parabolas, which they are as far as about one typical size."""
    compared = 0
    for seed in range(20):
        rng, k = np.random.default_rng(seed), 8
        n = int(rng.choice([30, 300, 3000]))
        N = rng.normal(size=(n, k)) @ (2 * np.eye(k) + rng.uniform(0, 1) * rng.normal(size=(k, k)))
        truth = size * rng.uniform(-1.5, 1.5, k) * (np.arange(k) < 5)
        z = N @ truth + rng.normal(size=n)
        priors = Priors(("",) * k, np.ones(k), np.full(k, -2.0), np.full(k, -1e3), np.full(k, 1e3))
        worth = Weigher(Gram(N.T @ N, N.T @ z, np.zeros(k)), priors)
        for members in ((), (0,), (0, 1, 2), (1, 3, 6), (0, 1, 2, 3, 4)):
            now, promises = worth(members), worth.promises(worth(members))
            assert not np.isfinite(promises[list(members)]).any()
            for one in set(range(k)) - set(members):
                then = worth((*members, one))
                others = np.array([value for place, value in zip(then.members, then.values) if place != one])
                if np.max(np.abs(others - now.values), initial=0.0) < 1:
                    assert promises[one] == pytest.approx(then.evidence - now.evidence, abs=1.0)
                    compared += 1
    assert compared > 200


def test_a_promise_holds_where_a_value_ends_at_its_bound():
    gram, priors = random_problem(5)
    bounded = Priors(priors.names, priors.scales, priors.log_odds, np.full(12, -0.2), np.full(12, 0.2))
    worth = Weigher(gram, bounded)
    now = worth((1, 2))
    promises = worth.promises(now)
    for one in (3, 4, 8):
        assert worth((1, 2, one)).values[-1 if one > 2 else 0] in (-0.2, 0.2)
        # A bound takes a share of what is left of a value, which no promise knows.
        assert promises[one] == pytest.approx(worth((1, 2, one)).evidence - now.evidence, abs=4.0)


def test_rivals_of_members_promise_nothing():
    gram, priors = random_problem(5)
    worth = Weigher(gram, priors, {1: [4, 7]})
    assert np.flatnonzero(np.isinf(worth.promises(worth((1, 2))))).tolist() == [1, 2, 4, 7]
    assert np.flatnonzero(np.isinf(worth.promises(worth((2,))))).tolist() == [2]


def test_effects_that_act_nearly_alike_are_all_found_however_many_promise_more():
    k = 9
    rng = np.random.default_rng(0)
    common = rng.normal(size=2000)
    # The further down, the less like the first; the last is something else.
    N = common[:, None] + np.r_[0.0, 0.08, 0.09, 0.1, 0.11, 0.12, 0.13, 0.14, 9.0] * rng.normal(
        size=(2000, k)
    )
    z = 0.2 * common + rng.normal(size=2000)
    priors = Priors(("",) * k, np.ones(k), np.full(k, -np.log(10.0)), np.full(k, -50.0), np.full(k, 50.0))
    worth = Weigher(Gram(N.T @ N, N.T @ z, np.zeros(k)), priors)
    best = search_sets(worth)
    (gone,) = best.members
    lost = {one: best.evidence - worth((one,)).evidence for one in range(k) if one != gone}
    within = np.log(20.0)
    expected = {one: value for one, value in lost.items() if value <= within}
    assert len(expected) > 5
    found = alternatives(best, worth, within)[gone]
    assert dict(found) == pytest.approx(expected)
    assert [value for _, value in found] == sorted(expected.values())


def test_an_effect_that_explains_less_than_asked_is_no_alternative():
    gram, priors = random_problem(5)
    worth = Weigher(gram, priors)
    best = search_sets(worth)
    assert alternatives(best, worth, np.log(20.0)) == {one: [] for one in best.members}


@pytest.mark.parametrize("start", [(0,), (0, 5, 7), (1, 2)])
def test_a_set_to_begin_with_changes_nothing_of_what_is_found(start):
    gram, priors = random_problem(5)
    found = search_sets(Weigher(gram, priors), start)
    assert found.members == search_sets(Weigher(gram, priors)).members


@pytest.mark.parametrize("sign", [-1, 1])
def test_a_value_held_at_its_bound_is_worth_what_the_integral_says(sign):
    # The density falls from the bound as exp(-slope x): its integral is 1 / slope, but for what the curvature adds.
    stiffness, pull, bound = 100.0, 1e4, 9.0
    low, high = sorted((0.0, sign * bound))
    priors = Priors(("cause",), np.full(1, 1e3), np.zeros(1), np.full(1, low), np.full(1, high))
    gram = Gram(np.full((1, 1), stiffness), np.full(1, sign * pull), np.zeros(1))
    at_bound = pull * bound - stiffness * bound**2 / 2
    prior = priors.log_density((0,), np.full(1, sign * bound))[0]
    slope = pull - stiffness * bound
    assert Weigher(gram, priors)((0,)).evidence == pytest.approx(at_bound + prior - np.log(slope), abs=0.01)


def test_only_what_changed_is_named_of_a_model_that_is_wrong_in_both_logs():
    simulator = MujocoSimulator(ARM, frame_skip=5)
    wrong = {"friction": (0.12, 0.06), "damping": (0.1, 0.05), "mass": 1.15}
    families = ("gain", "mass", "damping", "dry_friction", "armature")
    effects = [effect for effect in simulator.effects() if effect.name.partition("[")[0] in families]
    found = find_changes(simulator, log_of(4, **wrong), log_of(5, **wrong, gain=(1.0, 1.25)), effects)
    assert [change.name for change in found.changes] == ["gain[elbow]"]
    assert found.changes[0].value == pytest.approx(1.25, rel=0.07)


def test_nothing_is_named_where_nothing_changed():
    simulator = MujocoSimulator(ARM, frame_skip=5)
    wrong = {"friction": (0.12, 0.06), "damping": (0.1, 0.05), "mass": 1.15}
    found = find_changes(simulator, log_of(6, **wrong), log_of(7, **wrong), simulator.effects())
    assert found.verdict == "nothing changed"


def test_smoother_takes_three_readings_of_an_episode_and_no_fewer():
    place = np.array([0.0, 1.0, 4.0])
    assert np.isfinite(smooth_coordinate(place, np.zeros(3), 0.1).acceleration).all()
    with pytest.raises(ValueError, match="fewer than 3 readings"):
        smooth_coordinate(place[:2], np.zeros(2), 0.1)
