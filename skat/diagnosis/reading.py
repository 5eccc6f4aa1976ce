"""What `fit` was given: a log, or several of one robot, as rows and as log objects, checked and put together."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from skat.diagnosis.chains import Array
from skat.diagnosis.log import Log, check_log, put_together, tangent_variances
from skat.simulators import Simulator


@dataclass(frozen=True)
class Given:
    """A log, or several put together.

    Attributes
    ----------
    log : Log
    least : ndarray of shape (n_residuals,) or (n_logs, n_residuals)
        Least variance of each channel's noise.
    actions : {"commanded", "measured"}
        What the log says of its actions; rows by themselves say nothing, and are taken for commands.
    """

    log: Log
    least: Array
    actions: str


def read_logs(
    simulator: Simulator, X: Any, y: Any, groups: ArrayLike | None, floor: ArrayLike | None, actions: str
) -> Given:
    """Return what `SimulationDiagnosis.fit` was given; ``actions`` is what a user says of them, or "auto".

    Raises
    ------
    ValueError
        If the rows of a log do not fit the simulator, or logs hold different things.
    """
    own = "commanded" if actions == "auto" else actions
    if y is not None:
        return Given(check_log(simulator, X, y, groups), _checked_floor(simulator, floor), own)
    logs = _named_logs(X)
    if logs is None:
        raise ValueError("SimulationDiagnosis requires y to be passed, but the target y is None.")
    if groups is not None or floor is not None:
        raise ValueError("groups and floor are those of each log: pass tuples of (X, y, groups), or logs.")
    if actions == "auto":
        own = _actions_of(X)
    checked, floors = [], []
    for name, (X, y, groups, least) in logs.items():
        try:
            checked.append(check_log(simulator, X, y, groups))
            floors.append(_checked_floor(simulator, least))
        except ValueError as error:
            if len(logs) == 1:
                raise
            raise ValueError(f"{name}: {error}") from error
    if len(checked) == 1:
        return Given(checked[0], floors[0], own)
    return Given(put_together(checked, tuple(logs)), np.stack(floors), own)


def _named_logs(given: Any) -> dict[str, tuple[Any, Any, Any, Any]] | None:
    """Return X, y, groups and floor of a log, or of several by their names; None of anything else."""
    if _is_log(given):
        given = [given]
    if isinstance(given, Mapping):
        logs = {str(name): one for name, one in given.items()}
    elif isinstance(given, list | tuple) and all(_is_log(one) or isinstance(one, tuple) for one in given):
        names = [getattr(one, "source", "") or f"log {number}" for number, one in enumerate(given, 1)]
        logs = {
            name if names.count(name) == 1 else f"{name} ({number})": one
            for number, (name, one) in enumerate(zip(names, given), 1)
        }
    else:
        return None
    if not logs:
        raise ValueError("there is no log; expected at least one.")
    return {name: _parts(name, one) for name, one in logs.items()}


def _is_log(one: Any) -> bool:
    return all(hasattr(one, name) for name in ("X", "y", "groups"))


def _parts(name: str, one: Any) -> tuple[Any, Any, Any, Any]:
    if _is_log(one):
        return one.X, one.y, one.groups, getattr(one, "floor", None)
    if not isinstance(one, tuple) or len(one) not in (2, 3):
        raise ValueError(f"{name}: expected a log, or a tuple of (X, y) or (X, y, groups); got {one!r:.80}.")
    return one[0], one[1], one[2] if len(one) == 3 else None, None


def _actions_of(given: Any) -> str:
    """Return what logs say of their actions; raises a ValueError if they differ."""
    logs = [given] if _is_log(given) else list(given.values() if isinstance(given, Mapping) else given)
    told = {getattr(one, "actions", "commanded") for one in logs}
    if len(told) > 1:
        raise ValueError(
            "some of the logs hold measured efforts and some commands, of which one law is asked: pass actions=."
        )
    return str(told.pop())


def _checked_floor(simulator: Simulator, floor: ArrayLike | None) -> Array:
    """Return the least variance of each residual channel's noise."""
    names = simulator.output_names
    if floor is None:
        return np.zeros(len(simulator.residual_names))
    try:
        variances = np.asarray(floor, dtype=float)
    except (TypeError, ValueError):
        variances = np.array(np.nan)
    if variances.shape != (len(names),) or not ((variances >= 0) & (variances < np.inf)).all():
        raise ValueError(
            f"floor must hold a finite variance of at least 0 for each of {', '.join(names)}; it is {floor!r}."
        )
    return tangent_variances(simulator, variances)
