import copy
import pickle
import re
import runpy
import warnings
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import matplotlib
import numpy as np
import pandas as pd
import pytest
from matplotlib import pyplot

from skat.diagnosis import Cause, Gain, SimulationDiagnosis
from skat.diagnosis.comparison import EXTENDED, NOMINAL
from skat.diagnosis.log import check_log
from skat.diagnosis.omnibus import Remainder
from skat.diagnosis.report.from_first_engine import FirstReport as Report
from skat.diagnosis.report.from_first_engine import _rows, worst_and_typical
from skat.diagnosis.report.sentences import (
    capital,
    cause_sentence,
    cautions,
    gain_sentence,
    verdict_sentences,
)
from skat.effects import Effect
from skat.simulators import FunctionSimulator
from tests.diagnosis.pages import Page

EXAMPLE = Path(__file__).parents[2] / "examples" / "plot_diagnosis.py"


def swing(X, **values):
    """A driven pendulum, whatever its effects and channels are called."""
    damping = next(iter(values.values()))
    rate = X[:, 1] + 0.05 * (X[:, 2] - np.sin(X[:, 0]) - damping * X[:, 1])
    return np.stack([X[:, 0] + 0.05 * rate, rate], axis=1)


def blow_up(X, **values):
    return np.where(np.abs(X[:, :1]) > 1.0, np.nan, swing(X, **values))


def throw(Z, drag):
    reach = (3 + np.tanh(Z[:, 0])) ** 2 * np.sin(1.4 + 0.8 * np.tanh(Z[:, 1])) / 9.81
    return np.stack([reach / (1 + drag * reach), reach - drag], axis=1)


def pendulum(function=swing, angle="angle", effect="damping[hinge]", units=None):
    return FunctionSimulator(
        function,
        units=units,
        input_names=(angle, "rate", "push"),
        output_names=(angle, "rate"),
        state_names=(angle, "rate"),
        effects=(Effect(effect, unit="1/s", neutral=0.0, bounds=(0.0, 5.0)),),
    )


def thrower():
    drag = Effect("drag", unit="1", neutral=0.0, bounds=(-0.2, 5.0))
    return FunctionSimulator(throw, input_names=("z0", "z1"), output_names=("a", "b"), effects=(drag,))


def pendulum_log(n_episodes=6, seed=0, damping=0.6, n_steps=30):
    rng = np.random.default_rng(seed)
    states = [np.column_stack([rng.uniform(-2, 2, n_episodes), rng.normal(size=n_episodes)])]
    pushes = rng.normal(size=(n_episodes, n_steps))
    for step in range(n_steps):
        states.append(swing(np.column_stack([states[-1], pushes[:, step]]), damping=damping))
    states = np.stack(states, axis=1)
    states += 0.01 * rng.normal(size=states.shape)
    X = np.concatenate([states[:, :-1], pushes[:, :, None]], axis=2).reshape(-1, 3)
    return X, states[:, 1:].reshape(-1, 2), np.repeat(np.arange(n_episodes), n_steps)


def cause_of(simulator, value, aliases=()):
    effect = next(iter(simulator.effects()))
    return Cause(
        name=effect.name,
        family=effect.family,
        target=effect.target,
        value=value,
        interval=(value - 0.0125, value + 0.0125),
        unit=effect.unit,
        p_value=1e-9,
        aliases=aliases,
        sentence=effect.describe(value),
    )


def diagnosed(simulator, *, value=0.6, verdict="named", aliases=(), hidden=()):
    """Return a diagnosis as fit would leave it, of what is given."""
    diagnosis = SimulationDiagnosis(simulator, hidden=hidden)
    diagnosis.verdict_ = verdict
    diagnosis.causes_ = [] if value is None else [cause_of(simulator, value, aliases)]
    diagnosis._values = {cause.name: cause.value for cause in diagnosis.causes_}
    diagnosis.extended_simulator_ = simulator.extended(diagnosis._values)
    diagnosis.noise_ = np.full(len(simulator.residual_names) - len(hidden), 0.01)
    diagnosis.remainder_ = Remainder(1e-6, "rate", "angle", (("rate", "angle", 1e-7), ("angle", "rate", 0.2)))
    diagnosis.refused_ = None
    diagnosis.gain_ = None
    if value is not None:
        diagnosis.gain_ = Gain(5.91, 1.02, 1.0, 0.996, (0.98, 1.01), 1, {"rate": (0.05, 0.01)})
    names = [effect.name for effect in simulator.effects()]
    diagnosis.identifiability_ = pd.DataFrame(
        {
            "smallest": [0.02] + [np.inf] * (len(names) - 1),
            "unit": [effect.unit for effect in simulator.effects()],
            "nearest_alias": "",
            "similarity": 0.25,
        },
        index=pd.Index(names, name="effect"),
    )
    return diagnosis


def reported(simulator=None, log=None, held_out=True, **findings):
    simulator = pendulum() if simulator is None else simulator
    diagnosis = diagnosed(simulator, **findings)
    X, y, groups = pendulum_log() if log is None else log
    log = check_log(simulator, X, y, groups, hidden=diagnosis.hidden)
    parts = log.split(0.4, np.random.RandomState(0)) if held_out else (log,)
    diagnosis.report_ = Report(diagnosis, *parts)
    return diagnosis.report_


def thrown_log(drag=0.5, seed=0):
    rng = np.random.default_rng(seed)
    Z = rng.normal(size=(80, 2))
    return Z, throw(Z, drag) + 0.01 * rng.normal(size=Z.shape), None


def plots_of(report):
    """Return the labels and lines of each plot of a page, and which of them are signals."""
    return Page(report.html()).plots


# -- words ---------------------------------------------------------------------------------------------------


def test_a_cause_is_said_with_its_interval_in_text_and_page():
    report = reported()
    sentence = "Viscous damping of hinge is 0.6 1/s more than the model's (95 %: 0.5875 to 0.6125)."
    assert sentence in report.text()
    text = Page(report.html(figures=False)).text
    assert sentence in text
    assert "1 cause named" in text


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
        "radius[wheel]", "radius", "wheel", value, interval, "1", 0.0, (), f"the radius is {value:.3g}"
    )
    assert cause_sentence(cause) == capital(text)


def test_rows_in_groups_are_said_to_be_so_and_compared_by_group():
    X, y, _ = thrown_log()
    report = reported(thrower(), (X, y, np.arange(len(X)) // 10))
    assert f"in {report.log.n_episodes} groups" in Page(report.html(figures=False)).text
    _, _, groups = _rows(report.log)
    assert len(np.unique(groups)) == report.log.n_episodes < len(report.log)


def test_where_channels_were_not_measured_no_more_is_claimed_than_was_tested():
    log = pendulum_log()
    for array in log[:2]:
        array[:, 1] = 0.0
    for findings in ({"value": None, "verdict": "nothing detected"}, {}):
        text = Page(reported(log=log, hidden=("rate",), held_out=False, **findings).html(figures=False)).text
        assert "what it depends on was not tested" in text
        assert "no difference from the simulation" not in text


def test_a_sentence_begins_with_a_capital_unless_it_begins_with_the_name_of_an_effect():
    assert "\n  drag is 0.5 (95 %" in reported(thrower(), thrown_log(), value=0.5).text()
    report = reported()
    report.diagnosis.causes_ = [replace(report.diagnosis.causes_[0], sentence="a constant force is 2 N")]
    assert "\n  A constant force is 2 N (95 %" in report.text()


def test_nothing_detected_is_said_with_what_would_have_shown():
    report = reported(value=None, verdict="nothing detected")
    assert report.text() == "Verdict: nothing detected"
    text = Page(report.html(figures=False)).text
    assert "Nothing detected" in text
    assert "no difference from the simulation that noise would not explain" in text
    assert "1 of 5 effects would have been named" in text
    assert "says nothing: bias[angle], bias[rate], scale[angle], scale[rate]" in text


def test_an_ambiguous_verdict_names_what_cannot_be_told_apart():
    report = reported(verdict="ambiguous", aliases=("scale[rate]", "bias[rate]"))
    assert "cannot be told from: scale[rate], bias[rate]" in report.text()
    text = Page(report.html(figures=False)).text
    assert (
        "cannot tell damping[hinge] from scale[rate] and bias[rate]: put in its place, each of them" in text
    )


def test_errors_without_a_shape_are_said_to_have_none():
    simulator = pendulum()
    diagnosis = diagnosed(simulator, value=None, verdict="unexplained")
    diagnosis.remainder_ = Remainder(0.4, "rate", "angle", (("rate", "angle", 0.02),))
    diagnosis.excess_p_value_, diagnosis.diverged_share_ = 1e-6, 0.0
    X, y, groups = pendulum_log()
    log = check_log(simulator, X, y, groups)
    report = Report(diagnosis, *log.split(0.4, np.random.RandomState(0)))
    assert "larger than the noise explains" in report.text()
    assert "something acts on" not in report.text()
    assert "What is left" not in report.html(figures=False)
    diagnosis.excess_p_value_, diagnosis.diverged_share_ = 1.0, 0.25
    report = Report(diagnosis, *log.split(0.4, np.random.RandomState(0)))
    assert "The simulation diverges in 25 % of the rows, which tell nothing." in report.text()


def test_an_unexplained_verdict_says_what_is_left_and_how_far_a_transport_comes():
    report = reported(value=None, verdict="unexplained")
    assert "Something acts on rate that depends on angle, and no effect known explains it." in report.text()
    text = Page(report.html()).text
    assert "Something acts on rate that depends on angle" in text
    assert text.count("on data not used") >= 2  # in the verdict, and under the table of errors
    assert "What is left" in text


def test_what_was_significant_but_refused_is_told_beside_what_is_left():
    diagnosis = diagnosed(pendulum(), value=None, verdict="unexplained")
    effect = pendulum().effects()[0]
    diagnosis.refused_ = (effect.name, 0.2718)
    told = verdict_sentences(diagnosis, [])[1]
    assert told.startswith(
        f"{effect.name} = 0.272 {effect.unit} would explain a part of it, but is not named"
    )


@pytest.mark.parametrize(
    ("gain", "expected"),
    [
        (
            Gain(5.9, 1.02, 1.0, 0.996, (0.98, 1.01)),
            "from 5.9 to 1.02 times what noise alone gives; 100 % of the",
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
    assert expected in gain_sentence(diagnosed(pendulum()), gain)


@pytest.mark.parametrize(("nominal", "explained"), [(0.963, 0.0), (1.172, 3.9)])
def test_no_share_is_said_where_the_noise_estimate_contains_what_is_unexplained(nominal, explained):
    gain = Gain(nominal, 0.452, 1.0, explained, (-np.inf, np.inf))
    diagnosis = diagnosed(pendulum(), verdict="unexplained")
    sentence = gain_sentence(diagnosis, gain)
    assert f"from {nominal:.3g} to 0.452" in sentence
    assert "the noise estimate itself contains what is unexplained" in sentence
    assert "%" not in sentence
    diagnosis.noise = [0.01, 0.01]
    assert "the noise estimate" not in gain_sentence(diagnosis, gain)
    diagnosis.noise, diagnosis.remainder_, diagnosis.excess_p_value_ = (
        "estimate",
        None,
        1.0,
    )  # it only diverges
    assert "the noise estimate" not in gain_sentence(diagnosis, gain)


@pytest.mark.parametrize("n_causes", [3, 4])
def test_a_caution_is_said_where_so_many_causes_stand_together(n_causes):
    report = reported()
    report.diagnosis.causes_ = report.diagnosis.causes_ * n_causes
    caution = "So many causes together may stand for one that is not in the list."
    for text in (
        " ".join(verdict_sentences(report.diagnosis, [])),
        report.text(),
        Page(report.html(figures=False)).text,
    ):
        assert text.count(caution) == (n_causes > 3)


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
    report = reported()
    assert repr(report) == report.text()
    assert report._repr_html_() == report.html(figures=False)
    assert "img" not in Page(report.html(figures=False)).tags


# -- the page ------------------------------------------------------------------------------------------------


def test_the_page_is_one_file_of_matching_tags(tmp_path):
    path = reported().to_html(tmp_path / "report.html")
    html = path.read_text(encoding="utf-8")
    assert html.startswith("<!DOCTYPE html>")
    page = Page(html)
    assert len(page.plots) >= 3
    assert not re.search(r"https?://|@import|url\(", html)
    assert all(source.startswith(("#", "data:")) for source in page.sources)


def test_the_page_is_ascii_so_that_no_encoding_breaks_it():
    assert reported(pendulum(angle="ångström")).html().isascii()


def test_a_simulation_with_a_state_is_shown_in_open_loop_before_and_after():
    plots = plots_of(reported())
    signals = [plot for plot in plots if plot["across"] == "step"]
    assert {plot["up"] for plot in signals} == {"angle", "rate"}
    assert all(plot["roles"] == ["line measured", "line before", "line after"] for plot in signals)


def test_a_long_episode_is_no_worse_for_its_length():
    assert worst_and_typical(np.array([10.0, 90.0, 4.0]), np.array([10, 300, 8])) == [0, 2]
    assert worst_and_typical(np.array([3.0]), np.array([7])) == [0]


def test_a_one_shot_simulation_is_shown_measured_against_simulated():
    plots = plots_of(reported(thrower(), thrown_log(), value=0.5))
    clouds = {plot["up"]: plot for plot in plots if plot["up"].startswith("measured")}
    assert set(clouds) == {"measured a", "measured b"}
    assert clouds["measured a"]["across"] == "simulated a"
    assert clouds["measured a"]["roles"] == ["line zero", "dots before", "dots after"]


def test_independent_rows_are_shown_by_their_changes_of_state():
    X, y = (part[::2] for part in pendulum_log()[:2])
    plots = plots_of(reported(log=(X, y, None)))
    assert any(
        (p["up"], p["across"]) == ("measured change of rate", "simulated change of rate") for p in plots
    )


def test_where_a_channel_is_hidden_only_measured_ones_are_shown():
    X, y, groups = pendulum_log()
    X[:, 1] = y[:, 1] = 0.0
    report = reported(log=(X, y, groups), hidden=("rate",))
    assert {plot["up"] for plot in plots_of(report)} == {"angle"}
    assert "the initial state that fits each best" in Page(report.html()).text


def test_what_an_error_depends_on_is_shown_only_where_it_does():
    laws = [plot for plot in plots_of(reported()) if plot["up"].startswith("what is left")]
    assert any(plot["across"] == "rate" for plot in laws)
    right = reported(log=pendulum_log(damping=0.0), value=None, verdict="nothing detected")
    assert not [plot for plot in plots_of(right) if plot["up"].startswith("what is left")]


def test_axes_bear_the_units_that_the_simulator_knows():
    simulator = pendulum(units={"angle": "rad", "rate": "rad/s"})
    X, y, _ = pendulum_log()
    labels = {(plot["up"], plot["across"]) for plot in plots_of(reported(simulator))}
    assert {("angle (rad)", "step"), ("rate (rad/s)", "step")} <= labels
    assert any(across == "rate (rad/s)" and up.startswith("what is left") for up, across in labels)
    independent = plots_of(reported(simulator, log=(X[::2], y[::2], None)))
    assert any(plot["across"] == "simulated change of rate (rad/s)" for plot in independent)


def test_a_simulation_that_diverges_is_shown_as_far_as_it_goes():
    html = reported(pendulum(blow_up)).html()
    assert len(Page(html).plots) >= 2
    assert "rows left out, in which a simulation diverges" in Page(html).text


def test_a_log_that_cannot_be_simulated_at_all_is_said_on_a_page_that_is_written():
    X, y, groups = pendulum_log()
    report = reported(pendulum(blow_up), value=0.6)
    X[:, 0], y[:, 0] = X[:, 0] + 50, y[:, 0] + 50
    report.add_test("Far away", X, y, groups, gain=report.diagnosis.gain_)
    assert "No comparison by method: The simulation diverges in every row" in Page(report.html()).text


def test_errors_are_measured_on_rows_held_out_by_every_method():
    text = Page(reported().html()).text
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
    text = Page(reported(held_out=False).html()).text
    assert "No rows were held out" in text
    assert "Error by method" not in text


def test_names_are_escaped_in_page_and_pictures():
    evil = "<script>alert('x')</script>&"
    report = reported(pendulum(angle=evil), value=None, verdict="nothing detected")
    report.add_table(evil, pd.DataFrame({evil: [evil]}))
    html = report.html()
    assert "<script" not in html
    assert "script" not in Page(html).tags
    assert evil in Page(html).text
    assert evil in [plot["up"] for plot in Page(html).plots]


# -- what can be added ---------------------------------------------------------------------------------------


def test_a_table_is_added_with_its_index_numbers_and_gaps():
    report = reported()
    frame = pd.DataFrame(
        {"error": [0.123456789, np.nan], "right": [True, False]}, index=pd.Index(["one", "two"], name="ball")
    )
    report.add_table("All balls", frame)
    frame.loc["one", "error"] = 99.0
    html = report.html(figures=False)
    text = Page(html).text
    assert "All balls ball error right one 0.1235 yes two no" in text
    assert "99" not in text.partition("All balls")[2]


def test_a_long_table_is_folded_away():
    report = reported()
    report.add_table("Long", pd.DataFrame({"n": range(100)}))
    assert "<summary>100 rows</summary>" in report.html(figures=False)


def test_what_is_no_table_is_refused():
    with pytest.raises(TypeError, match="frame must be a pandas DataFrame; it is a list"):
        reported().add_table("Numbers", [1, 2])


def test_another_log_is_shown_instead_of_the_rows_fitted():
    report = reported(held_out=False)
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
    assert "Drop 2: the open-loop error of whole episodes goes from 2.5 to 0.25" in report.text()


# -- files ---------------------------------------------------------------------------------------------------


def test_a_file_that_exists_is_kept_unless_forced(tmp_path):
    path = tmp_path / "report.html"
    path.write_text("mine")
    report = reported(held_out=False)
    with pytest.raises(FileExistsError, match=r"report.html exists\. Choose another name, or .*force=True"):
        report.to_html(path)
    assert path.read_text() == "mine"
    assert report.to_html(str(path), force=True) == path
    assert "Measured and simulated" in path.read_text()


def test_folders_are_refused_as_files_and_missing_ones_named(tmp_path):
    with pytest.raises(FileExistsError, match="is a folder; expected the name of a file"):
        reported().to_html(tmp_path, force=True)
    with pytest.raises(FileNotFoundError, match=r"There is no folder .*nowhere"):
        reported().to_html(tmp_path / "nowhere" / "report.html")


# -- objects -------------------------------------------------------------------------------------------------


def test_a_report_pickles_and_copies_with_its_diagnosis_and_shows_the_same():
    report = reported()
    report.add_table("More", pd.DataFrame({"n": [1]}))
    html = report.html()
    assert report.html() == html
    for twin in (pickle.loads(pickle.dumps(report)), copy.deepcopy(report)):
        assert twin.html() == html
    frozen = pickle.dumps(report)
    assert b"matplotlib" not in frozen
    assert len(frozen) < 200_000


def test_drawing_leaves_no_trace_in_pyplot():
    before = dict(matplotlib.rcParams), pyplot.get_fignums()
    reported().html()
    assert (dict(matplotlib.rcParams), pyplot.get_fignums()) == before


def test_a_report_stays_as_it_is_when_the_diagnosis_is_fitted_again():
    X, y, groups = pendulum_log(n_episodes=8)
    diagnosis = SimulationDiagnosis(pendulum(), random_state=0).fit(X, y, groups)
    report = diagnosis.report_
    first = report.text()
    assert "damping of hinge" in first
    diagnosis.fit(*pendulum_log(n_episodes=8, seed=1, damping=0.0))
    assert report.text() == first
    assert diagnosis.report_.text() != first


def test_a_fitted_diagnosis_shows_itself_with_the_gain_on_rows_held_out(tmp_path):
    diagnosis = SimulationDiagnosis(pendulum(), random_state=0).fit(*pendulum_log(n_episodes=10))
    assert repr(diagnosis).endswith(diagnosis.report_.text())
    assert diagnosis._repr_html_() == diagnosis.report_.html(figures=False)
    copy_of_it = pickle.loads(pickle.dumps(diagnosis))
    path = copy_of_it.report_.to_html(tmp_path / "report.html")
    text = Page(path.read_text(encoding="utf-8")).text
    (cause,) = diagnosis.causes_
    assert cause.interval[0] < 0.6 < cause.interval[1]
    assert "Rows held out" in text
    assert "No transport beats the extended simulation" in text


def test_the_example_finds_the_friction_that_it_hides():
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        names = runpy.run_path(str(EXAMPLE))
    pyplot.close("all")
    (cause,) = names["diagnosis"].causes_
    assert cause.name == "dry_friction[hinge]"
    assert cause.interval[0] < 0.03 < cause.interval[1]
    assert names["gain"].ratio > 10
    assert "No transport beats" in Page(names["diagnosis"].report_.html()).text
