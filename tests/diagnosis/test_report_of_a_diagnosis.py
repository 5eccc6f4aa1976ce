import copy
import pickle
import re
import warnings
from functools import cache
from types import SimpleNamespace

import matplotlib
import numpy as np
import pandas as pd
import pytest
from matplotlib import pyplot

from skat.diagnosis import Cause, Gain, SimulationDiagnosis
from skat.diagnosis.chains import NO_MEMORY, Memory
from skat.diagnosis.comparison import EXTENDED, NOMINAL
from skat.diagnosis.findings import Alias
from skat.diagnosis.prediction import Overlay
from skat.diagnosis.report.from_diagnosis import _beside, _by_error, _rows, _with_breaks
from skat.diagnosis.report.machine import findings_as_data
from skat.diagnosis.report.sentences import (
    capital,
    cause_sentence,
    cautions,
    gain_sentence,
    left_sentence,
    verdict_sentences,
)
from skat.effects import Effect
from skat.simulators import FunctionSimulator
from tests.diagnosis.pages import Page


def swing(X, damping=0.0, pull=0.0):
    """A driven pendulum, damped, and pulled by something that depends on where it is."""
    force = X[:, 2] - np.sin(X[:, 0]) - damping * X[:, 1] + pull * np.cos(3 * X[:, 0])
    rate = X[:, 1] + 0.05 * force
    return np.stack([X[:, 0] + 0.05 * rate, rate], axis=1)


def blow_up(X, damping=0.0):
    return np.where(np.abs(X[:, :1]) > 1.9, np.nan, swing(X, damping))


def throw(Z, drag):
    reach = (3 + np.tanh(Z[:, 0])) ** 2 * np.sin(1.4 + 0.8 * np.tanh(Z[:, 1])) / 9.81
    return np.stack([reach / (1 + drag * reach), reach - drag], axis=1)


def pendulum(function=swing, angle="angle", dt=None):
    return FunctionSimulator(
        function,
        input_names=(angle, "rate", "push"),
        output_names=(angle, "rate"),
        state_names=(angle, "rate"),
        effects=(Effect("damping", unit="1/s", neutral=0.0, bounds=(0.0, 5.0)),),
        units={angle: "rad", "rate": "rad/s"},
        dt=dt,
    )


def thrower():
    drag = Effect("drag", unit="1", neutral=0.0, bounds=(-0.2, 5.0))
    return FunctionSimulator(throw, input_names=("z0", "z1"), output_names=("a", "b"), effects=(drag,))


def pendulum_log(n_episodes=8, seed=0, damping=0.6, n_steps=30, **world):
    rng = np.random.default_rng(seed)
    states = [np.column_stack([rng.uniform(-2, 2, n_episodes), rng.normal(size=n_episodes)])]
    pushes = rng.normal(size=(n_episodes, n_steps))
    for step in range(n_steps):
        states.append(swing(np.column_stack([states[-1], pushes[:, step]]), damping, **world))
    states = np.stack(states, axis=1)
    states += 0.01 * rng.normal(size=states.shape)
    X = np.concatenate([states[:, :-1], pushes[:, :, None]], axis=2).reshape(-1, 3)
    return X, states[:, 1:].reshape(-1, 2), np.repeat(np.arange(n_episodes), n_steps)


def thrown_log(drag=0.5, seed=0):
    rng = np.random.default_rng(seed)
    Z = rng.normal(size=(80, 2))
    return Z, throw(Z, drag) + 0.01 * rng.normal(size=Z.shape), None


@cache
def fitted(case="damped"):
    """Return a diagnosis that tests must not change."""
    logs = {
        "damped": pendulum_log,
        "right": lambda: pendulum_log(damping=0.0),
        "pulled": lambda: pendulum_log(20, damping=0.0, pull=2.0),
        "hidden": pendulum_log,
        "alone": pendulum_log,
        "independent": lambda: (*(part[::2] for part in pendulum_log()[:2]), None),
        "thrown": thrown_log,
    }
    simulator = thrower() if case == "thrown" else pendulum(dt=0.05 if case == "pulled" else None)
    more = {"hidden": {"hidden": ("rate",)}, "alone": {"test_size": 0}}.get(case, {})
    effects = "all" if case == "thrown" else ["damping"]
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", UserWarning)
        return SimulationDiagnosis(simulator, effects=effects, random_state=0, **more).fit(*logs[case]())


def changed(**findings):
    """Return the diagnosis with some of what it found set by hand."""
    diagnosis = copy.copy(fitted())
    for name, value in findings.items():
        setattr(diagnosis, name, value)
    return diagnosis


def report_of(case="damped"):
    return copy.deepcopy(fitted(case).report_)


def plots_of(report):
    return Page(report.html()).plots


# -- words ---------------------------------------------------------------------------------------------------


def test_a_cause_is_said_with_interval_and_probability_in_text_and_page():
    diagnosis, report = fitted(), report_of()
    (cause,) = diagnosis.causes_
    assert cause.interval[0] < 0.6 < cause.interval[1]
    sentence = cause_sentence(cause)
    assert f"(95 %: {cause.interval[0]:.4g} to {cause.interval[1]:.4g})" in sentence
    assert report.text().startswith("Verdict: named (probability ")
    text = Page(report.html(figures=False)).text
    for said in (report.text(), text):
        assert sentence in said
    assert "1 cause named" in text
    assert "> 1000 nats" in text


@pytest.mark.parametrize(
    ("value", "interval", "text"),
    [
        (
            1.050045,
            (1.050032, 1.050058),
            "the radius is 1.05 (1.050045; 95 %: 1.050032 to 1.050058).",
        ),
        (1.0502, (1.03, 1.07), "the radius is 1.05 (95 %: 1.03 to 1.07)."),
        (0.6, (0.6, 0.6), "the radius is 0.6 (95 %: 0.6 to 0.6)."),
    ],
)
def test_sentence_adds_the_size_where_rounding_puts_it_outside_its_interval(value, interval, text):
    cause = Cause(
        "radius[wheel]", "radius", "wheel", value, interval, "1", 0.99, 9.0, (), f"the radius is {value:.3g}"
    )
    assert cause_sentence(cause) == capital(text)


def test_rows_in_groups_are_said_to_be_so_and_compared_by_group():
    X, y, _ = thrown_log()
    diagnosis = SimulationDiagnosis(thrower(), random_state=0).fit(X, y, np.arange(len(X)) // 10)
    report = diagnosis.report_
    assert f"in {report.log.n_episodes} groups" in Page(report.html(figures=False)).text
    _, _, groups = _rows(report.log)
    assert len(np.unique(groups)) == report.log.n_episodes < len(report.log)


def test_nothing_detected_is_said_with_what_would_have_been_seen():
    report = report_of("right")
    assert "Verdict: nothing detected (probability " in report.text()
    assert "no difference from the simulation" in report.text()
    assert "goes from" not in report.text()
    text = Page(report.html(figures=False)).text
    assert "1 of 1 effects would have been named" in text


def test_aliases_are_told_with_their_probabilities():
    (cause,) = fitted().causes_
    alias = vars(cause) | {"aliases": (Alias("drag", 0.3), Alias("lag", 0.002))}
    diagnosis = changed(causes_=[Cause(**alias)], verdict_="ambiguous")
    told = " ".join(verdict_sentences(diagnosis, []))
    assert "cannot tell damping from drag (30 %) and lag (< 1 %): put in its place, each of them" in told


def test_other_sets_of_causes_are_told_with_the_verdict():
    one, *_ = fitted().posterior_.sets
    other = SimpleNamespace(names=(), probability=0.2, values={})
    posterior = SimpleNamespace(sets=(SimpleNamespace(**vars(one) | {"probability": 0.8}), other))
    diagnosis = changed(posterior_=posterior)
    text = Page(type(diagnosis.report_)(diagnosis, diagnosis.report_.log).html(figures=False)).text
    assert "Probability of this set of causes: 80 %; of others: no cause (20 %)." in text


def test_an_unexplained_verdict_says_what_is_left_and_draws_it():
    diagnosis, report = fitted("pulled"), report_of("pulled")
    assert diagnosis.verdict_ == "unexplained"
    assert "What is left at rate depends on" in report.text()
    assert "that no cause explains" in report.text()
    assert "probability" not in report.text()
    page = Page(report.html())
    laws = [plot for plot in page.plots if plot["across"] == "angle (rad)"]
    assert laws
    assert "What is left" in page.text
    assert "on data not used" in page.text


def test_a_law_that_is_left_is_told_however_little_it_is():
    """Such as the square of the friction that was named in proportion to the speed."""
    pulled = SimpleNamespace(**vars(fitted("pulled")) | {"verdict_": "named"})
    (told,) = verdict_sentences(pulled, [])
    assert told.startswith("Less than the tolerance of 10 %, but no chance: what is left at rate depends on")
    right = verdict_sentences(fitted("right"), [])
    assert not any("but no chance" in sentence for sentence in right)


def test_a_law_drawn_is_that_of_the_remainder_and_has_the_shape_of_what_acts():
    part = next(one for one in report_of("pulled").content.left if one.name == "rate")
    found = next(one for one in fitted("pulled").remainder_.parts if one.name == "rate").law
    assert (part.law.regressor, part.law.unit) == ("angle", "rad")
    np.testing.assert_array_equal(part.law.mean, found.mean)
    np.testing.assert_allclose(part.law.x, (found.edges[1:] + found.edges[:-1]) / 2)
    assert np.corrcoef(part.law.mean, np.cos(3 * part.law.x))[0, 1] > 0.9
    assert (part.law.low < part.law.mean).all()
    assert (part.law.mean < part.law.high).all()


def test_where_nothing_is_left_no_law_is_drawn():
    content = report_of("right").content
    assert all(one.law is None and one.predictable is None and not one.sentence for one in content.left)
    assert content.left_sentences == ("What is left follows no law that this log shows.",)


@pytest.mark.parametrize(
    ("regressor", "said"),
    [
        (
            "qvel.elbow",
            "what is left at elbow depends on qvel.elbow, which predicts 0.3 N m (rms), 6 % of what",
        ),
        ("constant", "at elbow 0.3 N m (rms), 6 % of what acts there, are left at all times, which no cause"),
    ],
)
def test_what_is_left_is_said_in_its_own_terms(regressor, said):
    part = SimpleNamespace(name="elbow", unit="N m", predictable=0.3, scale=5.0, regressor=regressor)
    assert left_sentence(part).startswith(said)


def test_where_rows_only_diverge_the_verdict_says_so():
    diagnosis = changed(verdict_="unexplained", causes_=[], diverged_share_=0.25)
    told = verdict_sentences(diagnosis, [])
    assert told == ["The simulation diverges in 25 % of the rows, which tell nothing."]


def test_where_the_search_did_not_come_to_rest_the_verdict_says_so():
    diagnosis = changed(verdict_="unexplained", causes_=[], settled_=False)
    told = verdict_sentences(diagnosis, [])
    assert told == [
        "The search for causes had not come to rest: its turns were over, or fits and slopes differ."
    ]


@pytest.mark.parametrize(
    ("gain", "expected"),
    [
        (
            Gain(5.9, 1.02, 1.0, 0.996, (0.98, 1.01), 10.0),
            "the squared error 10 rows ahead goes from 5.9 to 1.02 times what a right model has; 100 % of the",
        ),
        (Gain(1.1, 1.0, 1.0, 0.9, (-1.0, 3.0)), "too close to the noise to say which share"),
        (Gain(1.1, 1.0, 1.0, 0.9, (-np.inf, np.inf)), "too close to the noise to say which share"),
        (
            Gain(2.8, 2.5, 1.0, 0.2, (-np.inf, np.inf)),
            "20 % of the excess is explained, in too few rows to bound",
        ),
        (
            Gain(0.024, 0.0065, 0.0073, 1.05, (0.92, 2.7), "episode"),
            "from 0.024 to 0.0065; 105 % of the excess is explained, in too few episodes to bound the share.",
        ),
        (Gain(0.9, 0.88, 1.0, 0.0, (-np.inf, np.inf)), "so that there is no excess to explain"),
        (
            Gain(2.6, 0.1, 0.05, 0.98, (0.9, 0.99), "episode"),
            "open-loop error of whole episodes goes from 2.6 to",
        ),
        (
            Gain(2.6, 0.1, 0.05, 0.98, (np.nan, np.nan), "episode"),
            "98 % of the excess is explained, in too few episodes for an interval.",
        ),
    ],
)
def test_a_gain_is_said_in_its_own_terms(gain, expected):
    assert expected in gain_sentence(fitted(), gain)


@pytest.mark.parametrize(("nominal", "explained"), [(0.963, 0.0), (1.172, 3.9)])
def test_no_share_is_said_where_the_noise_estimate_contains_what_is_unexplained(nominal, explained):
    gain = Gain(nominal, 0.452, 1.0, explained, (-np.inf, np.inf), 0.5)
    sentence = gain_sentence(fitted("pulled"), gain)
    assert f"0.5 s ahead goes from {nominal:.3g} to 0.452" in sentence
    assert "the noise estimate itself contains what is unexplained" in sentence
    assert "%" not in sentence
    only_diverges = changed(verdict_="unexplained", causes_=[], diverged_share_=0.25)
    for diagnosis in (fitted(), only_diverges):
        assert "the noise estimate" not in gain_sentence(diagnosis, gain)


@pytest.mark.parametrize("n_causes", [3, 4])
def test_a_caution_is_said_where_so_many_causes_stand_together(n_causes):
    told = " ".join(verdict_sentences(changed(causes_=fitted().causes_ * n_causes), []))
    assert told.count("So many causes together may stand for one that is not in the list.") == (n_causes > 3)


@pytest.mark.parametrize(
    ("names", "said"),
    [
        (["mass[arm]"], []),
        (["bias[angle]", "scale[rate]"], []),
        (["mass[arm]", "bias[angle]"], ["bias[angle] beside another cause"]),
        (["delay[action]"], ["A filter that delays the velocities measured, and motors that answer slowly"]),
    ],
)
def test_what_a_cause_may_stand_for_is_said(names, said):
    causes = [SimpleNamespace(name=name, family=name.partition("[")[0]) for name in names]
    found = cautions(causes)
    assert len(found) == len(said)
    assert all(text.startswith(start) for text, start in zip(found, said))


def test_repr_is_the_text_and_a_notebook_shows_the_page_without_pictures():
    report = report_of()
    assert repr(report) == report.text()
    assert report._repr_html_() == report.html(figures=False)
    assert "img" not in Page(report.html(figures=False)).tags


# -- numbers -------------------------------------------------------------------------------------------------


def test_noise_and_random_forces_are_those_of_the_fit():
    diagnosis, content = fitted("hidden"), report_of("hidden").content
    assert [(one.name, one.unit) for one in content.noise] == [("angle", "rad")]
    assert content.noise[0].deviation == diagnosis.noise_[0]
    assert {one.name: one.rms for one in content.forces} == {
        one.name: one.rms for one in diagnosis.remainder_.parts
    }
    assert report_of("thrown").content.forces == ()


@pytest.mark.parametrize("returns", [False, True])
def test_a_force_with_memory_is_told_with_its_time_constant(returns):
    diagnosis = copy.copy(fitted("pulled"))
    found, parts = diagnosis._found, diagnosis.remainder_.parts
    share = np.exp(-1 / 4)
    most = (1 - share) / 2 if returns else share**2
    estimate = SimpleNamespace(**vars(found.fitted) | {"memory": Memory(len(parts), share, returns)})
    diagnosis._found = SimpleNamespace(**vars(found) | {"fitted": estimate})
    pasts = (0.9 * most, 0.1 * most)
    parts = tuple(SimpleNamespace(**vars(one) | {"past": past}) for one, past in zip(parts, pasts))
    for one in parts:
        one.share = 0.0
    diagnosis.remainder_ = SimpleNamespace(**vars(diagnosis.remainder_) | {"parts": parts, "evidence": 99.0})
    forces = type(diagnosis.report_)(diagnosis, diagnosis.report_.log).content.forces
    assert [one.memory_s for one in forces] == [pytest.approx(4 * 0.05), 0.0]
    assert [one.returns for one in forces] == [returns, False]


@pytest.mark.parametrize("lasting", [False, True])
def test_of_each_random_force_the_one_that_goes_most_with_it_is_told(lasting):
    """What pushes the first joint pushes the third half as much, the other way; the second one is pushed alone."""
    mixing = np.array([[[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [-0.5, 0.0, 1.0]]])
    white, memory = [4.0, 1.0, 3.0], NO_MEMORY
    if lasting:
        # Half of a lasting force's variance is of pushes that come to 1 / (1 - 1 / 4) of it.
        white, memory = [2.0, 0.5, 1.5, 1.5, 0.375, 1.125], Memory(3, 0.5)
    noise = SimpleNamespace(force=np.array([white]), force_nu=np.full((1, len(white)), np.inf), mixing=mixing)
    joints = [(SimpleNamespace(target=name, name=""), ()) for name in ("hip", "knee", "ankle")]
    diagnosis = SimpleNamespace(
        simulator=SimpleNamespace(joint_forces=lambda: joints),
        _found=SimpleNamespace(fitted=SimpleNamespace(estimate=SimpleNamespace(noise=noise), memory=memory)),
    )
    found = _beside(diagnosis)
    # The third's variance is 4 / 4 + 3.
    assert found["hip"] == ("ankle", pytest.approx(-2 / np.sqrt(4 * 4)))
    assert found["ankle"] == ("hip", pytest.approx(-0.5))
    assert "knee" not in found
    noise.mixing = None
    assert _beside(diagnosis) == {}


def test_findings_as_data_hold_probabilities_aliases_and_what_is_left():
    found = findings_as_data(fitted("pulled"))
    assert found["schema"] == 2
    assert sum(one["probability"] for one in found["sets"]) == pytest.approx(1)
    assert [one["name"] for one in found["remainder"]] == [
        one.name for one in fitted("pulled").remainder_.parts
    ]
    assert found["remainder"][0]["law"]["coordinate"]
    (cause,) = findings_as_data(fitted())["causes"]
    assert 0.5 < cause["probability"] <= 1
    assert set(findings_as_data(fitted("hidden"))["noise"]) == {"angle"}


def test_what_is_also_seen_has_a_value_and_an_interval_around_it():
    diagnosis = copy.copy(fitted())
    diagnosis._found = SimpleNamespace(**vars(diagnosis._found) | {"values": {}})
    diagnosis.causes_, diagnosis.also_seen_ = [], {"damping": 0.6}
    report = type(diagnosis.report_)(diagnosis, diagnosis.report_.log)
    (one,) = report.content.also_seen
    assert "Also seen" in report.html(figures=False)
    assert one.interval[0] < 0.6 < one.interval[1]
    np.testing.assert_allclose(one.interval, fitted().causes_[0].interval, rtol=0.05)


# -- the page ------------------------------------------------------------------------------------------------


def test_the_page_is_one_file_of_matching_tags(tmp_path):
    path = report_of().to_html(tmp_path / "report.html")
    html = path.read_text(encoding="utf-8")
    assert html.startswith("<!DOCTYPE html>")
    page = Page(html)
    assert len(page.plots) >= 3
    assert not re.search(r"https?://|@import|url\(", html)
    assert all(source.startswith(("#", "data:")) for source in page.sources)


def test_a_simulation_with_a_state_is_shown_at_the_horizon_before_and_after():
    report = report_of()
    plots = plots_of(report)
    signals = [plot for plot in plots if plot["across"] == "step"]
    assert {plot["up"] for plot in signals} == {"angle (rad)", "rate (rad/s)"}
    assert all(plot["roles"] == ["line measured", "line before", "line after"] for plot in signals)
    assert "simulated anew every 10 rows from what was measured until then" in Page(report.html()).text


def test_predictions_break_where_they_begin_anew_and_what_was_measured_does_not():
    time = np.arange(1.0, 7.0)
    rows = np.arange(6.0)[:, None]
    overlay = Overlay(0, time, ("x",), rows, 10 + rows, 20 + rows, 2)
    time, measured, nominal, extended = _with_breaks(overlay)
    np.testing.assert_array_equal(time, [1, 2, 2, 3, 4, 4, 5, 6])
    np.testing.assert_array_equal(measured[:, 0], [0, 1, 1, 2, 3, 3, 4, 5])
    np.testing.assert_array_equal(nominal[:, 0], [10, 11, np.nan, 12, 13, np.nan, 14, 15])
    np.testing.assert_array_equal(extended, nominal + 10)
    single = Overlay(0, time[:1], ("x",), rows[:1], rows[:1], rows[:1], 1)
    assert all(len(part) == 1 for part in _with_breaks(single))


def test_channels_stand_by_their_error_and_those_never_measured_are_left_out():
    measured = np.array([[0.0, 0.0, np.nan], [1.0, 1.0, np.nan], [0.0, 0.0, np.nan]])
    nominal = np.array([[0.1, 0.5, 0.0], [1.1, 0.2, 0.0], [0.1, np.nan, 0.0]])
    assert _by_error(measured, nominal) == [1, 0]


def test_a_one_shot_simulation_is_shown_measured_against_simulated():
    clouds = {plot["up"]: plot for plot in plots_of(report_of("thrown")) if plot["up"].startswith("measured")}
    assert set(clouds) == {"measured a", "measured b"}
    assert clouds["measured a"]["across"] == "simulated a"
    assert clouds["measured a"]["roles"] == ["line zero", "dots before", "dots after"]


def test_independent_rows_are_shown_by_their_changes_of_state():
    labels = {(plot["up"], plot["across"]) for plot in plots_of(report_of("independent"))}
    assert ("measured change of rate (rad/s)", "simulated change of rate (rad/s)") in labels


def test_where_a_channel_is_hidden_only_measured_ones_are_shown():
    report = report_of("hidden")
    signals = [plot["up"] for plot in plots_of(report) if plot["across"] == "step"]
    assert set(signals) == {"angle (rad)"}
    assert "Not measured rate" in Page(report.html(figures=False)).text


def test_errors_are_measured_on_rows_held_out_by_every_method():
    text = Page(report_of().html()).text
    for method in (
        NOMINAL,
        EXTENDED,
        "AffineTransport",
        "ProcrustesAffineTransport",
        "CORAL",
        "ExactTransport",
    ):
        assert method in text
    assert "open-loop error of whole episodes" in text


def test_without_rows_held_out_the_page_says_that_no_gain_is_measured():
    text = Page(report_of("alone").html()).text
    assert "No rows were held out" in text
    assert "Error by method" not in text
    assert "goes from" not in text


def test_a_simulation_that_diverges_is_shown_as_far_as_it_goes():
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", UserWarning)
        diagnosis = SimulationDiagnosis(pendulum(blow_up), effects=["damping"], random_state=0)
        html = diagnosis.fit(*pendulum_log()).report_.html()
    assert len(Page(html).plots) >= 2
    assert "rows left out, in which a simulation diverges" in Page(html).text


def test_names_are_escaped_in_page_and_pictures():
    evil = "<script>alert('x')</script>&"
    diagnosis = SimulationDiagnosis(pendulum(angle=evil), effects=["damping"], random_state=0)
    report = diagnosis.fit(*pendulum_log()).report_
    report.add_table(evil, pd.DataFrame({evil: [evil]}))
    html = report.html()
    assert "<script" not in html
    assert "script" not in Page(html).tags
    assert evil in Page(html).text
    assert f"{evil} (rad)" in [plot["up"] for plot in Page(html).plots]


# -- what can be added ---------------------------------------------------------------------------------------


def test_a_table_is_added_with_its_index_numbers_and_gaps():
    report = report_of()
    frame = pd.DataFrame(
        {"error": [0.123456789, np.nan], "right": [True, False]}, index=pd.Index(["one", "two"], name="ball")
    )
    report.add_table("All balls", frame)
    frame.loc["one", "error"] = 99.0
    html = report.html(figures=False)
    text = Page(html).text
    assert "All balls ball error right one 0.1235 yes two no" in text
    assert "one 99" not in text


def test_a_long_table_is_folded_away():
    report = report_of()
    report.add_table("Long", pd.DataFrame({"n": range(100)}))
    assert "<summary>100 rows</summary>" in report.html(figures=False)


def test_what_is_no_table_is_refused():
    with pytest.raises(TypeError, match="frame must be a pandas DataFrame; it is a list"):
        report_of().add_table("Numbers", [1, 2])


def test_another_log_is_shown_instead_of_the_rows_fitted():
    report = report_of("alone")
    errors = pd.DataFrame(
        {"method": [NOMINAL, "mine", EXTENDED], "error": [0.3, 0.1, 0.2], "ratio": [1.5, 0.5, 1.0]}
        | {
            "ratio_low": [1.4, 0.4, 1.0],
            "ratio_high": [1.6, 0.6, 1.0],
            "n_rows": [0, 9, 0],
            "note": ["", "", ""],
        }
    )
    gain = Gain(2.5, 0.25, 0.1, 0.94, (0.9, 0.97), "episode", {"angle": (2.5, 0.25)})
    report.add_test("Drop 2", *pendulum_log(seed=1), gain=gain, errors=errors)
    text = Page(report.html(figures=False)).text
    assert "Drop 2" in text
    assert "goes from 2.5 to 0.25; 94 % of the excess is explained (95 %: 90 to 97 %)" in text
    assert text.count("mine beats the extended simulation on data not used: 0.5 times its error") == 2
    assert "No rows were held out" not in text
    assert (
        "Drop 2: With the causes built in, the open-loop error of whole episodes goes from 2.5 to 0.25"
        in report.text()
    )


def test_another_log_is_measured_at_the_horizon_by_default():
    report = report_of("alone")
    report.add_test("Monday", *pendulum_log(seed=1))
    assert "Monday: With the causes built in, the squared error 10 rows ahead goes from" in report.text()
    assert plots_of(report)


# -- files and objects ---------------------------------------------------------------------------------------


def test_a_file_that_exists_is_kept_unless_forced(tmp_path):
    path = tmp_path / "report.html"
    path.write_text("mine")
    report = report_of("alone")
    with pytest.raises(FileExistsError, match=r"report.html exists\. Choose another name, or .*force=True"):
        report.to_html(path)
    assert path.read_text() == "mine"
    assert report.to_html(str(path), force=True) == path
    assert "Measured and simulated" in path.read_text()


def test_folders_are_refused_as_files_and_missing_ones_named(tmp_path):
    with pytest.raises(FileExistsError, match="is a folder; expected the name of a file"):
        report_of().to_html(tmp_path, force=True)
    with pytest.raises(FileNotFoundError, match=r"There is no folder .*nowhere"):
        report_of().to_html(tmp_path / "nowhere" / "report.html")


def test_a_report_pickles_and_copies_and_shows_the_same():
    diagnosis = SimulationDiagnosis(thrower(), random_state=0).fit(*thrown_log())
    report = diagnosis.report_
    report.add_table("More", pd.DataFrame({"n": [1]}))
    html = report.html()
    assert report.html() == html
    for twin in (pickle.loads(pickle.dumps(report)), copy.deepcopy(report)):
        assert twin.html() == html
    assert b"matplotlib" not in pickle.dumps(report)


def test_drawing_leaves_no_trace_in_pyplot():
    before = dict(matplotlib.rcParams), pyplot.get_fignums()
    report_of().html()
    assert (dict(matplotlib.rcParams), pyplot.get_fignums()) == before


def test_a_report_stays_as_it_is_when_the_diagnosis_is_fitted_again():
    diagnosis = SimulationDiagnosis(thrower(), random_state=0).fit(*thrown_log())
    report = diagnosis.report_
    first = report.html()
    assert "drag is 0.5" in report.text() or "drag is 0.49" in report.text()
    diagnosis.fit(*thrown_log(drag=0.0, seed=1))
    assert report.html() == first
    assert diagnosis.report_.text() != report.text()


def test_a_fitted_diagnosis_shows_itself():
    diagnosis = fitted()
    assert repr(diagnosis).endswith(diagnosis.report_.text())
    assert diagnosis._repr_html_() == diagnosis.report_.html(figures=False)
    assert "Rows held out" in diagnosis.report_.text()
