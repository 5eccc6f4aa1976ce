"""Find out what a simulation gets wrong: name the cause, size it, build it in, and measure the gain."""

from skat.diagnosis.comparison import compare_transports
from skat.diagnosis.estimator import SimulationDiagnosis
from skat.diagnosis.findings import Alias, Cause, Gain
from skat.diagnosis.remainder import Remainder
from skat.diagnosis.report.agreement import compare_findings

__all__ = [
    "Alias",
    "Cause",
    "Gain",
    "Remainder",
    "SimulationDiagnosis",
    "compare_findings",
    "compare_transports",
]
