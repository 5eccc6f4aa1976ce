"""A fitted diagnosis in a file, and the state of a search, from which an interrupted fit goes on."""

import warnings
from collections.abc import Mapping
from dataclasses import dataclass, fields, is_dataclass, replace
from os import PathLike
from pathlib import Path
from typing import Any

import numpy as np

from skat.diagnosis.archive import bare, digest, opened, skat_version, write_archive
from skat.diagnosis.causes import Search
from skat.diagnosis.chains import Array, Places
from skat.diagnosis.log import Log
from skat.diagnosis.noise import Noise
from skat.diagnosis.report.from_diagnosis import DiagnosisReport
from skat.effects import Effect
from skat.files import writable
from skat.simulators import MujocoSimulator, Simulator
from skat.simulators.puck import PuckSimulator

DIAGNOSIS, SEARCH = "saved diagnosis", "search to resume"
# Simulators that are text and numbers, and so can be written.
WRITTEN: Mapping[str, type[Simulator]] = {one.__name__: one for one in (MujocoSimulator, PuckSimulator)}
# Rows whose outputs tell one simulation from another, and how near these have to be: rounding differs between machines.
PROBES, SAME = 20, 1e-6
# What is made anew as a diagnosis is loaded.
REMADE = ("report_", "extended_simulator_")
# Parameters on which no answer depends.
IDLE = ("simulator", "n_jobs")


# -- a diagnosis -----------------------------------------------------------------------------------------------------


def write_diagnosis(diagnosis: Any, path: str | PathLike[str], *, force: bool) -> Path:
    """Write a fitted `SimulationDiagnosis`; see its `save`."""
    target = writable(path, force=force)
    parameters = diagnosis.get_params(deep=False)
    simulator, report = parameters.pop("simulator"), diagnosis.report_
    # How scikit-learn routes metadata to `fit` is of the session.
    left_out = {*parameters, "simulator", "_metadata_request", *REMADE}
    attributes = {name: value for name, value in vars(diagnosis).items() if name not in left_out}
    found = attributes["_found"]
    attributes["_found"] = replace(found, fitted=_without_rows(found.fitted))
    parts = {
        "simulator": vars(SavedSimulator.of(simulator, report.log)),
        "parameters": parameters,
        "attributes": attributes,
        "log": _with_plain_labels(report.log),
        "tests": [replace(one, log=_with_plain_labels(one.log)) for one in report.tests],
        "content": report.content,
    }
    write_archive(target, DIAGNOSIS, parts)
    return target


def read_diagnosis(kind: type, path: str | PathLike[str], given: Simulator | None) -> Any:
    """Return a diagnosis of a class; see the `load` of `SimulationDiagnosis`."""
    path = Path(path)
    with opened(path, DIAGNOSIS) as archive:
        simulator = SavedSimulator(**archive.read("simulator")).restored(given, path)
        parameters, attributes, log, tests, content = (
            archive.read(part, simulator) for part in ("parameters", "attributes", "log", "tests", "content")
        )
    diagnosis = kind(simulator, **parameters)
    vars(diagnosis).update(attributes)
    diagnosis.extended_simulator_ = simulator.extended(attributes["_values"])
    diagnosis.report_ = DiagnosisReport.restored(diagnosis, log, tests, content)
    return diagnosis


def _without_rows(part: Any) -> Any:
    """Return a fit of no row, with the laws of its noise, which are all that other logs ask for: no path and slopes."""
    if isinstance(part, Noise):
        return part.unseen()
    if isinstance(part, np.ndarray):
        return part[:0] if part.ndim > 1 else part
    if not is_dataclass(part) or isinstance(part, type):
        return part
    return replace(part, **{one.name: _without_rows(getattr(part, one.name)) for one in fields(part)})


def _with_plain_labels(log: Log) -> Log:
    """Return the log with episodes called by numbers or text."""
    if log.labels is None:
        return log
    return replace(
        log, labels=tuple(one if isinstance(one, str | int | float) else str(one) for one in log.labels)
    )


# -- its simulator ---------------------------------------------------------------------------------------------------


@dataclass(frozen=True)
class SavedSimulator:
    """A simulator as a file has it, and what tells another one from it.

    `kind`: name of its class. `parameters`: of its constructor; None of one that is Python code. `rows` (n_probes,
    n_inputs): inputs of the first rows of the log, guesses where nothing was measured. `groups` (n_probes,). `outputs`
    (n_probes, n_outputs): what it makes of them; NaN where it diverges.
    """

    kind: str
    parameters: dict[str, Any] | None
    input_names: tuple[str, ...]
    output_names: tuple[str, ...]
    state_names: tuple[str, ...]
    effects: tuple[Effect, ...]
    rows: Array
    groups: Places
    outputs: Array

    @classmethod
    def of(cls, simulator: Simulator, log: Log) -> "SavedSimulator":
        """Return what is saved of a simulator, with a few rows of a log to know it by."""
        rows, groups = log.filled.X[:PROBES], log.groups[:PROBES]
        return cls(
            type(simulator).__name__,
            _parameters(simulator),
            tuple(simulator.input_names),
            tuple(simulator.output_names),
            tuple(simulator.state_names),
            tuple(bare(effect) for effect in simulator.effects(also="all")),
            rows,
            groups,
            _outputs(simulator, rows, groups),
        )

    def restored(self, given: Simulator | None, path: Path) -> Simulator:
        """Return the simulator that was saved, or the given one if it is the same.

        Raises a ValueError if it is not, or none was given and none can be made.
        """
        if given is None and self.parameters is None:
            raise ValueError(
                f"{path} does not hold its simulator, a {self.kind} with Python code, which no file of data can. "
                "Pass simulator=, the one that was diagnosed."
            )
        simulator = WRITTEN[self.kind](**self.parameters) if given is None else given  # type: ignore[arg-type]
        difference = self.difference(simulator)
        if difference and given is not None:
            raise ValueError(
                f"simulator is not the one that was diagnosed in {path}: {difference}. Pass that one, with what was "
                "built in then."
            )
        if difference:
            warnings.warn(
                f"The simulator in {path} is not what it was: {difference}. Another version of MuJoCo may be the "
                "reason.",
                UserWarning,
                stacklevel=4,
            )
        return simulator

    def difference(self, simulator: Simulator) -> str:
        """Return in words in what a simulator is another one; nothing if it is the same."""
        for what in ("input_names", "output_names", "state_names"):
            own, other = getattr(self, what), tuple(getattr(simulator, what))
            if own != other:
                return f"its {what} are {', '.join(other) or 'none'} and were {', '.join(own) or 'none'}"
        known = {effect.name: effect for effect in simulator.effects(also="all")}
        missing = [one.name for one in self.effects if one.name not in known]
        if missing:
            return f"it has no {', '.join(missing[:5])}{' ...' if len(missing) > 5 else ''}"
        for one in self.effects:
            now = known[one.name]
            if not is_like(one, now):
                return (
                    f"{one.name} is in {now.unit}, neutral at {now.neutral:g}, bounds {now.bounds}, and was in "
                    f"{one.unit}, neutral at {one.neutral:g}, bounds {one.bounds}"
                )
        outputs = _outputs(simulator, self.rows, self.groups)
        spread = 1 + np.abs(self.outputs)
        same = np.abs(outputs - self.outputs) <= SAME * spread
        same |= np.isnan(outputs) & np.isnan(self.outputs)
        if not same.all():
            row, column = np.argwhere(~same)[0]
            return (
                f"in row {row} of the log it predicts {outputs[row, column]:g} for {self.output_names[column]}, and "
                f"predicted {self.outputs[row, column]:g}"
            )
        return ""


def is_like(one: Effect, other: Effect) -> bool:
    """Whether values of an effect mean what those of another one do."""
    numbers = (one.neutral, *one.bounds), (other.neutral, *other.bounds)
    return one.unit == other.unit and np.allclose(*numbers, rtol=1e-6, atol=1e-12)


def _parameters(simulator: Simulator) -> dict[str, Any] | None:
    parameters = dict(simulator.get_params(deep=False))
    if type(simulator) not in WRITTEN.values() or parameters.get("extra_effects"):
        return None
    return parameters


def has_code(simulator: Simulator) -> bool:
    """Whether a simulator, or an effect of it, is Python code."""
    return _parameters(simulator) is None


def simulator_digest(simulator: Simulator, log: Log | None) -> str:
    """Return a digest of what a simulator was made of; of one with Python code, also of what that does.

    Code itself says little, as what it calls may have changed: its outputs for the first rows of a log are known, and
    those with a typical size of each effect that is code. One without code needs no log.
    """
    made = simulator.get_params(deep=False)
    if log is None or not has_code(simulator):
        return digest(made)
    known = vars(replace(SavedSimulator.of(simulator, log), parameters=None))
    own = made.get("extra_effects") or simulator.effects(also="all")
    sizes = [{one.name: _typical(one)} for one in own]
    outputs = simulator.predict_many(known["rows"], sizes, groups=known["groups"])
    try:
        written = digest(made)
    except TypeError:  # a function, of which the outputs tell
        written = ""
    return digest((written, known, outputs))


def _typical(effect: Effect) -> float:
    """Return a value of an effect that is a typical size from neutral, or less where its bounds are."""
    low, high = effect.bounds
    if high > effect.neutral:
        return min(effect.neutral + effect.typical, high)
    return max(effect.neutral - effect.typical, low)


def _outputs(simulator: Simulator, rows: Array, groups: Places) -> Array:
    outputs: Array = simulator.predict_many(rows, [{}], groups=groups)[0]
    return outputs


# -- a search --------------------------------------------------------------------------------------------------------


@dataclass(frozen=True)
class Begun:
    """A fit that has begun: what was drawn, and how far the search has come."""

    fitted: Log
    held_out: Log | None
    random_state: np.random.RandomState
    search: Search | None = None


class Checkpoint:
    """The file from which an interrupted fit goes on.

    `log`: checked, before rows are held out. `floor` (d,): least variance of each channel's noise. Raises a
    FileNotFoundError if there is no folder to write it into.
    """

    def __init__(self, path: str | PathLike[str], diagnosis: Any, log: Log, floor: Array) -> None:
        self._path = writable(path, force=True)
        self._simulator: Simulator = diagnosis.simulator
        parameters = diagnosis.get_params(deep=False)
        if not isinstance(parameters["random_state"], int | np.integer):
            parameters["random_state"] = None  # what was drawn is kept
        self._parameters = {name: value for name, value in parameters.items() if name not in IDLE}
        self._about: dict[str, Any] = {
            "log": digest((_with_plain_labels(log), floor)),
            "simulator": vars(replace(SavedSimulator.of(self._simulator, log), parameters=None)),
            "model": simulator_digest(self._simulator, log),
            "parameters": self._parameters,
        }

    def resumed(self, begun: Begun) -> Begun:
        """Return where to go on: what the file says if it is there.

        Raises a ValueError if the file is damaged, or of another log, simulator, setting or version of skat.
        """
        if not self._path.exists():
            return begun
        with opened(self._path, SEARCH) as archive:
            if archive.skat != skat_version():
                raise self._unfit(f"it was written by skat {archive.skat}; this is skat {skat_version()}")
            if archive.read("log") != self._about["log"]:
                raise self._unfit("it is of another log, or one of which other channels were left out")
            difference = SavedSimulator(**archive.read("simulator")).difference(self._simulator)
            if not difference and archive.read("model") != self._about["model"]:
                difference = "its model has another text or other parameters"
            if difference:
                raise self._unfit(f"it is of another simulator: {difference}")
            parameters = archive.read("parameters", self._simulator)
            for name, value in self._parameters.items():
                if digest(parameters.get(name)) != digest(value):
                    raise self._unfit(f"{name} is {value!r:.80} and was {parameters.get(name)!r:.80}")
            return Begun(**archive.read("begun", self._simulator))

    def write(self, begun: Begun, search: Search) -> None:
        """Write how far a search has come."""
        logs = {"fitted": begun.fitted, "held_out": begun.held_out}
        plain = {name: log and _with_plain_labels(log) for name, log in logs.items()}
        write_archive(self._path, SEARCH, {**self._about, "begun": vars(begun) | plain | {"search": search}})

    def remove(self) -> None:
        """Remove the file: nothing is left to resume."""
        self._path.unlink(missing_ok=True)

    def _unfit(self, reason: str) -> ValueError:
        return ValueError(
            f"the fit cannot go on from {self._path}: {reason}. Fit as it was begun, or begin anew with another "
            "resume=, or without that file."
        )
