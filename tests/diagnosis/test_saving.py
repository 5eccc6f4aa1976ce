"""A diagnosis in a file says what it said, and an interrupted fit comes to the answer of one that was not."""

import json
import pickletools
import zipfile
from dataclasses import fields, is_dataclass, replace
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from skat.diagnosis import SimulationDiagnosis, archive, saving
from skat.diagnosis.archive import classes, digest, opened, write_archive
from skat.diagnosis.log import Log
from skat.diagnosis.saving import SavedSimulator
from skat.effects import Effect
from skat.simulators import MujocoSimulator, make_simulator
from tests.diagnosis import cart_pole, pendulum
from tests.diagnosis.cart_pole import measure

EFFECTS = ["bob", "pole", "drag", "gain", "bias[angle]"]
HEAVIER = pendulum.TEXT.format(damping=0.15)


class Stop(Exception):
    """What a user's interruption is in these tests."""


def a_diagnosis(**parameters):
    """Return a diagnosis of the cart with a pole."""
    return SimulationDiagnosis(
        **{"simulator": cart_pole.make_simulator(), "effects": EFFECTS, "random_state": 0, **parameters}
    )


@pytest.fixture(scope="module")
def of_function():
    """A diagnosis of a function simulator, and its log."""
    log = measure(4, n_episodes=13, n_steps=12, drag=0.3, pole=1.1)[:3]
    return a_diagnosis().fit(*log), log


@pytest.fixture(scope="module")
def of_mujoco():
    """A diagnosis of a MuJoCo model that has something built in, and its log, the velocities hidden in part."""
    simulator = MujocoSimulator(
        pendulum.NOMINAL, frame_skip=pendulum.FRAME_SKIP, built_in={"gain[motor]": 1.0, "gravity": 0.99}
    )
    X, y, groups = pendulum.measured(HEAVIER, 0, rows=20, episodes=6)
    X[70, 1] = y[69, 1] = np.nan
    log = X, y, np.array(["first", "second", "third", "fourth", "fifth", "sixth"])[groups]
    effects = ["damping[hinge]", "gravity", "mass[rod]", "delay[action]", "bias[qpos.hinge]"]
    diagnosis = SimulationDiagnosis(
        simulator, effects=effects, random_state=np.random.RandomState(3), priors={"gravity": 0.02}
    )
    return diagnosis.fit(*log), log


def same(first, second):
    """Assert that two values hold the same numbers, to the last bit."""
    assert type(first) is type(second)
    if is_dataclass(first):
        for one in fields(first):
            if one.name != "simulator":
                same(getattr(first, one.name), getattr(second, one.name))
    elif isinstance(first, dict):
        assert list(first) == list(second)
        for key, value in first.items():
            same(value, second[key])
    elif isinstance(first, tuple | list):
        assert len(first) == len(second)
        for one, other in zip(first, second):
            same(one, other)
    elif isinstance(first, np.ndarray):
        assert first.dtype == second.dtype
        np.testing.assert_array_equal(first, second)
    elif isinstance(first, pd.DataFrame):
        pd.testing.assert_frame_equal(first, second, check_exact=True)
    elif isinstance(first, float) and np.isnan(first):
        assert np.isnan(second)
    elif not callable(first):
        assert first == second


ATTRIBUTES = (
    *("verdict_", "causes_", "also_seen_", "gain_", "noise_", "remainder_", "posterior_", "identifiability_"),
    *("computed_velocities_", "diverged_share_", "settled_", "n_features_in_"),
)


def assert_same_answers(twin, diagnosis, log):
    for name in ATTRIBUTES:
        same(getattr(twin, name), getattr(diagnosis, name))
    assert twin.posterior_.sample(5, 0) == diagnosis.posterior_.sample(5, 0)
    assert repr(twin.extended_simulator_) == repr(diagnosis.extended_simulator_)
    X, groups = np.nan_to_num(log[0]), log[2]
    np.testing.assert_array_equal(twin.predict(X, groups=groups), diagnosis.predict(X, groups=groups))
    assert twin.score(X, np.nan_to_num(log[1])) == diagnosis.score(X, np.nan_to_num(log[1]))


# -- round trips -----------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("kind", ["of_function", "of_mujoco"])
def test_loaded_diagnosis_answers_as_the_one_that_was_saved(kind, request, tmp_path):
    diagnosis, log = request.getfixturevalue(kind)
    assert diagnosis.causes_
    given = cart_pole.make_simulator() if kind == "of_function" else None
    path = diagnosis.save(tmp_path / "arm.skat")
    twin = SimulationDiagnosis.load(path, simulator=given)
    assert_same_answers(twin, diagnosis, log)
    # Both draw from where the fit left the generator.
    same(twin.evaluate(*log), diagnosis.evaluate(*log))
    same(
        twin.evaluate(*log, horizon="episode"),
        diagnosis.evaluate(*log, horizon="episode"),
    )
    own, other = twin.get_params(deep=False), diagnosis.get_params(deep=False)
    for name in own.keys() - {"simulator", "random_state"}:
        assert own[name] == other[name]


@pytest.mark.parametrize("kind", ["of_function", "of_mujoco"])
def test_report_of_a_loaded_diagnosis_is_the_one_that_was_saved(kind, request, tmp_path):
    diagnosis, _ = request.getfixturevalue(kind)
    given = diagnosis.simulator if kind == "of_function" else None
    diagnosis.report_.describe(title="Monday's arm")
    diagnosis.report_.add_table("rows", pd.DataFrame({"a": [1.5, np.nan]}))
    twin = SimulationDiagnosis.load(diagnosis.save(tmp_path / "arm.skat"), simulator=given)
    assert twin.report_.text() == diagnosis.report_.text()
    assert twin.report_.html(figures=False) == diagnosis.report_.html(figures=False)
    if given is None:  # its pictures are drawn in a process of their own, which takes long
        return
    assert twin.report_.html() == diagnosis.report_.html()
    # With what was measured for the page, too.
    again = SimulationDiagnosis.load(twin.save(tmp_path / "again.skat"), simulator=given)
    assert again.report_.html() == diagnosis.report_.html()
    same(again.report_.tests, diagnosis.report_.tests)


def test_loaded_diagnosis_can_be_fitted_again(of_mujoco, tmp_path):
    diagnosis, log = of_mujoco
    twin = SimulationDiagnosis.load(diagnosis.save(tmp_path / "arm.skat")).set_params(random_state=1)
    before = twin.causes_
    (cause,) = [one for one in twin.fit(*log).causes_ if one.name == before[0].name]
    assert cause.value == pytest.approx(before[0].value, rel=0.05)


def test_puck_is_saved_with_its_simulator(tmp_path):
    puck = make_simulator("puck", condition="isotr_low_offc")
    X = np.array([[0.0, 0.5], [1.0, -0.5]])
    log = Log(X, puck.predict(X), np.arange(2), False)
    write_archive(tmp_path / "puck", "puck", {"puck": vars(SavedSimulator.of(puck, log))})
    with opened(tmp_path / "puck", "puck") as file:
        twin = SavedSimulator(**file.read("puck")).restored(None, tmp_path / "puck")
    assert twin.get_params() == puck.get_params()


@pytest.mark.parametrize(
    "value",
    [
        *(None, True, np.bool_(False), 3, np.int64(-7), 0.1, -0.0, np.inf, -np.inf, np.nan, "word", b"\x00\xff"),
        *((), [], {}, (1, (2.5, "a")), [[None]], {(1, 2): {"is": "array"}, "is": 3}),
        *(np.arange(6).reshape(2, 3), np.zeros((0, 4)), np.array(2.5), np.array(["a", "bc"])),
        *(np.asfortranarray(np.arange(1200.0).reshape(30, 40)), np.array([np.nan, -0.0, 5e-324])),
        pd.DataFrame({"a": [1, 2], "b": ["x", "y"], "c": [True, False]}, index=pd.Index(["p", "q"], name="row")),
        pd.DataFrame({"a": [1.5, np.nan], "b": ["x", None]}),
    ],
    ids=lambda value: f"{type(value).__name__} {value!r:.20}",
)  # fmt: skip
def test_values_come_back_as_they_were(value, tmp_path):
    write_archive(tmp_path / "value", "value", {"value": value})
    with opened(tmp_path / "value", "value") as file:
        back = file.read("value")
    if isinstance(value, np.generic):
        value = value.item()
    same(back, value)
    if isinstance(value, float | np.ndarray) and np.asarray(value).dtype.kind == "f":
        np.testing.assert_array_equal(np.signbit(back), np.signbit(value))
    assert digest(back) == digest(value)


def test_generator_comes_back_where_it_was(tmp_path):
    random_state = np.random.RandomState(5)
    random_state.normal(size=3)
    write_archive(tmp_path / "value", "value", {"value": random_state})
    with opened(tmp_path / "value", "value") as file:
        back = file.read("value")
    np.testing.assert_array_equal(back.normal(size=4), random_state.normal(size=4))


# -- what the file is ------------------------------------------------------------------------------------------------


def test_file_holds_json_and_arrays_of_numbers(of_mujoco, tmp_path):
    path = of_mujoco[0].save(tmp_path / "arm.skat")
    with zipfile.ZipFile(path) as file:
        names = file.namelist()
        assert archive.CONTENT in names
        json.loads(file.read(archive.CONTENT), parse_constant=pytest.fail)
        for name in set(names) - {archive.CONTENT}:
            with file.open(name) as array:
                assert not np.lib.format.read_array(array, allow_pickle=False).dtype.hasobject
            with pytest.raises(ValueError, match=r"at position|opcode|exhausted"):
                list(pickletools.genops(file.read(name)))


def test_file_does_not_grow_with_the_square_of_the_state(of_function, tmp_path):
    diagnosis, log = of_function
    path = diagnosis.save(tmp_path / "cart.skat")
    # The log, a few predictions and laws; a pass of the filter alone would be 6 d^2 numbers a row.
    assert path.stat().st_size < 8 * len(log[0]) * 4**2 * 6


def test_what_a_file_may_hold_is_data():
    assert all(is_dataclass(one) and one.__module__.startswith("skat.") for one in classes().values())
    assert {"findings.Gain", "causes.Search", "laws.Law", "report.content.Law"} <= set(classes())


def test_file_that_names_another_class_is_refused(tmp_path):
    path = tmp_path / "value"
    write_archive(path, "value", {"value": None})
    rewrite(path, lambda text: text["parts"].update(value={"is": "os.system", "fields": {"command": "true"}}))
    with opened(path, "value") as file, pytest.raises(ValueError, match=r"cannot be read: 'os\.system'"):
        file.read("value")


def test_value_that_cannot_be_written_is_named_and_leaves_no_file(of_function, tmp_path):
    diagnosis = of_function[0]
    hidden, diagnosis.hidden = diagnosis.hidden, object()
    with pytest.raises(TypeError, match=r"parameters\['hidden'\] is a object, which cannot be saved"):
        diagnosis.save(tmp_path / "cart.skat")
    diagnosis.hidden = hidden
    assert not list(tmp_path.iterdir())


# -- files that cannot be used ---------------------------------------------------------------------------------------


def rewrite(path, change):
    """Write a file anew with its text changed."""
    with zipfile.ZipFile(path) as file:
        contents = {name: file.read(name) for name in file.namelist()}
    text = json.loads(contents[archive.CONTENT])
    change(text)
    contents[archive.CONTENT] = json.dumps(text).encode()
    with zipfile.ZipFile(path, "w") as file:
        for name, content in contents.items():
            file.writestr(name, content)


def test_file_that_exists_is_not_overwritten(of_mujoco, tmp_path):
    path = of_mujoco[0].save(tmp_path / "arm.skat")
    with pytest.raises(FileExistsError, match="overwrite it with force=True"):
        of_mujoco[0].save(path)
    of_mujoco[0].save(path, force=True)
    with pytest.raises(FileNotFoundError, match="There is no folder"):
        of_mujoco[0].save(tmp_path / "nowhere" / "arm.skat")
    with pytest.raises(FileNotFoundError, match="There is no file"):
        SimulationDiagnosis.load(tmp_path / "none.skat")


def test_diagnosis_that_is_not_fitted_is_not_saved(tmp_path):
    with pytest.raises(ValueError, match="not fitted"):
        SimulationDiagnosis(cart_pole.make_simulator()).save(tmp_path / "cart.skat")


def test_format_of_another_version_is_refused_with_its_number(of_mujoco, tmp_path):
    path = of_mujoco[0].save(tmp_path / "arm.skat")
    rewrite(path, lambda text: text.update(format=99, skat="7.0"))
    with pytest.raises(
        ValueError, match=r"has the format 99, of skat 7\.0; this is skat .*, which reads the format 2"
    ):
        SimulationDiagnosis.load(path)


def test_field_that_this_version_does_not_know_is_an_error_with_both_versions(of_mujoco, tmp_path):
    path = of_mujoco[0].save(tmp_path / "arm.skat")

    def change(text):
        text["skat"] = "7.0"
        text["parts"]["content"]["fields"]["colour"] = "red"

    rewrite(path, change)
    with pytest.raises(ValueError, match=r"'colour'.*written by 7\.0, read by"):
        SimulationDiagnosis.load(path)


def test_damaged_file_is_an_error_and_never_another_answer(of_mujoco, tmp_path):
    diagnosis, _ = of_mujoco
    path = diagnosis.save(tmp_path / "arm.skat")
    whole, rng = path.read_bytes(), np.random.default_rng(0)
    for length in (0, 10, len(whole) // 2, len(whole) - 1):
        path.write_bytes(whole[:length])
        with pytest.raises(
            ValueError, match=r"no saved diagnosis that skat wrote, or only a part of one|cannot be read"
        ):
            SimulationDiagnosis.load(path)
    n_refused = 0
    for place in rng.choice(len(whole), 60, replace=False):
        damaged = bytearray(whole)
        damaged[place] ^= 0x55
        path.write_bytes(damaged)
        try:
            text = SimulationDiagnosis.load(path).report_.text()
        except ValueError as error:
            n_refused += str(path) in str(error)
        else:  # in a place of the zip that nobody reads
            assert text == diagnosis.report_.text()
    assert n_refused > 50


def test_other_file_is_told_from_a_diagnosis(tmp_path):
    np.savez(tmp_path / "log.npz", X=np.zeros(3))
    with pytest.raises(ValueError, match="cannot be read"):
        SimulationDiagnosis.load(tmp_path / "log.npz")
    (tmp_path / "arm.xml").write_text(HEAVIER)
    with pytest.raises(ValueError, match="no saved diagnosis"):
        SimulationDiagnosis.load(tmp_path / "arm.xml")


# -- simulators ------------------------------------------------------------------------------------------------------


def test_function_has_to_be_given(of_function, tmp_path):
    path = of_function[0].save(tmp_path / "cart.skat")
    with pytest.raises(ValueError, match=r"a FunctionSimulator with Python code.*Pass simulator="):
        SimulationDiagnosis.load(path)


def test_model_with_effects_of_ones_own_has_to_be_given(tmp_path):
    def stiffen(spec, value):
        spec.joint("hinge").stiffness[0] = value

    own = Effect("spring[hinge]", unit="N m/rad", neutral=0.0, bounds=(0.0, 5.0), apply=stiffen)
    simulator = MujocoSimulator(pendulum.NOMINAL, frame_skip=pendulum.FRAME_SKIP, extra_effects=[own])
    X, y, groups = pendulum.measured(pendulum.NOMINAL, 1, rows=30)
    diagnosis = SimulationDiagnosis(simulator, effects=["spring[hinge]", "damping[hinge]"], random_state=0)
    path = diagnosis.fit(X, y, groups).save(tmp_path / "arm.skat")
    with pytest.raises(ValueError, match="Pass simulator="):
        SimulationDiagnosis.load(path)
    assert SimulationDiagnosis.load(path, simulator=simulator).verdict_ == diagnosis.verdict_
    plain = MujocoSimulator(pendulum.NOMINAL, frame_skip=pendulum.FRAME_SKIP)
    with pytest.raises(ValueError, match=r"it has no spring\[hinge\]"):
        SimulationDiagnosis.load(path, simulator=plain)


def other_cart(**changes):
    """Return the cart with a pole, made otherwise."""
    simulator = cart_pole.make_simulator()
    return simulator.set_params(**{name: change(simulator) for name, change in changes.items()})


@pytest.mark.parametrize(
    ("simulator", "message"),
    [
        (lambda: make_simulator("puck"), "its input_names are z0, z1 and were x, angle"),
        (lambda: other_cart(effects=lambda one: one._effects[1:]), "it has no bob"),
        (
            lambda: other_cart(
                effects=lambda one: [replace(one._effects[0], bounds=(0.2, 7.0)), *one._effects[1:]]
            ),
            r"bob is in 1, neutral at 1, bounds \(0\.2, 7\.0\), and was in 1, neutral at 1, bounds \(0\.2, 5\.0\)",
        ),
        (
            lambda: other_cart(
                function=lambda _: lambda X, **values: 1.001 * cart_pole.cart_pole(X, **values)
            ),
            "in row 0 of the log it predicts .* for x, and predicted",
        ),
    ],
    ids=["columns", "effects", "bounds", "physics"],
)
def test_simulator_that_is_another_one_is_refused(of_function, tmp_path, simulator, message):
    path = of_function[0].save(tmp_path / "cart.skat")
    with pytest.raises(ValueError, match=f"simulator is not the one that was diagnosed.*{message}"):
        SimulationDiagnosis.load(path, simulator=simulator())


# -- interruptions ---------------------------------------------------------------------------------------------------


def interrupted(diagnosis, log, path, stage, done):
    """Fit until a stage has come so far, and stop there."""

    def progress(now, n_done, total):
        if (now, n_done) == (stage, done):
            raise Stop

    with pytest.raises(Stop):
        diagnosis.fit(*log, progress=progress, resume=path)


@pytest.fixture
def turns(monkeypatch):
    """The turns in which a search relinearises, as they are written."""
    written, write = [], saving.Checkpoint.write

    def counted(self, begun, search):
        written.append(search.turn)
        write(self, begun, search)

    monkeypatch.setattr(saving.Checkpoint, "write", counted)
    return written


# In `make test` one that is interrupted again and again is so in the search.
@pytest.mark.parametrize(("stage", "done"), [pytest.param("search", 1, marks=pytest.mark.long), ("gain", 0)])
def test_interrupted_fit_comes_to_the_answer_of_one_that_was_not(of_function, tmp_path, turns, stage, done):
    reference, log = of_function
    path = tmp_path / "fit.skat"
    interrupted(a_diagnosis(), log, path, stage, done)
    last = turns[-1]
    assert path.exists()
    resumed = a_diagnosis().fit(*log, resume=path)
    assert turns[turns.index(last) + 1 :] == list(range(last + 1, turns[-1] + 1))  # none was made twice
    assert_same_answers(resumed, reference, log)
    assert not path.exists()


def test_fit_that_is_interrupted_again_and_again_comes_to_the_same_answer(of_function, tmp_path):
    reference, log = of_function
    path, stages = tmp_path / "fit.skat", []
    for _ in range(20):
        seen = []

        def progress(stage, done, total, seen=seen):
            seen.append((stage, done))
            if len(seen) == 3:
                raise KeyboardInterrupt

        diagnosis = a_diagnosis()
        try:
            diagnosis.fit(*log, progress=progress if len(stages) < 3 else None, resume=path)
        except KeyboardInterrupt:
            stages.append(seen[0])
            continue
        break
    assert len(stages) == 3
    assert stages == sorted(stages)
    assert stages[0] < stages[-1]
    assert_same_answers(diagnosis, reference, log)


def test_rows_held_out_by_chance_stay_so(of_mujoco, tmp_path):
    diagnosis, log = of_mujoco
    path = tmp_path / "fit.skat"

    def fit_of(random_state):
        return SimulationDiagnosis(
            diagnosis.simulator, effects=diagnosis.effects, priors=diagnosis.priors, random_state=random_state
        )

    interrupted(fit_of(np.random.RandomState(3)), log, path, "search", 1)
    resumed = fit_of(None).fit(*log, resume=path)
    assert_same_answers(resumed, diagnosis, log)


def test_a_fit_goes_on_whatever_episodes_are_called(of_function, tmp_path):
    reference, (X, y, groups) = of_function
    log = X, y, np.array([Path(f"run_{number}.csv") for number in range(13)])[groups.astype(int)]
    interrupted(a_diagnosis(), log, tmp_path / "fit.skat", "gain", 0)
    assert a_diagnosis().fit(*log, resume=tmp_path / "fit.skat").causes_ == reference.causes_


def test_fit_that_is_not_interrupted_writes_and_leaves_nothing_behind(of_mujoco, tmp_path, turns):
    diagnosis, log = of_mujoco
    twin = SimulationDiagnosis(
        diagnosis.simulator,
        effects=diagnosis.effects,
        priors=diagnosis.priors,
        random_state=np.random.RandomState(3),
    )
    assert_same_answers(twin.fit(*log, resume=tmp_path / "fit.skat"), diagnosis, log)
    assert turns == list(range(len(turns)))
    assert len(turns) > 1
    assert not list(tmp_path.iterdir())


@pytest.fixture
def begun(of_function, tmp_path):
    """The file of a fit that was interrupted."""
    path = tmp_path / "fit.skat"
    interrupted(a_diagnosis(), of_function[1], path, "search", 0)
    return path


@pytest.mark.parametrize(
    ("parameters", "message"),
    [
        ({"alpha": 0.02}, "alpha is 0.02 and was 0.01"),
        ({"random_state": 1}, "random_state is 1 and was 0"),
        ({"effects": ["drag"]}, r"effects is \['drag'\] and was \['bob', 'pole'"),
        ({"noise": np.ones(4)}, "noise is array.* and was 'estimate'"),
        ({"hidden": ("v",)}, "another log, or one of which other channels were left out"),
        (
            {
                "simulator": other_cart(
                    function=lambda _: lambda X, **values: cart_pole.cart_pole(X, **values) + 0.1
                )
            },
            "another simulator: in row 0 of the log it predicts",
        ),
    ],
    ids=lambda one: "" if isinstance(one, str) else next(iter(one)),
)
def test_fit_does_not_go_on_with_other_settings(of_function, begun, parameters, message):
    diagnosis = a_diagnosis(**parameters)
    kept = begun.read_bytes()
    with pytest.raises(ValueError, match=f"cannot go on from .*{message}"):
        diagnosis.fit(*of_function[1], resume=begun)
    assert begun.read_bytes() == kept


def test_fit_does_not_go_on_with_another_log(of_function, begun):
    X, y, groups = of_function[1]
    moved = y.copy()
    moved[-1, 0] += 1e-6
    with pytest.raises(ValueError, match="it is of another log"):
        a_diagnosis().fit(X, moved, groups, resume=begun)


def test_fit_does_not_go_on_with_another_floor(of_function, begun):
    with pytest.raises(ValueError, match="it is of another log"):
        a_diagnosis().fit(*of_function[1], floor=np.full(4, 1e-8), resume=begun)


def test_fit_does_not_go_on_in_another_version(of_function, begun):
    rewrite(begun, lambda text: text.update(skat="7.0"))
    with pytest.raises(ValueError, match=r"it was written by skat 7\.0; this is skat"):
        a_diagnosis().fit(*of_function[1], resume=begun)


def test_fit_does_not_go_on_from_what_is_no_search(of_function, tmp_path):
    path = of_function[0].save(tmp_path / "cart.skat")
    kept = path.read_bytes()
    diagnosis = a_diagnosis()
    with pytest.raises(ValueError, match="is a saved diagnosis; expected a search to resume"):
        diagnosis.fit(*of_function[1], resume=path)
    notes = tmp_path / "notes.txt"
    notes.write_text("mine")
    with pytest.raises(ValueError, match="no search to resume"):
        diagnosis.fit(*of_function[1], resume=notes)
    assert path.read_bytes() == kept
    assert notes.read_text() == "mine"


def test_model_with_another_text_is_another_simulator(of_mujoco, tmp_path):
    diagnosis, log = of_mujoco
    path = tmp_path / "fit.skat"
    settings = {"effects": diagnosis.effects, "random_state": 0}
    interrupted(SimulationDiagnosis(diagnosis.simulator, **settings), log, path, "search", 0)
    same_physics = MujocoSimulator(
        pendulum.NOMINAL.replace("<mujoco>", "<mujoco model='arm'>"),
        frame_skip=pendulum.FRAME_SKIP,
        built_in=diagnosis.simulator.built_in,
    )
    with pytest.raises(ValueError, match="its model has another text"):
        SimulationDiagnosis(same_physics, **settings).fit(*log, resume=path)


def test_interruption_while_a_file_is_written_leaves_the_one_before(of_function, begun, monkeypatch):
    reference, log = of_function
    kept = begun.read_bytes()

    def stop(*_, **__):
        raise KeyboardInterrupt

    diagnosis = a_diagnosis()
    with monkeypatch.context() as patched:
        patched.setattr(np.lib.format, "write_array", stop)
        with pytest.raises(KeyboardInterrupt):
            diagnosis.fit(*log, resume=begun)
    assert begun.read_bytes() == kept
    assert list(begun.parent.iterdir()) == [begun]
    assert_same_answers(diagnosis.fit(*log, resume=begun), reference, log)
