"""The paper's experiments as functions that return data frames, every method side by side."""

from importlib import import_module
from typing import TYPE_CHECKING

if TYPE_CHECKING:
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
IN_ROBOTS = ("domain_matrix", "replay_transitions")


def __getattr__(name: str) -> object:
    # A diagnosis from the command line waits for none of their imports.
    if name not in __all__:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    found: object = getattr(import_module(f"{__name__}.{'robots' if name in IN_ROBOTS else 'puck'}"), name)
    globals()[name] = found
    return found


def __dir__() -> list[str]:
    return sorted({*globals(), *__all__})
