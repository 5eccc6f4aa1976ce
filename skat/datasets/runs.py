"""Runs of a machine, each a table of states and commands in time, as transitions in one Bunch."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from sklearn.utils import Bunch

# A row that is later than this many of the usual steps comes after a gap.
GAP = 1.5


@dataclass(frozen=True)
class Run:
    """What was measured in one run.

    Attributes
    ----------
    time : ndarray of shape (n_rows,)
        s.
    states : ndarray of shape (n_rows, n_states)
        NaN is "not measured".
    commands : ndarray of shape (n_rows, n_commands)
    """

    time: np.ndarray
    states: np.ndarray
    commands: np.ndarray


def transitions(
    runs: Mapping[str, Run],
    *,
    joints: Sequence[str],
    commanded: Sequence[str],
    command_unit: str,
    **facts: Any,
) -> Bunch:
    """Return runs as transitions, each from a row to the next one; a gap in time begins another episode.

    Parameters
    ----------
    runs : mapping from name to Run
    joints : sequence of str
        The states are ``qpos.<joint>`` in rad, then ``qvel.<joint>`` in rad/s.
    commanded : sequence of str
        The commands are ``ctrl.<name>``.
    command_unit : str
    **facts
        Further attributes.

    Returns
    -------
    Bunch
        With data, target, groups, group_names, feature_names, target_names, units, hidden, dt.
    """
    state_names = [f"{kind}.{joint}" for kind in ("qpos", "qvel") for joint in joints]
    command_names = [f"ctrl.{name}" for name in commanded]
    dt = float(np.median(np.concatenate([np.diff(run.time) for run in runs.values()])))
    data, target, groups = [], [], []
    names: list[str] = []
    for name, run in runs.items():
        inputs, steps = np.column_stack([run.states, run.commands]), np.diff(run.time)
        whole = steps <= GAP * dt
        pieces = np.cumsum(~whole)[whole]
        for number, piece in enumerate(np.unique(pieces)):
            rows = np.flatnonzero(whole)[pieces == piece]
            data.append(inputs[rows])
            target.append(run.states[rows + 1])
            groups.append(np.full(len(rows), len(names)))
            names.append(name if number == 0 else f"{name}, from {run.time[rows[0]] - run.time[0]:.3g} s")
    found = np.concatenate(data)
    units = {name: "rad" if name.startswith("qpos") else "rad/s" for name in state_names}
    return Bunch(
        data=found,
        target=np.concatenate(target),
        groups=np.concatenate(groups),
        group_names=names,
        feature_names=[*state_names, *command_names],
        target_names=state_names,
        units=units | dict.fromkeys(command_names, command_unit),
        hidden=[name for column, name in enumerate(state_names) if np.isnan(found[:, column]).all()],
        dt=dt,
        **facts,
    )


def chosen(what: str, names: str | Sequence[str] | None, known: Sequence[str]) -> list[str]:
    """Return the names that were asked for, all of them by default.

    Raises
    ------
    ValueError
        If one is not known; the message lists those that are.
    """
    wanted = list(known) if names is None else [names] if isinstance(names, str) else list(names)
    if unknown := [name for name in wanted if name not in known]:
        raise ValueError(f"There is no {what} {unknown[0]!r}. There are: {', '.join(known)}.")
    if not wanted:
        raise ValueError(f"No {what} was asked for. There are: {', '.join(known)}.")
    return wanted
