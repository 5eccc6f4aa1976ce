"""What a diagnosis says that was not fitted, or gets texts for numbers."""

import copy
import pickle

import numpy as np
import pytest
from sklearn.exceptions import NotFittedError

from skat.diagnosis import SimulationDiagnosis
from skat.simulators import MujocoSimulator

CART = """<mujoco><worldbody><body><joint name="rail" type="slide"/><geom size="0.1"/></body></worldbody></mujoco>"""


@pytest.mark.parametrize("name", ["report_", "causes_", "verdict_", "extended_simulator_"])
def test_findings_of_a_diagnosis_that_was_not_fitted_say_so(name):
    diagnosis = SimulationDiagnosis(MujocoSimulator(CART))
    with pytest.raises(NotFittedError, match=rf"has no {name}; call fit"):
        getattr(diagnosis, name)
    assert not hasattr(diagnosis, name)


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
