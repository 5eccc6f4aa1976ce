"""Effects in machines with a wheel, tendons, a servo; a world is plain MuJoCo with the compiled model edited."""

import mujoco
import numpy as np
import pytest

from skat.diagnosis import SimulationDiagnosis
from skat.simulators import MujocoSimulator
from tests.machines import FINGER, ROLLER, SERVO_ARM, without_limits

FRAME_SKIP = 10
# What the quick run offers, on shorter logs: the truth, and what is most like it. The long one offers all 50 effects.
TENDONS = [
    *("tendon_stiffness[band]", "tendon_stiffness[flexor]", "tendon_damping[flexor]"),
    *("tendon_dry_friction[flexor]", "mass[far]", "stiffness[knuckle]", "damping[tip]"),
]
SERVO = [
    *("gain[servo]", "force_limit[servo]", "kp[servo]", "kv[servo]", "offset[servo]"),
    *("damping[tip]", "armature[tip]"),
]
ELBOW = ["gain[bend]", "kp[bend]", "kv[bend]", "mass[lower]", "damping[elbow]", "dry_friction[elbow]"]

offered = pytest.mark.parametrize("offered", ["few", pytest.param("all", marks=pytest.mark.long)])


def wider(model):
    model.geom("tyre").size[0] *= 1.04
    model.geom("tyre").rbound *= 1.04


def softer(model):
    model.tendon_stiffness[model.tendon("band").id] -= 9


def stickier(model):
    model.tendon_frictionloss[model.tendon("flexor").id] += 1


def askew(model):
    model.actuator("servo").biasprm[0] += 0.05 * 0.15


def stiffer(model):
    model.actuator("servo").gainprm[0] *= 1.2
    model.actuator("servo").biasprm[1] *= 1.2


def weaker(model):
    model.actuator("servo").forcerange *= 0.1


def more_damped(model):
    model.actuator("bend").biasprm[2] *= 1.5


def less_damped(model):
    model.actuator("bend").biasprm[2] *= 0.6


def measured(text, edit, seed, n_episodes=8, n_rows=20):
    """Return states with noise of 1 % of each channel's spread, 1e-5 at least, rounded to half of that, and actions."""
    rng = np.random.default_rng(seed)
    model = mujoco.MjModel.from_xml_string(text)
    edit(model)
    states, actions = np.empty((n_episodes, n_rows + 1, model.nq + model.nv)), []
    for episode in states:
        data = mujoco.MjData(model)
        mujoco.mj_step(model, data, 500)
        data.qpos[-1], data.qvel[-1] = rng.uniform(-0.5, 0.5, 2)
        wave = rng.uniform(0.2, 1.2, (2, model.nu)), rng.uniform(0, 6, (2, model.nu))
        commands = np.sin(np.arange(n_rows)[:, None, None] * wave[0] + wave[1]).mean(axis=1)
        episode[0] = np.r_[data.qpos, data.qvel]
        for row, command in enumerate(commands, start=1):
            data.ctrl[:] = command
            mujoco.mj_step(model, data, FRAME_SKIP)
            episode[row] = np.r_[data.qpos, data.qvel]
        actions.append(commands)
    sigma = np.maximum(0.01 * states.std(axis=(0, 1)), 1e-5)
    noisy = states + sigma * rng.standard_t(5, states.shape) * np.sqrt(3 / 5)
    noisy = np.round(noisy / (sigma / 2)) * (sigma / 2)
    X = np.concatenate([noisy[:, :-1], actions], axis=2).reshape(n_episodes * n_rows, -1)
    return X, noisy[:, 1:].reshape(len(X), -1), np.repeat(np.arange(n_episodes), n_rows)


def named(text, edit, effects, n_rows):
    """Return the diagnosis of a log, and the only cause that it names."""
    X, y, groups = measured(text, edit, seed=1, n_rows=n_rows)
    simulator = MujocoSimulator(text, frame_skip=FRAME_SKIP)
    diagnosis = SimulationDiagnosis(simulator, effects=effects, random_state=0).fit(X, y, groups=groups)
    (cause,) = diagnosis.causes_
    return diagnosis, cause


def assert_measured(diagnosis, cause, name, value, neutral):
    assert cause.name == name
    assert abs(cause.value - value) < 0.1 * abs(value - neutral)
    assert diagnosis.verdict_ in ("named", "ambiguous")


@pytest.mark.long
@pytest.mark.xfail(
    strict=True,
    reason="Unexplained: armature[axle] of .005 kg m2 is named, beside mass[wheel] at its bound of .05, which is "
    "refused; the set with radius[wheel] is not found",
)
def test_radius_of_a_wheel_is_named_and_measured():
    assert_measured(*named(ROLLER, wider, "all", 20), "radius[wheel]", 1.04, 1.0)


@offered
@pytest.mark.parametrize(
    ("edit", "few", "name", "value", "neutral"),
    [
        (softer, TENDONS, "tendon_stiffness[band]", -9.0, 0.0),
        (stickier, TENDONS, "tendon_dry_friction[flexor]", 1.0, 0.0),
        (askew, SERVO, "offset[servo]", 0.15, 0.0),
        pytest.param(*(stiffer, SERVO, "kp[servo]", 1.2, 1.0), marks=pytest.mark.long),
        (weaker, SERVO, "force_limit[servo]", 0.1, 1.0),
    ],
)
def test_effect_of_a_tendon_or_a_servo_is_named_and_measured(edit, few, name, value, neutral, offered):
    found = named(FINGER, edit, few, 8) if offered == "few" else named(FINGER, edit, "all", 20)
    assert_measured(*found, name, value, neutral)


@offered
@pytest.mark.parametrize(
    ("text", "edit", "few", "name", "value"),
    [
        pytest.param(*(SERVO_ARM, more_damped, ELBOW, "kv[bend]", 1.5), marks=pytest.mark.long),
        (SERVO_ARM, less_damped, [*ELBOW, "force_limit[bend]"], "kv[bend]", 0.6),
        pytest.param(
            *(without_limits(SERVO_ARM), less_damped, ELBOW, "kv[bend]", 0.6), marks=pytest.mark.long
        ),
        (without_limits(SERVO_ARM), more_damped, ELBOW, "damping[elbow]", 2.0),
    ],
)
def test_velocity_gain_of_a_servo_is_named_alone_and_not_as_kp_and_gain(
    text, edit, few, name, value, offered
):
    diagnosis, cause = named(text, edit, few, 12) if offered == "few" else named(text, edit, "all", 20)
    assert (cause.name, cause.aliases, diagnosis.verdict_) == (name, (), "named")
    assert cause.interval[0] <= value <= cause.interval[1] or abs(cause.value / value - 1) < 0.03
