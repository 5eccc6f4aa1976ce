"""A diagnosis with its test on data that it did not use, for the data sets of skat and a user's log."""

import warnings
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from os import PathLike
from types import SimpleNamespace
from typing import Any

import numpy as np
import pandas as pd
from sklearn.utils import Bunch

from skat.datasets import (
    ball_drop_simulator,
    cube_toss_simulator,
    fetch_ball_drops,
    fetch_cube_tosses,
    fetch_pendulum,
    make_hidden_puck,
    pendulum_simulator,
    split_episodes,
)
from skat.datasets.ball_drops import BALLS
from skat.diagnosis import Gain, SimulationDiagnosis, compare_transports
from skat.diagnosis.log import check_log, measured_channels
from skat.diagnosis.report.sentences import horizon_text
from skat.simulators import make_simulator

# What differs from ball to ball. Gravity, the scale of the camera and the wind were the same for all of
# them, and the heavy balls show that they were as in the simulation; the joint stands for the way through
# the air and has no bearing.
BALL_EFFECTS = ["air_drag[z]", "damping[z]"]


@dataclass(frozen=True)
class Study:
    """A diagnosis, and what it gains on data that it did not use.

    Attributes
    ----------
    title : str
        What was measured.

    diagnosis : SimulationDiagnosis
        Fitted.

    gain : Gain or None
        Measured on the data set aside; None if there are none, or if the simulation diverges there.

    error_name : str
        What the numbers of `gain` are, with their unit.

    errors : DataFrame or None
        Columns method and error: the error of one step on the data set aside, for the simulation, for maps
        that carry its output onto the measurement, and for the extended simulation. None of a first look (`quick`),
        and where no row was measured as a whole.

    truth : str or None
        What differed between the simulation and the measured world, where that is known.
    """

    title: str
    diagnosis: SimulationDiagnosis
    gain: Gain | None
    error_name: str
    errors: pd.DataFrame | None
    truth: str | None = None


def study_hidden_puck(
    *,
    n_shots: int = 120,
    random_state: Any = 0,
    progress: Callable[[str, int, int], None] | None = None,
    **parameters: Any,
) -> Study:
    """Diagnose the puck simulator on shots "measured" in a world that differs from it.

    Parameters
    ----------
    n_shots : int, default=120
        Number of strikes, one half to fit and one half to test.

    random_state : int, default=0
        Seed of the strikes, the noise and the diagnosis.

    progress : callable, default=None
        Called with (stage, done, total) as the work proceeds.

    **parameters : dict
        Further parameters of `SimulationDiagnosis`.

    Returns
    -------
    Study
        With the gain on the half not used.
    """
    shots = make_hidden_puck(n_shots, random_state=random_state)
    fit, test = split_episodes(shots, test_size=0.5, random_state=random_state)
    names = " and ".join(f"{name} = {value:.3g}" for name, value in shots.truth.items())
    return _study(
        "Puck shots",
        make_simulator("puck"),
        fit,
        test,
        random_state,
        progress,
        truth=f"{names}. {shots.truth_sentence}",
        **parameters,
    )


def study_ball_drops(
    balls: str | Sequence[str] | None = None,
    *,
    data_home: str | PathLike[str] | None = None,
    random_state: Any = 0,
    progress: Callable[[str, int, int], None] | None = None,
    **parameters: Any,
) -> dict[str, Any]:
    """Diagnose free fall on drop 1 of each ball, and measure the gain on drop 2.

    Parameters
    ----------
    balls : sequence of str, default=None
        Names of balls. None means all.

    data_home, random_state, progress, **parameters
        See `fetch_ball_drops` and `SimulationDiagnosis`.

    Returns
    -------
    dict of str to Study
        By ball. Unless `effects` says otherwise, only drag is considered, which differs from ball to ball.
        The gain is on the trajectory in m, start height and speed fitted for both models.
    """
    balls = list(BALLS) if balls is None else list(balls)
    fetch_ball_drops(balls, data_home=data_home)
    parameters = {"effects": BALL_EFFECTS, **parameters}
    studies = {}
    for done, ball in enumerate(balls):
        if progress is not None:
            progress("balls", done, len(balls))
        first, second = (fetch_ball_drops(ball, drops=drop, data_home=data_home) for drop in (1, 2))
        studies[ball] = _study(
            ball,
            ball_drop_simulator(ball),
            first,
            second,
            random_state,
            progress,
            evaluation={"horizon": "episode", "initial_state": "fitted"},
            error_name="trajectory error, m",
            **parameters,
        )
    return studies


def ball_drop_table(studies: Mapping[str, Any]) -> pd.DataFrame:
    """Return one row for each ball: what was named, and the trajectory error on the drop not used.

    Parameters
    ----------
    studies : dict of str to Study
        As `study_ball_drops` returns them.

    Returns
    -------
    DataFrame
        Columns ball, cause, value, unit, aliases, nominal, extended, times smaller.
    """
    rows = []
    for ball, study in studies.items():
        causes = study.diagnosis.causes_
        rows.append(
            {
                "ball": ball,
                "cause": ", ".join(cause.name for cause in causes) or "-",
                "value": ", ".join(f"{cause.value:.3g} {cause.unit}" for cause in causes),
                "aliases": ", ".join(alias.name for cause in causes for alias in cause.aliases),
                "nominal": study.gain.nominal,
                "extended": study.gain.extended,
                "times smaller": study.gain.ratio,
            }
        )
    return pd.DataFrame(rows)


def study_cube_tosses(
    *,
    n_fit: int = 5,
    n_test: int = 50,
    data_home: str | PathLike[str] | None = None,
    random_state: Any = 0,
    progress: Callable[[str, int, int], None] | None = None,
    **parameters: Any,
) -> Study:
    """Diagnose a default cube on some tosses, and measure the gain on others.

    Parameters
    ----------
    n_fit : int, default=5
    n_test : int, default=50
        Numbers of tosses, drawn at random from the 570.
    data_home, random_state, progress, **parameters
        See `fetch_cube_tosses` and `SimulationDiagnosis`.

    Returns
    -------
    Study
        The gain is on the trajectory from the measured first state. Unless `effects` says otherwise, the time step is
        not considered: the velocities are differences of the places between frames, which are those of a simulation
        with a step for each frame.
    """
    simulator = cube_toss_simulator()
    effects = [effect.name for effect in simulator.effects() if effect.family != "timestep"]
    parameters = {"effects": effects, **parameters}
    drawn = np.random.default_rng(random_state).permutation(570)[: n_fit + n_test]
    fit, test = (
        fetch_cube_tosses(np.sort(part), data_home=data_home) for part in (drawn[:n_fit], drawn[n_fit:])
    )
    return _study(
        f"Cube tosses ({n_fit} to fit, {n_test} others to test)",
        simulator,
        fit,
        test,
        random_state,
        progress,
        evaluation={"horizon": "episode", "outputs": [f"qpos.cube.{axis}" for axis in "xyz"]},
        error_name="trajectory error of the centre, m",
        **parameters,
    )


def study_pendulum(
    *,
    seconds: float = 0.5,
    test_size: float = 0.4,
    data_home: str | PathLike[str] | None = None,
    random_state: Any = 0,
    progress: Callable[[str, int, int], None] | None = None,
    **parameters: Any,
) -> Study:
    """Diagnose a motor-driven pendulum on some pieces of its swing-up, and measure the gain on the others.

    Parameters
    ----------
    seconds : float, default=0.5
        Length of the pieces.

    test_size : float, default=0.4
        Share of the pieces that measure the gain.

    data_home, random_state, progress, **parameters
        See `fetch_pendulum` and `SimulationDiagnosis`.

    Returns
    -------
    Study
        The gain is on the angle in rad in open loop, start angle and speed fitted for both models.
    """
    fit, test = split_episodes(
        fetch_pendulum(seconds=seconds, data_home=data_home), test_size=test_size, random_state=random_state
    )
    return _study(
        "Pendulum",
        pendulum_simulator(),
        fit,
        test,
        random_state,
        progress,
        evaluation={"horizon": "episode", "initial_state": "fitted"},
        error_name="error of the angle in open loop, rad",
        **parameters,
    )


def study_log(
    log: Any,
    *,
    test: Any = None,
    test_size: float = 0.3,
    random_state: Any = 0,
    progress: Callable[[str, int, int], None] | None = None,
    **parameters: Any,
) -> Study:
    """Diagnose a log's simulator on a part of the log, and measure the gain on the rest.

    Parameters
    ----------
    log : Log
        As `load_log` returns it. Channels that were not measured are hidden; single readings may be missing.
        Of several files each has noise of its own.

    test : Log, default=None
        Another log, of the same simulator, that measures the gain; all of `log` is fitted then.

    test_size : float, default=0.3
        Part of the log that measures the gain; 0: all of it is fitted, and the gain is None.

    random_state, progress, **parameters
        See `SimulationDiagnosis`.

    Returns
    -------
    Study
        The gain is at the diagnosis's horizon, in units of a right model's errors; with `hidden` channels, in those of
        whole episodes in open loop, as far as they were measured, from fitted initial states.
    """
    if test is not None and set(test.unmeasured) - set(log.unmeasured):
        raise ValueError(
            f"{test.source} lacks {', '.join(test.unmeasured)}, which {log.source} has: both are compared in what both "
            "have. Leave these channels out of the first log as well (--map 'NAME=-')."
        )
    floor = log.floor
    if parameters.get("actions", "auto") == "auto":
        parameters["actions"] = log.actions
    log, parameters = _as_rows(log, parameters)
    if test is not None:
        fit, (test, _) = log, _as_rows(test, parameters)
    elif test_size == 0:
        fit, test = log, None
    else:
        fit, test = split_episodes(log, test_size=test_size, random_state=random_state)
    if hidden := parameters.get("hidden"):
        names = np.array(log.simulator.residual_names)[measured_channels(log.simulator, hidden)]
        units = {log.simulator.units.get(name, "") for name in names}
        ending = (
            " together, whose units differ"
            if len(units) > 1
            else "".join(f", {unit}" for unit in units if unit)
        )
        parameters |= {
            "evaluation": {"horizon": "episode", "initial_state": "fitted"},
            "error_name": f"trajectory error, all measured channels{ending}",
        }
    return _study("Log", log.simulator, fit, test, random_state, progress, floor=floor, **parameters)


def _as_rows(log: Any, parameters: Any) -> Any:
    """Return a log's rows, NaN where a reading is missing, and the parameters that name what was never measured."""
    X, y = log.X.copy(), log.y.copy()
    lacking = [log.simulator.state_names.index(name) for name in log.unmeasured]
    X[:, lacking] = y[:, lacking] = 0.0
    log = replace(log, X=X, y=y)
    hidden = tuple(
        dict.fromkeys(
            (*parameters.get("hidden", ()), *(log.simulator.state_names[column] for column in lacking))
        )
    )
    rows = {"data": log.X, "target": log.y, "groups": log.groups}
    return Bunch(**rows, origins=log.origins, origin_names=log.origin_names, simulator=log.simulator), (
        parameters | {"hidden": hidden} if hidden else parameters
    )


def _each(fit: Bunch, floor: Any) -> list[Any]:
    """Return the logs that were joined, each by itself; those of which no row is left are left out."""
    logs = []
    for number, name in enumerate(fit.origin_names):
        own = fit.origins == number
        if own.any():
            X, y, groups = (fit[one][own] for one in ("data", "target", "groups"))
            logs.append(SimpleNamespace(X=X, y=y, groups=groups, floor=floor, source=name))
    return logs


def _has_whole_rows(rows: Any) -> bool:
    return bool((np.isfinite(rows.data).all(axis=1) & np.isfinite(rows.target).all(axis=1)).any())


def _study(
    title: str,
    simulator: Any,
    fit: Any,
    test: Any,
    random_state: Any,
    progress: Callable[[str, int, int], None] | None,
    *,
    evaluation: dict[str, Any] | None = None,
    error_name: str = "",
    truth: Any = None,
    floor: Any = None,
    **parameters: Any,
) -> Study:
    parameters = {"hidden": fit.get("hidden", ()), **parameters}
    diagnosis = SimulationDiagnosis(simulator, test_size=0, random_state=random_state, **parameters)
    if fit.get("origins") is None:
        diagnosis.fit(fit.data, fit.target, groups=fit.get("groups"), floor=floor, progress=progress)
    else:
        diagnosis.fit(_each(fit, floor), progress=progress)
    if test is None:
        return Study(title, diagnosis, None, error_name, None, truth)
    if diagnosis.quick:
        few = check_log(simulator, test.data, test.target, test.get("groups"), fewest_rows=1).few()
        test = Bunch(data=few.X, target=few.y, groups=few.episodes if few.n_episodes < len(few) else None)
    try:
        gain = diagnosis.evaluate(test.data, test.target, test.get("groups"), **(evaluation or {}))
        errors = None
        # Maps take longer than a first look, and whole rows.
        if not diagnosis.quick and _has_whole_rows(fit) and _has_whole_rows(test):
            errors = compare_transports(
                diagnosis,
                fit.data,
                fit.target,
                test.data,
                test.target,
                groups_fit=fit.get("groups"),
                groups_test=test.get("groups"),
                random_state=random_state,
            )
    except RuntimeError as error:  # The simulation diverges; what was found is not lost for that.
        warnings.warn(f"The gain could not be measured on the data set aside. {error}", stacklevel=3)
        return Study(title, diagnosis, None, error_name, None, truth)
    if not error_name:
        error_name = f"squared error, {horizon_text(simulator, gain.horizon)}, in units of a right model's"
    diagnosis.report_.add_test(title, test.data, test.target, test.get("groups"), gain=gain, errors=errors)
    return Study(title, diagnosis, gain, error_name, errors, truth)
