"""What Jupyter shows: findings, progress in one place, warnings that point to the user's own line."""

import re

import pytest

from skat.progress import progress_bars
from tests.diagnosis.pages import Page

SETUP = """
import numpy as np
from skat.diagnosis import SimulationDiagnosis
from skat.effects import Effect
from skat.progress import progress_bars
from skat.simulators import FunctionSimulator

def swing(X, damping):
    rate = X[:, 1] + 0.05 * (X[:, 2] - np.sin(X[:, 0]) - damping * X[:, 1])
    return np.stack([X[:, 0] + 0.05 * rate, rate], axis=1)

def blow_up(X, damping):
    return np.where(np.abs(X[:, :1]) > 1.8, np.nan, swing(X, damping))

def pendulum(function):
    names = ("angle", "rate")
    damping = Effect("damping", unit="1/s", neutral=0.0, bounds=(0.0, 5.0))
    return FunctionSimulator(
        function, input_names=(*names, "push"), output_names=names, state_names=names, effects=(damping,)
    )

rng = np.random.default_rng(0)
states = [np.column_stack([rng.uniform(-2, 2, 10), rng.normal(size=10)])]
pushes = rng.normal(size=(10, 30))
for step in range(30):
    states.append(swing(np.column_stack([states[-1], pushes[:, step]]), 0.6))
states = np.stack(states, axis=1) + 0.01 * rng.normal(size=(10, 31, 2))
X = np.concatenate([states[:, :-1], pushes[:, :, None]], axis=2).reshape(-1, 3)
y, groups = states[:, 1:].reshape(-1, 2), np.repeat(np.arange(10), 30)
"""
CELLS = {
    "setup": SETUP,
    "unfitted": "diagnosis = SimulationDiagnosis(pendulum(swing), random_state=0)\ndiagnosis",
    "progress": "with progress_bars() as progress:\n    diagnosis.fit(X, y, groups=groups, progress=progress)",
    "fitted": "diagnosis",
    "report": "diagnosis.report_",
    "warned": "other = SimulationDiagnosis(pendulum(blow_up), random_state=0)\nother.fit(X, y, groups=groups)\nNone",
    "display": (
        "%matplotlib inline\nfrom skat.plotting import CauseDisplay\nCauseDisplay.from_estimator(diagnosis)"
    ),
}


@pytest.fixture(scope="module")
def outputs():
    """The outputs of each cell of an executed notebook."""
    nbclient = pytest.importorskip(
        "nbclient", reason="needs nbclient and ipykernel: pip install nbclient ipykernel"
    )
    pytest.importorskip("ipykernel", reason="needs nbclient and ipykernel: pip install nbclient ipykernel")
    import nbformat

    notebook = nbformat.v4.new_notebook()
    notebook.cells = [nbformat.v4.new_code_cell(source) for source in CELLS.values()]
    nbclient.NotebookClient(notebook, timeout=120, kernel_name="python3").execute()
    return {name: cell.outputs for name, cell in zip(CELLS, notebook.cells, strict=True)}


def data(outputs, kind="text/html"):
    return [output["data"][kind] for output in outputs if kind in output.get("data", {})]


@pytest.mark.filterwarnings("default")  # of the kernel's own libraries
class TestNotebook:
    def test_an_unfitted_diagnosis_is_shown_as_scikit_learn_shows_estimators(self, outputs):
        (html,) = data(outputs["unfitted"])
        assert "sk-estimator" in html

    def test_a_fitted_diagnosis_is_shown_with_its_findings(self, outputs):
        for cell in ("fitted", "report"):
            (html,) = data(outputs[cell])
            page = Page(html)
            assert "1 cause named" in page.text
            assert "damping is 0." in page.text
            assert "script" not in page.tags
            (text,) = data(outputs[cell], "text/plain")
            assert "Verdict: named" in text

    def test_progress_is_one_output_that_ends_with_the_time_it_took(self, outputs):
        htmls = data(outputs["progress"])
        shown = [html for html in htmls if "skat-report" not in html]
        assert len(shown) == 1
        assert re.fullmatch(r"<span>\d+ stages in [\d.]+ s</span>", shown[0])
        assert not [output for output in outputs["progress"] if output["output_type"] == "stream"]

    def test_a_warning_points_to_the_cell_and_not_into_skat(self, outputs):
        said = "".join(output["text"] for output in outputs["warned"] if output.get("name") == "stderr")
        assert "UserWarning: The simulation with its causes diverges in" in said
        assert "skat/diagnosis" not in said
        assert "ipykernel" in said

    def test_a_plot_is_drawn_once_and_stays_a_display(self, outputs):
        (text,) = data(outputs["display"], "text/plain")[:1]
        assert text.startswith("<skat.plotting.diagnosis.CauseDisplay ")
        assert len(data(outputs["display"], "image/png")) == 1


def test_elsewhere_the_name_of_each_stage_is_printed_once(capsys):
    with progress_bars() as progress:
        for done in range(5):
            progress("simulate", done, 5)
        progress("judge", 0, 1)
    assert capsys.readouterr().err == "simulate ...\njudge ...\n"
