"""The paper's experiments as functions that return data frames, every method side by side."""

from skat.experiments.puck import (
    in_columns_of_paper,
    puck_learning_curve,
    puck_table,
    repeated_strikes_error,
    strike_pucks,
)
from skat.experiments.robots import domain_matrix, replay_transitions

__all__ = [
    "domain_matrix",
    "in_columns_of_paper",
    "puck_learning_curve",
    "puck_table",
    "repeated_strikes_error",
    "replay_transitions",
    "strike_pucks",
]
