"""What `fit` and `fit_change` were given: logs of one robot, as rows and as log objects, checked and put together."""

from collections.abc import Mapping
from dataclasses import dataclass
from os import PathLike
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from skat.diagnosis.chains import Array
from skat.diagnosis.log import Log, check_log, check_matrix, put_together, tangent_variances
from skat.simulators import Simulator


@dataclass(frozen=True)
class Given:
    """A log, or several put together.

    `least` (n_residuals,), (n_logs, n_residuals): least variance of each channel's noise. `actions` in {"commanded",
    "measured"}: what the log says of its actions; rows by themselves say nothing, and are taken for commands.
    """

    log: Log
    least: Array
    actions: str


def read_logs(
    simulator: Simulator, X: Any, y: Any, groups: ArrayLike | None, floor: ArrayLike | None, actions: str
) -> Given:
    """Return what `SimulationDiagnosis.fit` was given; ``actions`` is what a user says of them, or "auto".

    Raises a ValueError if the rows of a log do not fit the simulator, or logs hold different things.
    """
    own = "commanded" if actions == "auto" else actions
    if y is not None:
        return Given(check_log(simulator, X, y, groups), _checked_floor(simulator, floor), own)
    logs = _named_logs(simulator, X)
    if logs is None:
        raise ValueError(
            "SimulationDiagnosis requires y to be passed, but the target y is None. Instead of X and y it takes a log, "
            f"or a list or a mapping of logs; {_no_log(X)}"
        )
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


def read_change(simulator: Simulator, before: Any, after: Any) -> tuple[Log, Log]:
    """Return the two logs that `SimulationDiagnosis.fit_change` was given; without groups one is a single episode.

    Raises a ValueError if one is no log, or its rows do not fit the simulator, with which one it is.
    """
    first, second = (
        _log_of(simulator, f"the log {name}", one) for name, one in (("before", before), ("after", after))
    )
    return first, second


def _log_of(simulator: Simulator, name: str, one: Any) -> Log:
    X, y, groups, _ = _parts(simulator, name, one)
    try:
        if groups is None:
            names = simulator.output_names
            groups = np.zeros(len(check_matrix(y, "y", names, optional=names)), dtype=int)
        return check_log(simulator, X, y, groups)
    except ValueError as error:
        raise ValueError(f"{name}: {error}") from error


def _named_logs(simulator: Simulator, given: Any) -> dict[str, tuple[Any, Any, Any, Any]] | None:
    """Return X, y, groups and floor of a log, or of several by their names; None of anything else."""
    if _is_log(given):
        given = [given]
    if isinstance(given, Mapping):
        logs = {str(name): one for name, one in given.items()}
        if len(logs) < len(given):
            raise ValueError(f"two logs have the same name: {', '.join(map(repr, given))}.")
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
    return {name: _parts(simulator, name, one) for name, one in logs.items()}


def _is_log(one: Any) -> bool:
    return all(hasattr(one, name) for name in ("X", "y", "groups"))


def _parts(simulator: Simulator, name: str, one: Any) -> tuple[Any, Any, Any, Any]:
    if _is_log(one):
        _check_rate(simulator, name, one)
        return one.X, one.y, one.groups, getattr(one, "floor", None)
    if not isinstance(one, tuple) or len(one) not in (2, 3):
        raise ValueError(f"{name}: expected a log, or a tuple of (X, y) or (X, y, groups); {_no_log(one)}")
    return one[0], one[1], one[2] if len(one) == 3 else None, None


def _check_rate(simulator: Simulator, name: str, log: Any) -> None:
    """Raise where a log's rows are not as far apart as the simulator's."""
    given, dt = getattr(getattr(log, "simulator", None), "dt", None), simulator.dt
    if given and dt and not np.isclose(given, dt, rtol=1e-3, atol=0):
        raise ValueError(
            f"{name} has rows of {given:g} s, and a step of the simulator is {dt:g} s. Take the simulator that goes "
            f"with the log, SimulationDiagnosis(log.simulator), or read the log with load_log(..., rate={1 / dt:g})."
        )


def _no_log(one: Any) -> str:
    """Return what was given where a log was expected, and what to do."""
    if isinstance(one, str | PathLike):
        return f"got the path {str(one)!r}: read it, load_log({str(one)!r}, simulator)."
    if hasattr(one, "columns"):
        return "got a table: read it, load_log(table, simulator), or split it in X, the rows, and y, what followed."
    if isinstance(one, list | tuple):
        kinds = ", ".join(type(each).__name__ for each in one[:4])
        return f"got a {type(one).__name__} of {len(one)} ({kinds}), and each log is one of load_log or such a tuple."
    return f"got {type(one).__name__}."


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
