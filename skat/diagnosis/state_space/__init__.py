"""The diagnosis on a state space: it replaces the engine beside it once it is right wherever that one is."""

from skat.diagnosis.state_space.comparison import compare_transports
from skat.diagnosis.state_space.estimator import SimulationDiagnosis
from skat.diagnosis.state_space.findings import Alias, Cause, Gain
from skat.diagnosis.state_space.remainder import Remainder

__all__ = ["Alias", "Cause", "Gain", "Remainder", "SimulationDiagnosis", "compare_transports"]
