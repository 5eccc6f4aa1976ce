"""Diagnoses of many logs, side by side on all processes, kept as they are done."""

import json
import re
import warnings
from collections.abc import Callable, Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass
from hashlib import sha256
from os import PathLike
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
from joblib import Parallel, delayed
from joblib.externals.loky.process_executor import TerminatedWorkerError

from skat.diagnosis import SimulationDiagnosis
from skat.diagnosis.archive import digest, skat_version
from skat.diagnosis.evidence import Gram
from skat.diagnosis.identifiability import beside_causes
from skat.diagnosis.reading import read_logs
from skat.diagnosis.report.machine import findings_as_data, plain
from skat.diagnosis.saving import has_code, simulator_digest
from skat.effects import Effect
from skat.files import whole
from skat.fleet.drifts import Estimate, discoveries, drifts_of
from skat.logs import Log, load_log
from skat.simulators import Simulator

COLUMNS = (
    *("log", "robot", "time", "verdict", "cause", "value", "low", "high", "unit", "probability", "evidence"),
    *("aliases", "held", "explained", "error", "warnings"),
)
# A file of the store, or a draft of one that a killed process left.
STORED = re.compile(r"\.?[0-9a-f]{32}(-\d+)?\.json")
UNEXPLAINED = "unexplained"
# How often work goes on after a process was killed without that a log was done in between.
TRIES = 2


@dataclass(frozen=True)
class Fleet:
    """What many logs say.

    Attributes
    ----------
    table : DataFrame
        A row for each log and cause, in the order of the logs; a log without a cause has one row. With columns log,
        robot, time, verdict, cause, value, low, high (95 % interval), unit, probability, evidence (nats), aliases,
        held (whether it, or one of its aliases, is among those of which few are false; never where the verdict is
        "unexplained"), explained (share of the excess error on rows that were held out), error (why a log has no
        diagnosis) and warnings.
    drifts : DataFrame
        What changed on a robot from one log to the next, of logs that are not unexplained, likeliest first: robot,
        effect, since (the time of the first log after it; its name where there are no times), before, after, change (a
        ratio of factors, a difference of others), low, high (95 % interval), unit, neutral (of the model as given), p.
    findings : tuple of dict
        Of each log what `skat diagnose --json` writes, but for what belongs to that command (``command``, ``model``,
        ``model_digest``, ``log``, ``mistakes``, ``report`` and ``extended``), or ``error``; and ``warnings``, a list.
    """

    table: pd.DataFrame
    drifts: pd.DataFrame
    findings: tuple[dict[str, Any], ...]

    @property
    def sentences(self) -> tuple[str, ...]:
        """What changed, a sentence each."""
        return tuple(_sentence(one) for one in self.drifts.to_dict("records"))


def diagnose_many(
    logs: Sequence[Any] | Mapping[str, Any],
    simulator: Simulator,
    *,
    names: Sequence[str] | None = None,
    robots: Sequence[str] | None = None,
    times: Sequence[Any] | None = None,
    false_discoveries: float = 0.05,
    store: str | PathLike[str] | None = None,
    reading: Mapping[str, Any] | None = None,
    n_jobs: int | None = None,
    progress: Callable[[str, int, int], None] | None = None,
    **parameters: Any,
) -> Fleet:
    """Diagnose each of many logs by itself, and say what holds of all.

    Parameters
    ----------
    logs : sequence or mapping of path, log, or tuple of (X, y) or (X, y, groups)
        A path is read where it is diagnosed, as `skat.logs.load_log` does; a log as that returns, or as in
        `SimulationDiagnosis.fit`. A mapping gives them names.
    simulator : Simulator
    names : sequence of str, optional
        Of the logs; by default where each was read from, or its number.
    robots : sequence of str, optional
        Whose log each is; by default each is of a robot of its own.
    times : sequence, optional
        When each was measured, in anything that has an order; by default logs of a robot are taken in the order given.
    false_discoveries : float, default=0.05
        Share of false ones in the mean among causes that hold in the table, and among changes over time.
    store : path, optional
        Folder that holds the findings of each log as soon as it is done. What is there of these logs, with this
        simulator, these parameters and this version of skat, is not asked again. A simulator of Python code is known by
        what it does with the first rows of each log, which are read for it.
    reading : mapping, optional
        Keyword arguments of `load_log`.
    n_jobs : int or None, default=None
        Logs at a time; ``joblib.parallel_config(backend="dask")`` takes them to a cluster.
    progress : callable, optional
        ``progress(stage, done, total)``.
    **parameters
        Of `SimulationDiagnosis`; `random_state` is 0 by default, that a log has one answer.

    Returns
    -------
    Fleet
        A log that cannot be read or diagnosed has its error in the table.

    Raises
    ------
    ValueError
        If there is no log, if names, robots or times are not one for each, if a name is there twice, if a time is
        missing or times have no order, or if a parameter is wrong.
    FileExistsError
        If `store` is a file.
    TypeError
        If `logs` is a single path, or names are given of a mapping.
    RuntimeError
        If processes are killed again and again; what was done until then is in `store`.

    Examples
    --------
    >>> from skat.fleet import diagnose_many
    >>> fleet = diagnose_many(sorted(Path("logs").glob("*.mcap")), simulator, n_jobs=-1)  # doctest: +SKIP
    >>> fleet.table[fleet.table.held]  # doctest: +SKIP
    """
    if isinstance(logs, str | PathLike):
        raise TypeError(f"logs is one path, {str(logs)!r}; pass a list, such as sorted(Path(...).glob(...)).")
    if isinstance(logs, Mapping):
        if names is not None:
            raise TypeError("names are those of the mapping; pass a list of logs to give others.")
        names, logs = [str(name) for name in logs], list(logs.values())
    logs = [tuple(log) if isinstance(log, list) else log for log in logs]
    if not logs:
        raise ValueError("there is no log; expected a sequence of paths, logs, or tuples of (X, y, groups).")
    names = _checked(
        "names", [_name(log, at) for at, log in enumerate(logs)] if names is None else names, len(logs)
    )
    if len(set(names)) < len(names):
        twice = next(name for name in names if names.count(name) > 1)
        raise ValueError(f"two logs have the name {twice!r}: give each one of its own (names=).")
    owners = names if robots is None else _checked("robots", robots, len(logs))
    moments = None if times is None else _checked("times", times, len(logs))
    if moments is not None:
        _check_order(moments, names)
    if not 0 < false_discoveries < 1:
        raise ValueError(f"false_discoveries is a share between 0 and 1; it is {false_discoveries!r}.")
    parameters = {"random_state": 0, **parameters}
    asked = SimulationDiagnosis(simulator, **parameters)
    asked._check_parameters()
    asked._chosen_effects()
    reading = dict(reading or {})
    files = [None] * len(logs) if store is None else _files(Path(store), logs, simulator, parameters, reading)
    findings = _all_findings(logs, files, simulator, parameters, reading, n_jobs, progress)
    table = _table(names, owners, moments, findings, false_discoveries)
    drifts = _drifts(simulator, table, names, owners, moments, findings, false_discoveries)
    told = tuple({name: one for name, one in found.items() if name != "gram"} for found in findings)
    return Fleet(table, drifts, told)


def _checked(what: str, given: Sequence[Any], n: int) -> list[Any]:
    if len(given) != n:
        raise ValueError(f"{what} must be one for each log: {n}; got {len(given)}.")
    return list(given)


def _check_order(times: Sequence[Any], names: Sequence[str]) -> None:
    missing = [name for name, one in zip(names, times) if one is None or one is pd.NA or one != one]
    if missing:
        raise ValueError(
            f"{missing[0]} has no time: give one of each log, or none, for logs in the order given."
        )
    try:
        sorted(times)
    except TypeError as error:
        raise ValueError(f"times must have an order: {error}.") from error


def _name(log: Any, at: int) -> str:
    if isinstance(log, str | PathLike):
        return str(log)
    return (log.source if isinstance(log, Log) else "") or f"log {at}"


# -- asking ----------------------------------------------------------------------------------------------------------


def _all_findings(
    logs: Sequence[Any],
    files: Sequence[Path | None],
    simulator: Simulator,
    parameters: Mapping[str, Any],
    reading: Mapping[str, Any],
    n_jobs: int | None,
    progress: Callable[[str, int, int], None] | None,
) -> list[dict[str, Any]]:
    """Return the findings of each log: those that are in its file, and those that are made now."""
    kept = [(at, _kept(file)) for at, file in enumerate(files)]
    done = {at: found for at, found in kept if found is not None}
    tell = progress or (lambda *_: None)
    tell("logs", len(done), len(logs))
    tries = TRIES
    while len(done) < len(logs):
        before = len(done)
        left = [(at, log) for at, log in enumerate(logs) if at not in done]
        try:
            for at, found in _asked(left, simulator, parameters, reading, n_jobs):
                done[at] = found
                file = files[at]
                if file is not None and "error" not in found:  # which may be gone the next time
                    with whole(file) as draft:
                        draft.write_text(json.dumps(found, allow_nan=False), encoding="utf-8")
                tell("logs", len(done), len(logs))
        except TerminatedWorkerError as error:
            tries = TRIES if len(done) > before else tries - 1
            if not tries:
                raise RuntimeError(
                    f"processes were killed again and again, with {len(logs) - len(done)} of {len(logs)} logs left: is "
                    "there memory for so many at a time (n_jobs)? With store= the others need not be asked again."
                ) from error
            warnings.warn("A process was killed; the logs that are not done are asked again.", stacklevel=3)
    return [done[at] for at in range(len(logs))]


def _asked(
    logs: Sequence[tuple[int, Any]],
    simulator: Simulator,
    parameters: Mapping[str, Any],
    reading: Mapping[str, Any],
    n_jobs: int | None,
) -> Iterator[tuple[int, dict[str, Any]]]:
    """Yield which log is done, and its findings, as they come."""
    work = Parallel(n_jobs=n_jobs, return_as="generator_unordered", batch_size=1)
    yield from work(delayed(_findings)(at, log, simulator, parameters, reading) for at, log in logs)


def _findings(
    at: int, log: Any, simulator: Simulator, parameters: Mapping[str, Any], reading: Mapping[str, Any]
) -> tuple[int, dict[str, Any]]:
    with warnings.catch_warnings(record=True) as told:
        warnings.simplefilter("always")
        try:
            found = _diagnosed(log, simulator, parameters, reading)
        except Exception as error:  # a reader may raise anything, and the others go on
            found = {"error": f"{type(error).__name__}: {error}"}
    return at, {**found, "warnings": list(dict.fromkeys(str(one.message) for one in told))}


def _diagnosed(
    log: Any, simulator: Simulator, parameters: Mapping[str, Any], reading: Mapping[str, Any]
) -> dict[str, Any]:
    if isinstance(log, str | PathLike):
        log = load_log(log, simulator, **reading)
    if isinstance(log, Log):
        simulator = log.simulator
    elif not isinstance(log, tuple):
        raise TypeError(
            f"expected a path, a log, or a tuple of (X, y) or (X, y, groups); got {type(log).__name__}."
        )
    diagnosis = SimulationDiagnosis(simulator, **parameters).fit([log])
    gram = {"names": diagnosis._found.priors.names, **vars(diagnosis._found.gram)}
    found: dict[str, Any] = plain({**findings_as_data(diagnosis), "gram": gram})
    return found


# -- the store -------------------------------------------------------------------------------------------------------


def clear_store(store: Path) -> None:
    """Delete the findings in a store, and its folder where it holds nothing else."""
    for file in list(store.iterdir()):
        if STORED.fullmatch(file.name):
            file.unlink()
    if not any(store.iterdir()):
        store.rmdir()


def _files(
    store: Path,
    logs: Sequence[Any],
    simulator: Simulator,
    parameters: Mapping[str, Any],
    reading: Mapping[str, Any],
) -> list[Path | None]:
    """Return where each log's findings are kept, by all that they depend on; None of a log that cannot be read."""
    if store.exists() and not store.is_dir():
        raise FileExistsError(f"{store} is a file; findings are kept in a folder of that name. Move it away.")
    store.mkdir(parents=True, exist_ok=True)
    asked = digest(dict(parameters)), digest(dict(reading)), skat_version()
    files: list[Path | None] = []
    for log in logs:
        try:
            with warnings.catch_warnings(action="ignore"):  # said again where it is diagnosed
                about = *asked, _simulator_of(log, simulator, reading), _content(log)
            files.append(store / f"{sha256(repr(about).encode()).hexdigest()[:32]}.json")
        except Exception:  # told where it is diagnosed
            files.append(None)
    return files


def _kept(file: Path | None) -> dict[str, Any] | None:
    """Return the findings in a file; None where it is not there, or whole."""
    try:
        found = None if file is None else json.loads(file.read_text(encoding="utf-8"))
    except (OSError, ValueError):
        return None
    return found if isinstance(found, dict) and {"verdict", "gram"} <= found.keys() else None


def _simulator_of(log: Any, simulator: Simulator, reading: Mapping[str, Any]) -> str:
    """Return a digest of a log's simulator; one of Python code is known by what it does with the log's first rows."""
    if isinstance(log, Log):
        simulator = log.simulator
    if not has_code(simulator):
        return simulator_digest(simulator, None)
    if isinstance(log, str | PathLike):
        log = load_log(log, simulator, **reading)
        simulator = log.simulator
    return simulator_digest(simulator, read_logs(simulator, [log], None, None, None, "commanded").log)


def _content(log: Any) -> str:
    """Return a digest of what a log holds."""
    if isinstance(log, str | PathLike):
        path = Path(log)
        found = sha256()
        for file in sorted(path.rglob("*")) if path.is_dir() else [path] if path.exists() else []:
            if file.is_file():
                found.update(str(file.relative_to(path)).encode() + file.read_bytes())
        return f"{path} {found.hexdigest()}"
    if isinstance(log, Log):
        return digest((log.X, log.y, log.groups, log.floor, log.actions))
    return digest(tuple(_named_columns(part) for part in log))


def _named_columns(part: Any) -> tuple[list[str], Any]:
    """Return the names of an array's columns, where it has some, and the array; labels of any kind as text."""
    array = np.asarray(part)
    return [str(name) for name in getattr(part, "columns", ())], (
        array.astype(str) if array.dtype.hasobject else array
    )


# -- telling ---------------------------------------------------------------------------------------------------------


def _table(
    names: Sequence[str],
    robots: Sequence[str],
    times: Sequence[Any] | None,
    findings: Sequence[Mapping[str, Any]],
    rate: float,
) -> pd.DataFrame:
    rows, likely = [], []
    for name, robot, time, found in zip(names, robots, times or [None] * len(names), findings):
        shared = {"log": name, "robot": robot, "time": time, "error": found.get("error")}
        shared["warnings"] = " ".join(found.get("warnings", ())) or None
        if "error" not in found:
            gain = found["gain"]
            shared |= {"verdict": found["verdict"], "explained": None if gain is None else gain["explained"]}
        causes = [
            {
                "cause": cause["name"],
                "value": cause["value"],
                "low": cause["interval"][0],
                "high": cause["interval"][1],
                **{key: cause[key] for key in ("unit", "probability", "evidence")},
                "aliases": ", ".join(alias["name"] for alias in cause["aliases"]),
            }
            for cause in found.get("causes", ())
        ]
        rows += [{**shared, **cause} for cause in causes or [{}]]
        # What is named beside something that no effect explains may stand for it.
        if found.get("verdict") != UNEXPLAINED:
            likely += [_chance(cause) for cause in found.get("causes", ())]
    table = pd.DataFrame(rows, columns=list(COLUMNS))
    for name in ("value", "low", "high", "probability", "evidence", "explained"):
        table[name] = table[name].astype(float)
    named = (table["cause"].notna() & (table["verdict"] != UNEXPLAINED)).to_numpy()
    held = np.zeros(len(table), dtype=bool)
    held[named] = discoveries(np.array(likely), rate)
    table["held"] = held
    return table


def _chance(cause: Mapping[str, Any]) -> float:
    """Return the probability that a cause acts, or one of the effects that may be behind it."""
    return min(1.0, float(sum(one["probability"] for one in (cause, *cause["aliases"]))))


def _drifts(
    simulator: Simulator,
    table: pd.DataFrame,
    names: Sequence[str],
    robots: Sequence[str],
    times: Sequence[Any] | None,
    findings: Sequence[Mapping[str, Any]],
    rate: float,
) -> pd.DataFrame:
    """Return what changed on robots of several logs, of what holds in one of their logs at least."""
    effects: dict[str, Effect] = {effect.name: effect for effect in simulator.effects(also="all")}
    held = table[table["held"]]
    estimates, moments, asked = {}, {}, {}
    for robot in dict.fromkeys(robots):
        own = [
            at
            for at, one in enumerate(robots)
            if one == robot and findings[at].get("verdict", UNEXPLAINED) != UNEXPLAINED
        ]
        if len(own) < 2:
            continue
        if times is not None:
            own.sort(key=times.__getitem__)
        causes = held.loc[held["robot"] == robot, "cause"]
        asked[robot] = [name for name in dict.fromkeys(causes) if name in effects]
        # Beside the causes of all its logs: beside its own alone, each log would be read with another model.
        named = {cause["name"] for at in own for cause in findings[at]["causes"]}
        estimates[robot] = [_estimates(findings[at]["gram"], named) for at in own]
        moments[robot] = [(times or names)[at] for at in own]
    return drifts_of(estimates, moments, effects, asked, rate=rate)


def _estimates(told: Mapping[str, Any], causes: Collection[str]) -> dict[str, Estimate]:
    """Return what a log says of each effect that it shows beside causes."""
    names = told["names"]
    gram = Gram(*(np.array(told[part]) for part in ("products", "projections", "origin")))
    places, errors = beside_causes(gram, [at for at, name in enumerate(names) if name in causes])
    return {
        name: Estimate(places[at], errors[at]) for at, name in enumerate(names) if np.isfinite(errors[at])
    }


def _sentence(drift: Mapping[str, Any]) -> str:
    unit = "" if drift["unit"] in ("", "1") else f" {drift['unit']}"
    # Of what is 0 in the model, a share of the value before says nothing.
    shared = drift["neutral"] != 0 and drift["before"] > 0
    share = f" ({100 * (drift['after'] / drift['before'] - 1):+.0f} %)" if shared else ""
    return (
        f"{drift['robot']}: {drift['effect']} went from {drift['before']:.3g} to {drift['after']:.3g}{unit}"
        f"{share}, first seen at {drift['since']}."
    )
