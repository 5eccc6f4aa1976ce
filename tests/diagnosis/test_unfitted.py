"""What a diagnosis says that was not fitted, or gets texts for numbers."""

import copy
import pickle

import numpy as np
import pandas as pd
import pytest
from sklearn import config_context
from sklearn.exceptions import NotFittedError

from skat.diagnosis import SimulationDiagnosis
from skat.simulators import MujocoSimulator
from tests.diagnosis.forces.test_force_space import ARM, log_of

CART = """<mujoco><worldbody><body><joint name="rail" type="slide"/><geom size="0.1"/></body></worldbody></mujoco>"""


@pytest.mark.parametrize("name", ["report_", "causes_", "verdict_", "extended_simulator_"])
def test_findings_of_a_diagnosis_that_was_not_fitted_say_so(name):
    diagnosis = SimulationDiagnosis(MujocoSimulator(CART))
    with pytest.raises(NotFittedError, match=rf"has no {name}; call fit"):
        getattr(diagnosis, name)
    assert not hasattr(diagnosis, name)


def test_of_fit_and_of_fit_change_only_what_was_asked_last_is_told(tmp_path):
    log, further = log_of(4, rows=200), log_of(5, rows=200)
    diagnosis = SimulationDiagnosis(MujocoSimulator(ARM, frame_skip=5), effects=["gain[elbow]"], test_size=0)
    diagnosis.fit(*log).fit_change(log, further)
    for ask in (
        lambda: diagnosis.causes_,
        lambda: diagnosis.save(tmp_path / "a.skat"),
        lambda: diagnosis.predict(log[0]),
        lambda: diagnosis.evaluate(*log),
    ):
        with pytest.raises(NotFittedError, match=r"fit_change was asked .*; call fit"):
            ask()
    assert repr(diagnosis).endswith("Verdict: nothing changed")
    assert diagnosis._repr_mimebundle_() == {"text/plain": repr(diagnosis)}
    diagnosis.fit(*log)
    assert not hasattr(diagnosis, "changes_")
    assert SimulationDiagnosis.load(diagnosis.save(tmp_path / "a.skat")).verdict_ == diagnosis.verdict_


@pytest.mark.parametrize(
    "kind", [set, frozenset, pd.Index, pd.Series, lambda names: np.array(names, dtype=object)]
)
def test_effects_of_any_kind_of_list_and_a_request_for_metadata_do_not_stop_a_save(kind, tmp_path):
    diagnosis = SimulationDiagnosis(
        MujocoSimulator(ARM, frame_skip=5), effects=kind(["gain[elbow]"]), test_size=0
    )
    with config_context(enable_metadata_routing=True):
        diagnosis.set_fit_request(groups=True)
    diagnosis.fit(*log_of(4, rows=60))
    loaded = SimulationDiagnosis.load(diagnosis.save(tmp_path / "a.skat"))
    assert loaded.effects == ["gain[elbow]"]


def test_what_never_exists_is_an_ordinary_attribute_error():
    diagnosis = SimulationDiagnosis(MujocoSimulator(CART))
    with pytest.raises(AttributeError, match="no attribute 'report'"):
        diagnosis.report  # noqa: B018
    assert copy.deepcopy(diagnosis).alpha == pickle.loads(pickle.dumps(diagnosis)).alpha == 0.01


def test_numbers_as_texts_are_refused_with_their_place():
    simulator, rows = MujocoSimulator(CART), np.zeros((30, 2)).astype(str).astype(object)
    with pytest.raises(ValueError, match=r"X holds the text '0.0' in row 0, column 0"):
        simulator.predict(rows)
    with pytest.raises(ValueError, match=r"y holds the text '0.0' in row 0, column 0"):
        SimulationDiagnosis(simulator).fit(np.zeros((30, 2)), rows, groups=np.zeros(30))
