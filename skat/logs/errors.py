"""The error of a log that cannot be read as it is: where, what, and what to do."""

import shlex
from collections.abc import Callable, Mapping
from typing import Any

OPTIONS = {"rate": "--rate", "topic": "--topic", "episodes": "--episodes", "base": "--base"}


class LogError(ValueError):
    """A log that cannot be read as it is.

    Parameters
    ----------
    where : str
        The file, and the line, row, column or topic in it.
    problem : str
        What was expected and what came, a sentence.
    advice : str
        What to do, a sentence.
    options : mapping, optional
        Keyword arguments of `load_log` that cure it, such as ``{"rate": 50.0}``. The message ends with them, as
        they are written in Python and on the command line.

    Attributes
    ----------
    where, problem, advice : str
    options : dict
        Empty where no argument cures it.
    """

    def __init__(
        self, where: str, problem: str, advice: str = "", *, options: Mapping[str, Any] | None = None
    ) -> None:
        self.where, self.problem, self.advice = where, problem, advice
        self.options = dict(options or {})
        told = [f"{where}: {problem}", advice]
        if self.options:
            told.append(f"Try load_log(..., {python_options(self.options)}), {shell_options(self.options)}.")
        super().__init__(" ".join(part for part in told if part))

    def __reduce__(self) -> tuple[Callable[..., "LogError"], tuple[Any, ...]]:
        return _made, (self.where, self.problem, self.advice, self.options)


def _made(where: str, problem: str, advice: str, options: Mapping[str, Any]) -> LogError:
    return LogError(where, problem, advice, options=options)


def python_options(options: Mapping[str, Any]) -> str:
    """Return keyword arguments as they are written in Python."""
    return ", ".join(f"{name}={value!r}" for name, value in options.items())


def shell_options(options: Mapping[str, Any]) -> str:
    """Return keyword arguments of `load_log` as the command line has them."""
    words = []
    units = options.get("units", {})
    for name, value in options.items():
        if name == "columns":
            words += [f"--map {shlex.quote(f'{ours}={theirs}')}" for ours, theirs in value.items()]
        elif name == "units":
            named = {"*": units} if isinstance(units, str) else units
            words += [f"--map {shlex.quote(f'{ours}=:{unit}')}" for ours, unit in named.items()]
        else:
            words.append(f"{OPTIONS[name]} {shlex.quote(f'{value:g}' if name == 'rate' else str(value))}")
    return f"on the command line {' '.join(words)}"
