"""Which causes are kept and exchanged."""

from dataclasses import replace

import numpy as np
import pytest
from sklearn.utils import check_random_state

from skat.diagnosis import SimulationDiagnosis
from skat.diagnosis.aliases import _rivals
from skat.diagnosis.evidence import grams, screen
from skat.diagnosis.log import check_log
from skat.diagnosis.refits import Fit
from skat.diagnosis.residuals import Linearisation, Residuals
from skat.diagnosis.selection import Selection
from skat.diagnosis.transitions import TransitionResiduals
from skat.effects import Effect
from skat.simulators import FunctionSimulator, MujocoSimulator
from tests.diagnosis.cart_pole import make_simulator, measure


@pytest.fixture
def simulator():
    return make_simulator()


def selection_by(residuals, alpha=0.005):
    return Selection(residuals, list(residuals.effects), alpha=alpha, max_effects=6, progress=lambda *_: None)


def selection_of(simulator, hidden, seed=3):
    X, y, groups, _ = measure(seed, **hidden)
    log, _ = check_log(simulator, X, y, groups).split(0.3, check_random_state(0))
    selection = selection_by(TransitionResiduals(simulator, log, simulator.effects()))
    selection.estimates.linearised({})
    return selection


def selection_in_rows(function, X, y, deviation=None, **ranges):
    """Return a Selection among effects with (lowest, neutral, highest) value each, of independent rows."""
    effects = [
        Effect(name, unit="1", neutral=neutral, bounds=(low, high))
        for name, (low, neutral, high) in ranges.items()
    ]
    inputs, outputs = "abc"[: X.shape[1]], "uvw"[: y.shape[1]]
    simulator = FunctionSimulator(function, input_names=inputs, output_names=outputs, effects=effects)
    deviations = None if deviation is None else [deviation] * y.shape[1]
    return selection_by(Residuals(simulator, check_log(simulator, X, y, None), effects, deviations))


@pytest.mark.parametrize(
    ("hidden", "named"),
    [
        ({"gain": 0.9, "drag": 0.3}, {"dry_friction": 0.1, "drag": 0.1}),
        ({"drag": 0.3}, {"gain": 0.8, "hinge": 0.005}),
        ({"drag": 0.3}, {"gain": 0.8}),
    ],
)
def test_wrong_causes_are_exchanged_for_the_right_ones(simulator, hidden, named):
    selection = selection_of(simulator, hidden)
    values, line = selection.estimates.polished(named)
    while exchanged := selection._exchanged(values, line)[0]:
        values, line = selection.estimates.polished(exchanged)
    assert set(values) == set(hidden)
    for name, value in hidden.items():
        assert abs(values[name] - value) < 0.05


def test_right_pair_is_kept(simulator):
    hidden = {"gain": 0.9, "drag": 0.3}
    selection = selection_of(simulator, hidden)
    values, line = selection.estimates.polished(hidden)
    assert selection._exchanged(values, line)[0] is None


def test_effect_without_which_a_model_predicts_better_misleads(simulator):
    selection = selection_of(simulator, {"drag": 0.3})
    assert selection.judgement.predicts({"drag": 0.3}, {})
    assert not selection.judgement.predicts({"drag": 0.3, "gain": 1.2}, {"drag": 0.3})
    assert selection.judgement.misleading({"drag": 0.3, "gain": 1.2}) == "gain"
    assert selection.judgement.misleading({"drag": 0.3}) is None


def weight(X, shift_x=0.0, shift_y=0.0, turn=0.0, **pulls):
    """Return the place of a weight off a turning disc's centre, beside a pull that depends on one input."""
    angle, along = X.T
    x, y = 0.12 + shift_x, 0.06 + shift_y
    turned = angle + turn
    shapes = {"spring": along, "drag": along * np.abs(along), "bend": along**3, "stop": np.tanh(along)}
    pull = sum(size * shapes[name] for name, size in pulls.items()) + 0.0 * along
    return np.stack(
        [x * np.cos(turned) - y * np.sin(turned) - pull, x * np.sin(turned) + y * np.cos(turned)], 1
    )


def test_sensor_turned_far_is_exchanged_for_the_shift_that_it_stands_for():
    rng = np.random.default_rng(0)
    X = rng.uniform(-3, 3, (300, 2))
    reaches = {
        "shift_x": 0.3,
        "shift_y": 0.3,
        "turn": 3.0,
        "spring": 1.0,
        "drag": 1.0,
        "bend": 1.0,
        "stop": 1.0,
    }
    y = weight(X, shift_y=-0.1, spring=0.02) + 0.001 * rng.normal(size=(300, 2))
    ranges = {name: (-reach, 0.0, reach) for name, reach in reaches.items()}
    selection = selection_in_rows(weight, X, y, 0.001, **ranges)
    selection.estimates.linearised({})
    values, line = selection.estimates.polished({"turn": -0.8, "spring": 0.02})
    exchanged, _ = selection._exchanged(values, line)
    assert set(exchanged) == {"shift_y", "spring"}
    assert abs(exchanged["shift_y"] + 0.1) < 0.001


def wave(X, frequency=1.0):
    """Return a wave: of its frequency, the loss has an optimum every few percent."""
    return np.sin(3 * frequency * X)


def test_value_in_the_wrong_optimum_is_left_for_the_right_one():
    rng = np.random.default_rng(0)
    X = rng.uniform(0, 10, (300, 1))
    y = wave(X, 1.503) + 0.02 * rng.normal(size=X.shape)
    selection = selection_in_rows(wave, X, y, 0.02, frequency=(0.3, 1.0, 3.0))
    selection.estimates.linearised({})
    stuck, line = selection.estimates.polished({"frequency": 1.1})
    assert abs(stuck["frequency"] - 1.503) > 0.1
    loss = selection.refits.losses(line.residuals).sum()
    right, line = selection.estimates.polished(selection._elsewhere(stuck, loss, ["frequency"]))
    assert abs(right["frequency"] - 1.503) < 0.002
    loss = selection.refits.losses(line.residuals).sum()
    assert selection._elsewhere(right, loss, ["frequency"]) is None


def bent_slope(X, length=1.0):
    """Return a line whose slope is 0 at length 1, at most .25 above it, and .5 at .86."""
    slope = np.where(length > 0.98, np.minimum(5 * (length - 1), 0.25), 5 * (0.98 - length) - 0.1)
    return slope * X


def test_effect_is_added_at_the_deepest_of_its_optima_although_its_slope_leads_to_another():
    rng = np.random.default_rng(0)
    X = rng.normal(size=(300, 1))
    y = 0.5 * X + 0.6 * rng.normal(size=X.shape)
    selection = selection_in_rows(bent_slope, X, y, 0.6, length=(0.3, 1.0, 3.0))
    added = selection._add({}, selection.estimates.linearised({}))
    assert abs(added["length"] - 0.86) < 0.03


def wave_and_ripple(X, frequency=1.0, ripple=0.0):
    return wave(X, frequency) + ripple * np.sin(40 * X)


def rippled_selection(ripple):
    """Return the Selection of a wave of frequency 1.503 with a ripple, in noise of 0.02."""
    rng = np.random.default_rng(0)
    X = rng.uniform(0, 10, (300, 1))
    y = wave_and_ripple(X, 1.503, ripple) + 0.02 * rng.normal(size=X.shape)
    ranges = {"frequency": (0.3, 1.0, 3.0), "ripple": (-1.0, 0.0, 1.0)}
    return selection_in_rows(wave_and_ripple, X, y, 0.02, **ranges)


def test_whole_ranges_are_searched_when_all_that_was_added_is_dropped(monkeypatch):
    selection = rippled_selection(0.0)
    grown, searches = selection._grown, []

    def misled_at_first(line, *, far_off=False):
        searches.append(far_off)
        if not far_off:
            return {"ripple": 0.05}, selection.estimates.linearised({"ripple": 0.05}), [{"ripple": 0.05}]
        return grown(line, far_off=far_off)

    monkeypatch.setattr(selection, "_grown", misled_at_first)
    selected = selection.run()
    assert searches == [False, True]
    assert set(selected.values) == {"frequency"}
    assert abs(selected.values["frequency"] - 1.503) < 0.002


BURSTS = {"first": 20, "second": 120, "third": 220}


def bursts_and_slope(X, slope=0.0, **sizes):
    bursts = sum(sizes.get(name, 0.0) * (np.abs(X - row) < 3) for name, row in BURSTS.items())
    return 0.01 * slope * (X - 150) + bursts


def test_what_is_certain_is_added_where_what_explains_more_is_not():
    """Three effects of five rows each explain most, none of them significantly; a slope in all rows does."""
    rng = np.random.default_rng(0)
    X = np.arange(300.0)[:, None]
    y = bursts_and_slope(X, 0.6) + rng.normal(size=X.shape)
    for row in BURSTS.values():
        y[row - 2 : row + 3, 0] += [6, 12, 8, 11, 5]
    ranges = dict.fromkeys(("slope", *BURSTS), (-50.0, 0.0, 50.0))
    selection = selection_in_rows(bursts_and_slope, X, y, 1.0, **ranges)
    line = selection.estimates.linearised({})
    losses = {name: selection.refits.fit([{name: 0.5}])[0].loss for name in ("slope", *BURSTS)}
    assert max(losses, key=losses.get) == "slope"
    added = selection._add({}, line)
    assert set(added) == {"slope"}
    assert abs(added["slope"] - 0.6) < 0.2


@pytest.mark.parametrize(("slope", "added"), [(0.5, set()), (2.0, {"slope"})])
def test_what_explains_little_of_a_log_that_is_like_no_model_is_not_named(slope, added):
    """A wave five times as large as the noise is in no list; a slope explains a fiftieth of that, or a fifth."""
    rng = np.random.default_rng(0)
    X = np.linspace(0, 300, 3000)[:, None]
    y = bursts_and_slope(X, slope) + 5 * np.sin(40 * X) + rng.normal(size=X.shape)
    selection = selection_in_rows(bursts_and_slope, X, y, 1.0, slope=(-50.0, 0.0, 50.0))
    line = selection.estimates.linearised({})
    fit = selection.refits.fit([{"slope": slope}])[0]
    assert selection.estimates.p_values(fit.values)["slope"] < 1e-4
    assert set(selection._add({}, line) or ()) == added


def offset_and_scale(X, offset=0.0, scale=1.0):
    return scale * X + offset


@pytest.fixture
def offset_or_scale():
    """A selection between an offset and a scale, of which the log has the scale, 1.075."""
    rng = np.random.default_rng(0)
    X = rng.uniform(0.6, 1.2, size=(300, 1))
    y = 1.075 * X + 0.005 * rng.normal(size=X.shape)
    ranges = {"offset": (-1.0, 0.0, 1.0), "scale": (0.5, 1.0, 2.0)}
    selection = selection_in_rows(offset_and_scale, X, y, **ranges)
    selection.estimates.linearised({})
    return selection


def test_misfit_that_changes_from_one_settling_to_the_next_makes_no_exchange(offset_or_scale, monkeypatch):
    values, line = offset_or_scale.estimates.polished({"scale": 1.075})
    misfits = iter(range(0, -10_000, -1000))
    monkeypatch.setattr(offset_or_scale.refits, "misfit", lambda residuals: next(misfits))
    assert offset_or_scale._nearer(values, line, [{"offset": 0.07}]) == (values, line)


def test_rows_that_a_model_leaves_out_make_it_no_likelier_and_no_less_likely(offset_or_scale):
    refits, residuals = offset_or_scale.refits, offset_or_scale.residuals
    misfit = refits.misfit(refits.whitened([{"scale": 1.075}])[0])
    wrong = refits.misfit(refits.whitened([{"scale": 1.074}])[0])
    residuals._leave_out(np.arange(300) % 10 == 0)
    white = refits.whitened([{"scale": 1.075}])[0]
    assert abs(refits.misfit(white) - misfit) < 0.1 * abs(misfit)
    assert refits.is_likelier(white, wrong, 0.0)
    assert not refits.is_likelier(white, misfit - 0.1, 0.0)


@pytest.mark.parametrize(
    ("values", "near", "best"),
    [({"offset": 0.07}, {"scale": 1.05}, "scale"), ({"scale": 1.075}, {"offset": 0.05}, "scale")],
)
def test_what_explains_nearly_as_much_is_judged_with_noise_of_its_own(offset_or_scale, values, near, best):
    selection, residuals = offset_or_scale, offset_or_scale.residuals
    values, line = selection.estimates.polished(values)
    before = residuals.state()
    found, found_line = selection._nearer(values, line, [near])
    assert set(found) == {best}
    assert abs(found[best] - 1.075) < 0.002
    if found is values:
        assert found_line is line
        assert all(vars(residuals)[name] is value for name, value in before.items())
    else:
        assert set(found_line.values) == {best}
    # What was left is not tried again; named all the same, it has what was better as an alias.
    assert selection._nearer(found, found_line, [near]) == (found, found_line)
    assert selection._better(found) == []
    if found is not values:
        ((cause,), (rival,)) = values, found
        assert selection._better(values) == [(cause, rival)]
        pruned = selection._prune(values, line)
        assert pruned.values == values
        assert rival in selection._result(pruned, {cause: 0.0}).aliases[cause]


def test_exchanges_do_not_come_back_to_a_set_that_one_has_left(monkeypatch):
    selection = rippled_selection(0.0)
    polished = []

    def other_one(values, line):
        return ({"ripple": 0.1} if "frequency" in values else {"frequency": 1.5}), []

    def remember(values):
        polished.append(set(values))
        return values, None

    monkeypatch.setattr(selection, "_exchanged", other_one)
    monkeypatch.setattr(selection.estimates, "polished", remember)
    assert selection._simplified({"frequency": 1.5}, None) == ({"ripple": 0.1}, None)
    assert selection._simplified({"ripple": 0.1}, None) == ({"ripple": 0.1}, None)
    assert polished == [{"ripple"}]


def test_an_effect_that_averaging_makes_uncertain_is_dropped(monkeypatch):
    assert set(rippled_selection(0.0075).run().values) == {"frequency", "ripple"}
    selection = rippled_selection(0.0075)
    averaged = selection.estimates.averaged

    def uncertain(values, line):
        values, line, spread = averaged(values, line)
        return values, line, spread | ({"ripple": 0.1} if "ripple" in values else {})

    monkeypatch.setattr(selection.estimates, "averaged", uncertain)
    assert set(selection.run().values) == {"frequency"}


def slowed(X, damping=0.0, dry_friction=0.0):
    """Return the next place and speed of a block that is pushed off and slides: both effects slow it down."""
    place, speed = X.T
    left = speed * np.exp(-damping)
    left = np.sign(left) * np.maximum(np.abs(left) - dry_friction, 0.0)
    return np.stack([place + 0.1 * left, left], 1)


def test_friction_that_stops_at_once_is_named_with_its_p_value_and_an_interval():
    """How large it is hardly any row shows, so that a derivative there says now this and now that."""
    rng = np.random.default_rng(0)
    n_episodes, n_rows = 10, 20
    states = np.zeros((n_episodes, n_rows + 1, 2))
    states[:, 0] = rng.normal(size=(n_episodes, 2))
    for row in range(n_rows):
        states[:, row + 1] = slowed(states[:, row], dry_friction=10.0)
    states += 0.01 * rng.normal(size=states.shape)
    effects = [
        Effect("damping", unit="1", neutral=0.0, bounds=(0.0, 2.0)),
        Effect("dry_friction", unit="m/s", neutral=0.0, bounds=(0.0, 20.0)),
    ]
    names = ("place", "speed")
    simulator = FunctionSimulator(
        slowed, input_names=names, output_names=names, state_names=names, effects=effects
    )
    X, y = states[:, :-1].reshape(-1, 2), states[:, 1:].reshape(-1, 2)
    log = check_log(simulator, X, y, np.repeat(np.arange(n_episodes), n_rows))
    selected = selection_by(TransitionResiduals(simulator, log, effects), alpha=1e-4).run()
    assert set(selected.values) == {"dry_friction"}
    assert selected.p_values["dry_friction"] < 1e-4
    low, high = selected.intervals["dry_friction"]
    assert 0.2 < low < np.abs(states[:, 0, 1]).max() < high == 20.0


def bouncing(X, stiffness=1.0):
    """Return a response in a tenth of the rows that falls towards softer springs, rises, and falls again."""
    response = stiffness + 0.5 * np.sin(12 * stiffness)
    return np.where(X[:, :1] % 10 == 0, 20 * response * X[:, 1:], 0.0)


@pytest.mark.parametrize(("some_far_off", "tried"), [(False, []), (True, [0.33])])
def test_whole_range_of_what_tells_is_tried_where_some_rows_are_far_off(some_far_off, tried, monkeypatch):
    rng = np.random.default_rng(0)
    X = np.stack([np.arange(300.0), rng.uniform(1, 2, 300)], 1)
    y = bouncing(X, 0.35) + rng.normal(size=(300, 1))
    selection = selection_in_rows(bouncing, X, y, 1.0, stiffness=(0.2, 1.0, 5.0))
    line = selection.estimates.linearised({})
    first = screen(grams(line.residuals, line.derivatives, np.arange(300)), line.names, {}, selection.effects)
    monkeypatch.setattr(selection.proposals, "_grid", lambda values, names: [])
    steps, *rest = selection.proposals.further({}, first, far_off=False, some_far_off=some_far_off)
    assert steps[0]["stiffness"] > 0.8
    assert [model["stiffness"] for models in rest for model in models] == tried


def test_nearest_effects_are_tried_as_aliases_however_large_the_cause_is():
    """Directions are those of wide steps: where effects bend, a pendulum's mass is not quite along its motor's gain."""
    names = ("gain", "mass", "length", "damping", "gravity")
    cosines = np.array([1.0, 0.94, 0.6, 0.9, 0.1])
    derivatives = np.zeros((500, 1, 5))
    derivatives[0, 0] = 100 * cosines
    derivatives[np.arange(1, 6), 0, np.arange(5)] = 100 * np.sqrt(1 - cosines**2)
    effects = {name: Effect(name, unit="1", neutral=1.0, bounds=(0.1, 10.0)) for name in names}
    values = {"gain": 4.0}
    line = Linearisation(values, np.zeros((500, 1)), derivatives, names)
    assert list(_rivals(effects, "gain", values, line)) == ["mass", "damping"]


N_JOINTS = 4


def pushed_to_stops(X):
    """Return the next places and speeds of joints that are pushed against stiff stops at 0.5."""
    places, speeds, forces = np.split(X, 3, axis=1)
    for _ in range(20):
        depths = np.maximum(0.5 - places, 0.0)
        pushed = 8 * forces - 2 * speeds + 2000 * depths - 40 * speeds * (depths > 0)
        speeds = speeds + 0.0025 * pushed
        places = places + 0.0025 * speeds
    return np.hstack([places, speeds])


def test_scale_that_passes_for_noise_at_a_stop_is_judged_at_the_noise_it_leaves():
    """A joint that is read 4 % too small lies within its stop, which throws it out in the simulation of such rows."""
    rng = np.random.default_rng(2)
    n_episodes, n_rows = 4, 50
    forces = np.repeat(rng.uniform(-1.5, 0.7, (n_episodes, n_rows // 5, N_JOINTS)), 5, axis=1)
    states = np.zeros((n_episodes, n_rows + 1, 2 * N_JOINTS))
    states[:, 0, :N_JOINTS] = rng.uniform(0.5, 1.2, (n_episodes, N_JOINTS))
    for row in range(n_rows):
        states[:, row + 1] = pushed_to_stops(np.hstack([states[:, row], forces[:, row]]))
    states[..., 1] *= 0.96
    states += 0.01 * states.std(axis=(0, 1)) * rng.normal(size=states.shape)
    names = tuple(f"{what}{joint}" for what in ("place", "speed") for joint in range(N_JOINTS))
    inputs = (*names, *(f"force{joint}" for joint in range(N_JOINTS)))
    simulator = FunctionSimulator(pushed_to_stops, input_names=inputs, output_names=names, state_names=names)
    X = np.concatenate([states[:, :-1], forces], axis=2).reshape(-1, len(inputs))
    groups = np.repeat(np.arange(n_episodes), n_rows)
    diagnosis = SimulationDiagnosis(simulator, random_state=2).fit(
        X, states[:, 1:].reshape(len(X), -1), groups=groups
    )
    (cause,) = diagnosis.causes_
    assert (diagnosis.verdict_, cause.name) == ("named", "scale[place1]")
    low, high = cause.interval
    assert 0.95 < low < 0.96 < high < 0.97


def test_ties_are_ordered_by_odds_then_as_listed_and_never_by_rounding(simulator):
    selection = selection_of(simulator, {})
    losses = {"hinge": 9.9, "gain": 10.0, "drag": 10.0 + 1e-9, "pole": 20.0, "bob": 20.5, "gravity": 12.0}
    selection.names = ["gravity", "bob", "pole", "gain", "drag", "hinge"]
    odds = {"hinge": 0.2}
    selection.effects = {
        name: replace(effect, odds=odds.get(name, 1.0)) for name, effect in selection.effects.items()
    }
    for sign in (-1e-7, 1e-7):
        fits = [
            Fit({"kept": 1.0, name: 2.0}, np.array([loss + sign * k]))
            for k, (name, loss) in enumerate(losses.items())
        ]
        ranked = [list(fit.values)[1] for fit in selection._ranked(fits, {"kept": 1.0})]
        assert ranked == ["gain", "drag", "hinge", "gravity", "bob", "pole"]


DRIVEN = """
<mujoco>
  <option timestep="0.01"/>
  <worldbody>
    <body name="arm">
      <joint name="shoulder" type="hinge" axis="0 1 0" damping="0.2"/>
      <geom type="capsule" fromto="0 0 0 0 0 -0.5" size="0.03" mass="1"/>
    </body>
  </worldbody>
  <actuator><motor name="motor" joint="shoulder"/></actuator>
</mujoco>
"""


@pytest.mark.parametrize("delay", [0.01, 0.02, 0.03, 0.05])
def test_delay_is_sought_at_every_time_step_and_row(delay):
    simulator = MujocoSimulator(DRIVEN, frame_skip=2)
    rng = np.random.default_rng(0)
    commands = rng.uniform(-1, 1, (4, 40, 1))
    states = simulator.rollout(
        rng.normal(size=(4, 2)), commands, n_steps=40, effects={"delay[action]": delay}
    )
    states = states + 1e-3 * rng.normal(size=states.shape)
    X = np.concatenate([states[:, :-1], commands], axis=2).reshape(-1, 3)
    log = check_log(simulator, X, states[:, 1:].reshape(-1, 2), np.repeat(np.arange(4), 40))
    selection = selection_by(TransitionResiduals(simulator, log, simulator.effects()))
    line = selection.estimates.linearised({})
    (found,) = selection.proposals.elsewhere({"delay[action]": 0.004}, ["delay[action]"])
    assert found["delay[action]"] == pytest.approx(delay, rel=1e-9)
    first = screen(
        grams(line.residuals, line.derivatives, selection.estimates.clusters(len(line.names))),
        line.names,
        {},
        selection.effects,
        [],
    )
    models = next(selection.proposals.further({}, first, far_off=False, some_far_off=False))
    (started,) = (model["delay[action]"] for model in models if "delay[action]" in model)
    assert started == pytest.approx(delay, rel=1e-3)
