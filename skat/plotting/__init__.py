"""Figures in scikit-learn's manner: a Display holds what it shows, and ``plot`` draws it.

Colours mean the same everywhere: grey is the measurement (target), orange the simulation (source), blue the
simulation after transport or diagnosis. They are of Okabe and Ito's palette, which colour-blind readers can
tell apart.
"""

from skat.plotting.clouds import TransportDisplay
from skat.plotting.diagnosis import CauseDisplay, TrajectoryDisplay
from skat.plotting.experiments import DomainMatrixDisplay, LearningCurveDisplay

__all__ = [
    "CauseDisplay",
    "DomainMatrixDisplay",
    "LearningCurveDisplay",
    "TrajectoryDisplay",
    "TransportDisplay",
]
