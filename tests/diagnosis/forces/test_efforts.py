"""Measured efforts of an arm whose controller is faster than its log: causes, when they were read, errors."""

import mujoco
import numpy as np
import pytest

from skat.diagnosis import SimulationDiagnosis
from skat.diagnosis.evidence import weigh
from skat.diagnosis.forces.efforts import Regression
from skat.effects import Effect
from skat.simulators import FunctionSimulator, MujocoSimulator
from tests.diagnosis.forces.test_force_space import ARM

ROTORS = ARM.replace("<joint ", '<joint armature="0.01" ')
# MuJoCo's friction of a light joint is softer than Coulomb's.
HEAVY = ARM.replace("<joint ", '<joint armature="0.2" ')
SUBSTEPS, FINER, ROW = 5, 10, 0.01
SLOW = {
    "dry_friction[shoulder]": 0.3,
    "damping[shoulder]": 0.3,
    "dry_friction[elbow]": 0.12,
    "damping[elbow]": 0.12,
}
MACHINE = {"dry_friction[shoulder]": 0.3, "damping[shoulder]": 0.1, "dry_friction[elbow]": 0.12}


def closed_loop(truth, *, gain=(1.0, 1.0), rows=600, seed=0, early=0, fastest=7.0, text=ROTORS):
    """Return X, y, groups of the arm under a controller at 5 kHz: its efforts at 100 Hz, read so many ticks early.

    Targets are waves of up to ``fastest`` rad/s.
    """
    rng = np.random.default_rng(seed)
    real, nominal = (mujoco.MjModel.from_xml_string(text) for _ in range(2))
    for name, value in truth.items():
        family, joint = name.rstrip("]").split("[")
        field = {"dry_friction": "dof_frictionloss", "damping": "dof_damping", "armature": "dof_armature"}
        getattr(real, field[family])[real.joint(joint).id] = value
    mujoco.mj_setConst(real, mujoco.MjData(real))
    real.opt.timestep = ROW / SUBSTEPS / FINER
    data, helper = mujoco.MjData(real), mujoco.MjData(nominal)
    omega, phase = rng.uniform(fastest / 7, fastest, (5, 2)), rng.uniform(0, 6, (5, 2))
    ticks, states, torques = SUBSTEPS * FINER, [], []
    for tick in range(ticks * rows + ticks):
        time = tick * real.opt.timestep
        target, rate = (
            0.4 * np.sin(omega * time + phase).sum(0),
            0.4 * (omega * np.cos(omega * time + phase)).sum(0),
        )
        if tick == 0:
            data.qpos[:], data.qvel[:] = target, rate
        helper.qpos[:], helper.qvel[:] = data.qpos, 0
        mujoco.mj_forward(nominal, helper)
        inertia = np.zeros((2, 2))
        mujoco.mj_fullM(nominal, helper, inertia)
        stiff = np.diag(inertia)
        torque = helper.qfrc_bias + stiff * (900 * (target - data.qpos) + 60 * (rate - data.qvel))
        if tick % ticks == 0:
            states.append(np.r_[data.qpos, data.qvel])
        torques.append(torque / gain)
        data.ctrl[:] = torque
        mujoco.mj_step(real, data)
    states = np.array(states[: rows + 1]) + [3e-4, 3e-4, 3e-3, 3e-3] * rng.normal(size=(rows + 1, 4))
    efforts = np.array(torques)[ticks + early :: ticks] if early < 0 else np.array(torques)[early::ticks]
    if early < 0:
        states = states[1:]
    rows = len(states) - 1
    efforts = efforts[:rows] + 0.01 * rng.normal(size=(rows, 2)) * efforts.std(axis=0)
    return np.column_stack([states[:-1], efforts]), states[1:], np.zeros(rows, dtype=int)


@pytest.fixture(scope="module")
def simulator():
    return MujocoSimulator(ROTORS, frame_skip=SUBSTEPS)


def asked(simulator, log, **options):
    options = {"actions": "measured", "test_size": 0, "velocities": "measured", **options}
    return SimulationDiagnosis(simulator, **options).fit(*log)


@pytest.fixture(scope="module")
def answer(simulator):
    return asked(simulator, closed_loop(MACHINE))


def test_all_that_brakes_the_joints_is_named_and_covered(answer):
    assert {cause.name for cause in answer.causes_} == set(MACHINE)
    for cause in answer.causes_:
        assert cause.interval[0] < MACHINE[cause.name] < cause.interval[1]
        assert cause.value == pytest.approx(MACHINE[cause.name], rel=0.1)
    assert answer.verdict_ in ("named", "ambiguous")
    assert answer.actions_ == "measured"


def test_both_frictions_of_a_joint_that_moves_slowly_are_told():
    """What parts them is where it turns back, which is faster than the motion: six seconds of a fifth of a hertz."""
    simulator = MujocoSimulator(HEAVY, frame_skip=SUBSTEPS)
    log = closed_loop(SLOW, seed=2, fastest=1.2, text=HEAVY)
    families = ("dry_friction", "damping", "armature", "gain")
    effects = [one.name for one in simulator.effects() if one.family in families and one.target != "all"]
    diagnosis = asked(simulator, log, effects=effects)
    assert {cause.name for cause in diagnosis.causes_} == set(SLOW)
    for cause in diagnosis.causes_:
        assert cause.interval[0] < SLOW[cause.name] < cause.interval[1]


@pytest.mark.parametrize("early", [0, -25])
def test_nothing_is_named_of_a_right_model_whenever_efforts_were_read(simulator, early):
    diagnosis = asked(simulator, closed_loop({}, early=early))
    assert diagnosis.causes_ == []
    assert diagnosis.verdict_ == "nothing detected"


def test_a_torque_constant_is_told_where_gravity_anchors_it(simulator):
    (cause,) = asked(simulator, closed_loop({}, gain=(0.8, 1.0))).causes_
    assert cause.name == "gain[shoulder]"
    assert cause.interval[0] < 0.8 < cause.interval[1]


def test_what_is_left_is_told_by_the_joint_that_lacks_it(simulator):
    truth = {"dry_friction[shoulder]": 0.4}
    diagnosis = asked(simulator, closed_loop(truth), effects=["mass[upper]", "damping[elbow]"])
    (worst, *_) = diagnosis.remainder_.parts
    assert worst.name == "shoulder"
    assert worst.evidence > -np.log(0.01)
    assert worst.predictable == pytest.approx(0.4, rel=0.25)
    assert diagnosis.verdict_ == "unexplained"


def test_rows_are_exact_in_the_inverse_of_a_gain(simulator):
    effects = [one for one in simulator.effects() if one.name in ("gain[shoulder]", "damping[shoulder]")]
    regression = Regression.of(simulator, closed_loop({}, rows=400), effects, {})
    far = regression.about({"gain[shoulder]": 0.5}, 0.0)
    near = regression.about({}, 0.0)
    place = [one.name for one in effects].index("gain[shoulder]")
    assert np.allclose(far.columns[:, place], near.columns[:, place], rtol=1e-6, atol=1e-9)
    assert np.allclose(far.target, near.target, rtol=1e-6, atol=1e-8)


def test_the_answer_in_coordinates_of_causes_says_what_the_regression_says(answer):
    found = answer._found
    places = [found.priors.names.index(name) for name in found.values]
    values = weigh(found.gram, found.priors, places).values
    for place, value in zip(sorted(places), values):
        name = found.priors.names[place]
        assert found.values[name] == pytest.approx(value, rel=1e-2)


def test_a_saved_answer_is_the_same(answer, tmp_path):
    loaded = SimulationDiagnosis.load(answer.save(tmp_path / "answer.skat"))
    assert loaded.actions_ == "measured"
    assert loaded.causes_ == answer.causes_
    assert loaded.remainder_.evidence == answer.remainder_.evidence


@pytest.mark.parametrize("actions", ["torque", None])
def test_an_unknown_word_for_actions_is_an_error(simulator, actions):
    with pytest.raises(ValueError, match="auto, commanded, measured"):
        asked(simulator, closed_loop({}, rows=50), actions=actions)


def test_servos_and_functions_have_no_measured_efforts(simulator):
    log = closed_loop({}, rows=50)
    servos = ROTORS.replace("<motor ", '<position kp="5" ')
    with pytest.raises(ValueError, match=r"servos, which take targets.*actions='commanded'"):
        asked(MujocoSimulator(servos, frame_skip=SUBSTEPS), log)
    function = FunctionSimulator(
        lambda X, drag: X[:, :4],
        input_names=simulator.input_names,
        output_names=simulator.output_names,
        state_names=simulator.state_names,
        effects=[Effect("drag", unit="1", neutral=0.0, bounds=(0.0, 1.0))],
    )
    with pytest.raises(ValueError, match="must be a MujocoSimulator"):
        asked(function, log)


def test_a_base_that_moves_freely_has_no_measured_efforts():
    free = ROTORS.replace(
        '<body name="upper">', '<body name="trunk"><freejoint/><geom size="0.1"/><body name="upper">'
    )
    free = free.replace("</worldbody>", "</body></worldbody>")
    simulator = MujocoSimulator(free, frame_skip=SUBSTEPS)
    log = np.zeros((40, len(simulator.input_names))), np.zeros((40, len(simulator.state_names)))
    effects = simulator.effects()
    with pytest.raises(ValueError, match=r"base='fixed'.*actions='commanded'"):
        Regression.of(simulator, (*log, np.zeros(40, dtype=int)), effects, {})


def test_effects_of_which_efforts_tell_nothing_are_an_error_that_names_them(simulator):
    with pytest.raises(ValueError, match=r"tell nothing of delay\[action\]: ask about masses"):
        asked(simulator, closed_loop({}, rows=50), effects=["delay[action]"])


def test_what_is_named_is_likely(answer):
    for cause in answer.causes_:
        others = sum(alias.probability for alias in cause.aliases)
        assert cause.probability > 0.5
        assert cause.probability + others <= 1 + 1e-9
