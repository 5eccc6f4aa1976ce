"""Displays show the data they are given, and say what is wrong with data they cannot show."""

from types import SimpleNamespace
from typing import ClassVar

import matplotlib
import numpy as np
import pandas as pd
import pytest
from sklearn.linear_model import Ridge
from sklearn.preprocessing import FunctionTransformer
from sklearn.utils import Bunch

from skat.plotting import (
    CauseDisplay,
    DomainMatrixDisplay,
    LearningCurveDisplay,
    TrajectoryDisplay,
    TransportDisplay,
)
from skat.simulators import FunctionSimulator


@pytest.fixture(autouse=True)
def pyplot():
    matplotlib.use("agg")
    from matplotlib import pyplot

    yield pyplot
    pyplot.close("all")


def frame_of_domains():
    return pd.DataFrame(
        {
            "source": ["b", "b", "a"],
            "target": ["a", "c", "b"],
            "value": [1.0, 2.0, 3.0],
            "other": [4.0, 5.0, 6.0],
        }
    )


def test_displays_draw_into_given_axes(pyplot):
    rng = np.random.default_rng(0)
    figure, axes = pyplot.subplots(2, 2)
    X, y = rng.normal(size=(2, 20, 3))
    displays = [
        TransportDisplay.from_estimator(FunctionTransformer(), X, y, ax=axes[0, 0]),
        DomainMatrixDisplay.from_frame(frame_of_domains(), ax=axes[0, 1]),
        CauseDisplay.from_causes([], neutral={}, ax=axes[1, 1]),
    ]
    for display, ax in zip(displays, (axes[0, 0], axes[0, 1], axes[1, 1])):
        assert display.ax_ is ax
        assert display.figure_ is figure
    trajectory = TrajectoryDisplay.from_predictions(
        [0, 1], [[0], [1]], [[0], [2]], names=["x"], ax=axes[1, 0]
    )
    assert trajectory.ax_[0] is axes[1, 0]
    figure.canvas.draw()


def test_transport_shows_two_chosen_columns():
    X, y = pd.DataFrame([[1.0, 2.0, 3.0], [4.0, 5.0, 6.0]], columns=list("abc")), np.ones((3, 3))
    double = FunctionTransformer(lambda rows: 2 * rows)
    display = TransportDisplay.from_estimator(double, X, y, features=["c", 0], n_arrows=2)
    np.testing.assert_array_equal(display.source, [[3, 1], [6, 4]])
    np.testing.assert_array_equal(display.transported, [[6, 2], [12, 8]])
    assert (display.ax_.get_xlabel(), display.ax_.get_ylabel()) == ("c", "a")
    assert len(display.ax_.texts) == 2
    drawn = {cloud.get_label(): cloud.get_offsets().data for cloud in display.ax_.collections}
    np.testing.assert_array_equal(drawn["source, transported"], display.transported)


def test_transport_shows_principal_coordinates_of_the_target():
    rng = np.random.default_rng(0)
    y = rng.normal(size=(4000, 3)) * [0.1, 3, 1]
    display = TransportDisplay.from_predictions(y, y, y, n_points=4000)
    np.testing.assert_allclose(np.std(display.target, axis=0), [3, 1], rtol=0.05)
    np.testing.assert_allclose(np.corrcoef(display.target.T), np.eye(2), atol=1e-9)
    # Figures do not flip from one computation to the next: the largest entry of an axis is positive.
    assert np.corrcoef(display.target[:, 0], y[:, 1])[0, 1] > 0.99


def test_transport_draws_no_more_points_than_asked():
    rows = np.random.default_rng(0).normal(size=(5000, 2))
    display = TransportDisplay.from_predictions(rows, rows, rows[:30], n_points=100)
    assert len(display.source) == len(display.transported) == 100
    assert len(display.target) == 30


def test_transport_says_what_is_wrong():
    rows = np.ones((4, 3))
    with pytest.raises(TypeError, match="Ridge cannot transform"):
        TransportDisplay.from_estimator(Ridge(), rows, rows)
    with pytest.raises(ValueError, match=r"shapes are \(4, 3\), \(3, 3\) and \(4, 3\)"):
        TransportDisplay.from_predictions(rows, rows[:3], rows)
    with pytest.raises(ValueError, match=r"no column 'z'; there are \['x', 'y', 'w'\]"):
        TransportDisplay.from_predictions(
            rows, rows, rows, features=["x", "z"], feature_names=["x", "y", "w"]
        )
    with pytest.raises(ValueError, match="no column 3; there are 3"):
        TransportDisplay.from_predictions(rows, rows, rows, features=[0, 3])
    with pytest.raises(ValueError, match=r"must be two columns, .* it is \[0\]"):
        TransportDisplay.from_predictions(rows, rows, rows, features=[0])
    with pytest.raises(ValueError, match="there is 1"):
        TransportDisplay.from_predictions(rows[:, :1], rows[:, :1], rows[:, :1])


def test_matrix_puts_a_domain_in_the_same_place_in_rows_and_columns():
    display = DomainMatrixDisplay.from_frame(frame_of_domains(), value="other")
    assert (display.sources, display.targets) == (["b", "a"], ["b", "a", "c"])
    np.testing.assert_array_equal(display.values, [[np.nan, 4, 5], [6, np.nan, np.nan]])
    assert [text.get_text() for text in display.ax_.texts] == ["4.00", "5.00", "6.00"]
    assert display.figure_.axes[1].get_ylabel() == "other"


def test_matrix_writes_light_on_dark_and_dark_on_light():
    display = DomainMatrixDisplay.from_frame(frame_of_domains())
    assert [text.get_color() for text in display.ax_.texts] == ["black", "white", "white"]


def test_matrix_can_do_without_numbers_and_scale():
    display = DomainMatrixDisplay.from_frame(
        frame_of_domains(), number_format="", colorbar=False, limits=(0, 9)
    )
    assert not display.ax_.texts
    assert len(display.figure_.axes) == 1
    assert display.im_.get_clim() == (0, 9)
    assert display.ax_.get_title() == "value"


def test_matrix_says_what_is_wrong():
    frame = frame_of_domains()
    with pytest.raises(ValueError, match=r"no column 'rho'; it has \['source'"):
        DomainMatrixDisplay.from_frame(frame, value="rho")
    with pytest.raises(ValueError, match="b to a has several"):
        DomainMatrixDisplay.from_frame(pd.concat([frame, frame[:1]]))


def test_curve_bands_are_two_standard_deviations():
    frame = pd.DataFrame({"n_samples": [10, 10, 20, 20], "method": "map", "error": [1.0, 3.0, 1.0, 1.0]})
    display = LearningCurveDisplay.from_frame(frame)
    np.testing.assert_array_equal(display.curves["map"], [[10, 2, 1], [20, 1, 0]])
    band = display.ax_.collections[0].get_paths()[0].vertices
    assert (band[:, 1].min(), band[:, 1].max()) == (0.0, 4.0)


def test_curve_bands_are_cut_on_a_logarithmic_axis_only():
    frame = pd.DataFrame({"n_samples": [10, 10, 20, 20], "method": "map", "error": [0.0, 4.0, 1.0, 1.0]})
    for log_value, lowest in ((False, -2.0), (True, 0.5)):
        display = LearningCurveDisplay.from_frame(frame, log_value=log_value)
        assert display.ax_.collections[0].get_paths()[0].vertices[:, 1].min() == lowest


def test_curve_takes_deviations_computed_before():
    frame = pd.DataFrame({"n": [20, 10], "how": "map", "mean": [1.0, 2.0], "std": [0.1, 0.2]})
    display = LearningCurveDisplay.from_frame(
        frame, size="n", method="how", value="mean", deviation="std", log_value=True
    )
    np.testing.assert_array_equal(display.curves["map"], [[10, 2, 0.2], [20, 1, 0.1]])
    assert display.ax_.get_yscale() == "log"


def test_curve_keeps_the_order_of_methods_and_draws_the_baseline():
    frame = pd.DataFrame(
        {"n_samples": [1, 2, 1, 2], "method": ["z", "z", "a", "a"], "error": [4.0, 3.0, 2.0, 1.0]}
    )
    display = LearningCurveDisplay.from_frame(frame, baseline=5.0)
    labels = [text.get_text() for text in display.ax_.get_legend().get_texts()]
    assert labels == ["z", "a", "without transport"]
    # One repetition has no deviation, which is no band rather than a band of width zero.
    assert np.isnan(display.curves["z"][:, 2]).all()


def test_curve_says_what_is_wrong():
    frame = pd.DataFrame({"n_samples": [1, 1], "method": "map", "error": [4.0, 3.0], "std": [0.0, 0.0]})
    with pytest.raises(ValueError, match="no column 'rho'"):
        LearningCurveDisplay.from_frame(frame, value="rho")
    with pytest.raises(ValueError, match="map has 2 rows for 1 sizes"):
        LearningCurveDisplay.from_frame(frame, deviation="std")


class Growth:
    """A simulation whose state grows by a rate and its input."""

    state_names = output_names = ("mass", "clock")
    input_names = (*state_names, "feed")
    units: ClassVar = {"clock": "s"}
    dt = 0.5

    def __init__(self, rate):
        self.rate = rate

    def rollout(self, initial_states, inputs, *, n_steps):
        states = [initial_states]
        for k in range(n_steps):
            states.append(self.rate * states[-1] + inputs[:, k])
        return np.stack(states, axis=1)


def test_trajectory_rolls_both_simulations_out_from_the_first_measured_state():
    diagnosis = SimpleNamespace(simulator=Growth(1.0), extended_simulator_=Growth(2.0))
    X = np.array([[1.0, 3.0, 0.0], [2.0, 6.0, 0.0], [4.0, 12.0, 0.0]])
    display = TrajectoryDisplay.from_estimator(diagnosis, X, 2 * X[:, :2], channels=["clock"])
    np.testing.assert_array_equal(display.time, [0, 0.5, 1, 1.5])
    assert display.ax_[0].get_ylabel() == "clock\n(s)"
    np.testing.assert_array_equal(display.measured[:, 0], [3, 6, 12, 24])
    np.testing.assert_array_equal(display.before[:, 0], [3, 3, 3, 3])
    np.testing.assert_array_equal(display.after, display.measured)
    assert [line.get_label() for line in display.ax_[0].lines] == [
        "measured",
        "simulated, before",
        "simulated, after",
    ]


def test_trajectory_has_one_axes_for_each_channel():
    rows = np.arange(6.0).reshape(3, 2)
    display = TrajectoryDisplay.from_predictions([0, 1, 2], rows, rows, names=["x", "y"], units={"y": "m"})
    assert [ax.get_ylabel() for ax in display.ax_] == ["x", "y\n(m)"]
    assert display.ax_[-1].get_xlabel() == "time (s)"
    assert len(display.ax_[0].lines) == 2


def test_trajectory_says_what_is_wrong(pyplot):
    rows = np.zeros((3, 2))
    with pytest.raises(ValueError, match=r"no column 'z'; there are \['x', 'y'\]"):
        TrajectoryDisplay.from_predictions([0, 1, 2], rows, rows, names=["x", "y"], channels=["z"])
    with pytest.raises(ValueError, match=r"before must have .* shape \(3, 2\); its shape is \(2, 2\)"):
        TrajectoryDisplay.from_predictions([0, 1, 2], rows, rows[:2], names=["x", "y"])
    with pytest.raises(ValueError, match="each of the 2 channels needs its own Axes; there are 1"):
        TrajectoryDisplay.from_predictions(
            [0, 1, 2], rows, rows, names=["x", "y"], ax=pyplot.figure().subplots()
        )
    with pytest.raises(ValueError, match="needs a simulation with a state"):
        TrajectoryDisplay.from_estimator(
            SimpleNamespace(simulator=SimpleNamespace(state_names=())), rows, rows
        )


def cause(name, value, low, high, unit="1"):
    return SimpleNamespace(name=name, value=value, interval=(low, high), unit=unit)


def test_causes_stand_on_the_side_of_their_deviation():
    causes = [
        cause("mass[leg]", 1.5, 1.25, 2.0),
        cause("tilt[x]", -0.2, -0.25, 0.05, "rad"),
        cause("radius[wheel]", 1.050045, 1.050032, 1.050058),
    ]
    display = CauseDisplay.from_causes(
        causes, neutral={"mass[leg]": 1.0, "tilt[x]": 0.0, "radius[wheel]": 1.0}
    )
    points = display.ax_.lines[-1].get_xydata()
    np.testing.assert_allclose(points[:2], [[0.5, 0], [-0.8, 1]])
    intervals = [segment[:, 0] for segment in display.ax_.collections[-1].get_segments()]
    np.testing.assert_allclose(intervals[:2], [[0.25, 1], [-1, 0.2]])
    texts = [text.get_text() for text in display.ax_.texts]
    assert texts == [
        "1.5  (1.25 to 2; neutral 1)",
        "-0.2 rad  (-0.25 to 0.05; neutral 0)",
        "1.050045  (1.050032 to 1.050058; neutral 1)",
    ]


def test_causes_of_a_diagnosis_find_their_neutral_values():
    effects = [SimpleNamespace(name="gain[a]", neutral=1.0), SimpleNamespace(name="damping[a]", neutral=0.0)]
    simulator = SimpleNamespace(effects=lambda also: effects)
    diagnosis = SimpleNamespace(simulator=simulator, causes_=(cause("gain[a]", 0.9, 0.8, 1.0),))
    assert CauseDisplay.from_estimator(diagnosis).neutrals == [1.0]


def test_causes_of_a_clean_diagnosis_say_so():
    assert [text.get_text() for text in CauseDisplay.from_causes([], neutral={}).ax_.texts] == [
        "nothing named"
    ]


def test_causes_without_neutral_value_are_an_error():
    with pytest.raises(
        ValueError, match=r"no value for \['mass\[leg\]'\]; it has values for \['wind\[x\]'\]"
    ):
        CauseDisplay.from_causes([cause("mass[leg]", 1.5, 1.2, 2.0)], neutral={"wind[x]": 0.0})


def test_trajectory_takes_tables_by_name_and_steps_where_there_is_no_time():
    names = ("angle", "rate")
    simulator = FunctionSimulator(
        lambda X: X @ [[1.0, 0.0], [0.1, 1.0]], input_names=names, output_names=names, state_names=names
    )
    states = simulator.rollout([[0.0, 1.0]], n_steps=10)[0]
    diagnosis = Bunch(simulator=simulator, extended_simulator_=simulator)
    X, y = (pd.DataFrame(part, columns=names) for part in (states[:-1], states[1:]))
    display = TrajectoryDisplay.from_estimator(diagnosis, X[["rate", "angle"]], y[["rate", "angle"]])
    np.testing.assert_allclose(display.measured, states)
    np.testing.assert_allclose(display.before, states)
    assert display.ax_[-1].get_xlabel() == "step"
