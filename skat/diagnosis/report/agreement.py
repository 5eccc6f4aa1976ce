"""Whether findings of several logs of one robot agree, as ``skat diagnose --json`` writes them."""

import math
import warnings
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
import pandas as pd

from skat.diagnosis.agreement import ESTIMATED, NAMED, NO_INTERVAL, Said, row_of, table_of
from skat.diagnosis.chains import Array
from skat.diagnosis.evidence import WIDTH_95
from skat.diagnosis.report.machine import SCHEMA
from skat.diagnosis.report.sentences import listed, p_text

AT_BOUND, ALSO_SEEN, ABSENT, NOT_ASKED = "at a bound", "also seen", "-", "not asked"
FIELDS = ("schema", "verdict", "causes", "also_seen")
CAUSE_FIELDS = ("name", "unit", "value", "interval", "aliases")
# What fields are, in the words of JSON.
KINDS: Mapping[str, tuple[type, str]] = {
    **dict.fromkeys(("verdict", "model", "model_digest"), (str, "a text")),
    **dict.fromkeys(("also_seen", "log", "gain"), (Mapping, "an object")),
    **dict.fromkeys(("causes", "effects"), (list, "a list")),
}


def compare_findings(
    findings: Mapping[str, Mapping[str, Any]] | Sequence[Mapping[str, Any]],
    *,
    names: Sequence[str] | None = None,
) -> pd.DataFrame:
    r"""Return what several logs of one robot say of each cause, and whether they agree.

    Parameters
    ----------
    findings : mapping from str to dict, or sequence of dict
        Of each log what ``skat diagnose --json`` writes, as ``json.load`` returns it; at least two.
    names : sequence of str, optional
        Names of the logs in a sequence. By default "log 1", "log 2", and so on. Those of a mapping are its keys.

    Returns
    -------
    DataFrame
        A row for each cause that any log names: `cause`; `unit`; for each log, by its name such as "june",
        `value in june`, `low in june` and `high in june` (95 % interval; NaN where the log tells none), and
        `status in june`: "named"; "at a bound" or "no interval", which is named but not compared; "also seen";
        "alias of ..."; "not asked", of an effect that it was not asked about; or "-". Then `n_compared`, the number of
        logs compared; `chi_square`, `p_value` and `p_corrected`, NaN where there are fewer than two; and `agreement`:
        "agree", "differ" or "not compared".

    Raises
    ------
    TypeError
        If names are given of a mapping.
    ValueError
        If there are fewer than two findings, something is no findings or of another schema, names are not as many
        as the findings or not distinct, or a cause has several units.

    Warns
    -----
    UserWarning
        If the findings are of different models.

    Notes
    -----
    With values :math:`v_i`, :math:`i = 1..k`, of a cause and standard deviations :math:`s_i`, the longer side of
    each 95 % interval over 1.96 (a bound may have cut the other side),

    .. math:: Q = \sum_i (v_i - \bar v)^2 / s_i^2, \quad
        \bar v = \sum_i v_i s_i^{-2} \Big/ \sum_i s_i^{-2},

    has the chi-square law of :math:`k - 1` degrees of freedom if all logs have the same value. A factor whose
    intervals are symmetric on the logarithm is compared there. `p_corrected` is Holm's [1]_, for as many causes as are
    compared; logs differ where it is below 1 %.

    Intervals are over all likely sets with the cause, and take the model for right otherwise. So logs may also differ
    since they name other causes beside this one, or move in other ways. That wide intervals agree says little.

    References
    ----------
    .. [1] Holm (1979). A Simple Sequentially Rejective Multiple Test Procedure. Scandinavian Journal of Statistics 6.

    Examples
    --------
    >>> def found(value, low, high):
    ...     cause = {"name": "damping[rail]", "unit": "N s/m", "value": value, "interval": [low, high], "aliases": []}
    ...     return {"schema": 2, "verdict": "named", "causes": [cause], "also_seen": {}}
    >>> table = compare_findings({"june": found(0.6, 0.5, 0.7), "july": found(0.9, 0.8, 1.0)})
    >>> table[["cause", "chi_square", "agreement"]]
               cause  chi_square agreement
    0  damping[rail]     17.2872    differ
    """
    logs = _by_name(findings, names)
    for name, one in logs.items():
        check_findings(one, name)
    _warn_of_models(logs)
    return table_of([_row(cause, unit, logs) for cause, unit in _units(logs).items()], list(logs))


def check_findings(content: Any, name: str) -> None:
    """Raise a ValueError, in which a name says whose they are, where something is no findings that are known here."""
    what = f"{name}: expected findings, as `skat diagnose --json` writes them"
    if not isinstance(content, Mapping):
        raise ValueError(f"{what}; got {type(content).__name__}.")
    lacking = [field for field in FIELDS if field not in content]
    if lacking:
        raise ValueError(f"{what}; {', '.join(lacking)} is not there.")
    if content["schema"] != SCHEMA:
        newer = isinstance(content["schema"], int) and content["schema"] > SCHEMA
        remedy = "update skat" if newer else "diagnose the log again"
        raise ValueError(
            f"{name} is of schema {content['schema']!r}, and this skat reads schema {SCHEMA}: {remedy}."
        )
    for field, (kind, word) in KINDS.items():
        # What is not needed may be null.
        if not isinstance(content.get(field), kind) and (field in FIELDS or content.get(field) is not None):
            raise ValueError(f"{what}; {field} is {content[field]!r:.80}: expected {word}.")
    for cause in content["causes"]:
        lacking = [field for field in CAUSE_FIELDS if not isinstance(cause, Mapping) or field not in cause]
        if lacking:
            raise ValueError(f"{what}; {', '.join(lacking)} of a cause is not there.")
        if not isinstance(cause["name"], str) or not isinstance(cause["unit"], str):
            raise ValueError(
                f"{what}; {cause['name']!r} in {cause['unit']!r} is no cause: expected two texts."
            )
        aliases = cause["aliases"]
        if not isinstance(aliases, list | tuple) or not all(
            isinstance(one, Mapping) and "name" in one for one in aliases
        ):
            raise ValueError(
                f"{what}; {cause['name']} has aliases {aliases!r:.80}: expected a list of objects."
            )
        interval = cause["interval"]
        numbers = [cause["value"], *(interval if isinstance(interval, list | tuple) else ())]
        if len(numbers) != 3 or not all(one is None or isinstance(one, int | float) for one in numbers):
            raise ValueError(
                f"{what}; {cause['name']} has value {cause['value']!r} and interval {interval!r}: expected a number "
                "and two."
            )


def agreement_sentences(table: pd.DataFrame) -> list[str]:
    """Return for each cause a sentence that says whether the logs agree.

    `table`: from `compare_findings`.
    """
    n_tests = int(table["p_value"].notna().sum())
    return [_sentence(row, n_tests) for row in table.to_dict("records")]


def _by_name(
    findings: Mapping[str, Mapping[str, Any]] | Sequence[Mapping[str, Any]], names: Sequence[str] | None
) -> dict[str, Mapping[str, Any]]:
    if isinstance(findings, Mapping):
        if names is not None:
            raise TypeError("names are those of the mapping; pass a list of findings to give others.")
        logs = dict(findings)
    else:
        names = [f"log {n}" for n, _ in enumerate(findings, 1)] if names is None else list(names)
        if len(names) != len(findings):
            raise ValueError(f"expected a name for each of {len(findings)} findings; got {len(names)} names.")
        twice = [name for name in names if names.count(name) > 1]
        if twice:
            raise ValueError(f"names must differ; {twice[0]!r} is there {names.count(twice[0])} times.")
        logs = dict(zip(names, findings))
    if len(logs) < 2:
        raise ValueError(f"expected the findings of two logs or more, to compare them; got {len(logs)}.")
    return logs


def _warn_of_models(logs: Mapping[str, Mapping[str, Any]]) -> None:
    known = all(one.get("model_digest") for one in logs.values())
    field, differ = (
        ("model_digest", "different models") if known else ("model", "models with different paths")
    )
    told = {name: one[field] for name, one in logs.items() if one.get(field)}
    if len(set(told.values())) > 1:
        listed = ", ".join(f"{name} of {logs[name].get('model', 'one')}" for name in told)
        warnings.warn(
            f"These findings are of {differ}: {listed}. A value counts from its own model: unless these are the same, "
            "logs of one robot differ.",
            stacklevel=3,
        )


def _units(logs: Mapping[str, Mapping[str, Any]]) -> dict[str, str]:
    """Return the causes that any log names, with their units."""
    units: dict[str, tuple[str, str]] = {}
    for name, one in logs.items():
        for cause in one["causes"]:
            unit, first = units.setdefault(cause["name"], (cause["unit"], name))
            if unit != cause["unit"]:
                raise ValueError(
                    f"{cause['name']} is in {unit} in {first} and in {cause['unit']} in {name}: these are not findings "
                    "of the same robot. Compare those of one."
                )
    return {cause: unit for cause, (unit, _) in units.items()}


def _row(cause: str, unit: str, logs: Mapping[str, Mapping[str, Any]]) -> dict[str, Any]:
    said = {name: _said(cause, one) for name, one in logs.items()}
    compared = [one for one in said.values() if one.status == NAMED]
    return row_of(cause, unit, said, _chi_square(compared, unit) if len(compared) > 1 else math.nan)


def _said(cause: str, findings: Mapping[str, Any]) -> Said:
    for one in findings["causes"]:
        if one["name"] == cause:
            value, low, high = (math.nan if x is None else float(x) for x in (one["value"], *one["interval"]))
            is_measured = all(map(math.isfinite, (value, low, high))) and low <= value <= high and low < high
            status = AT_BOUND if one.get("at_bound") else NAMED if is_measured else NO_INTERVAL
            return Said(status, value, low, high)
    behind = [
        one["name"] for one in findings["causes"] if any(alias["name"] == cause for alias in one["aliases"])
    ]
    if behind:
        return Said(f"alias of {' and '.join(behind)}")
    if cause in findings["also_seen"]:
        value = findings["also_seen"][cause]
        return Said(ALSO_SEEN, math.nan if value is None else float(value))
    return Said(ABSENT if cause in findings.get("effects", (cause,)) else NOT_ASKED)


def _chi_square(said: Sequence[Said], unit: str) -> float:
    rows = np.array([(one.low, one.value, one.high) for one in said])
    if unit == "1" and (rows > 0).all() and _lopsided(np.log(rows)) <= _lopsided(rows):
        rows = np.log(rows)
    low, values, high = rows.T
    weights = (np.maximum(high - values, values - low) / WIDTH_95) ** -2.0
    mean = weights @ values / weights.sum()
    return float(weights @ (values - mean) ** 2)


def _lopsided(rows: Array) -> float:
    """Return by how much intervals are not symmetric: an interval is, on the scale that its value was measured on."""
    low, values, high = rows.T
    return float(np.sum(np.abs(low + high - 2 * values) / (high - low)))


def _sentence(row: Mapping[Any, Any], n_tests: int) -> str:
    status = _statuses(row)
    named = [name for name, one in status.items() if one in (NAMED, ESTIMATED, AT_BOUND, NO_INTERVAL)]
    compared = [name for name in named if status[name] in (NAMED, ESTIMATED)]
    is_compared = row["agreement"] != "not compared"
    if is_compared:
        who = "the logs" if len(compared) == len(status) else listed(compared)
        # Of several logs together more was compared than there are rows.
        is_corrected = n_tests > 1 or row["p_corrected"] != row["p_value"]
        corrected = (
            f", corrected for all that was compared {p_text(row['p_corrected'])}" if is_corrected else ""
        )
        text = f"{row['cause']}: {who} {row['agreement']} ({p_text(row['p_value'])}{corrected})"
    else:
        alone = " alone" if len(named) == 1 else ", not compared"
        text = f"{row['cause']}: named in {listed(named)}{alone}"
    left_out = []
    for name, one in status.items():
        if one == ABSENT and is_compared:
            left_out.append(f"not named in {name}")
        elif one not in (NAMED, ESTIMATED, ABSENT):
            left_out.append(f"{one} in {name}")
    return "; ".join([text, *left_out])


def _statuses(row: Mapping[Any, Any]) -> dict[str, str]:
    """Return what each log says of the cause of a row, by the log's name."""
    start = "status in "
    return {name.removeprefix(start): one for name, one in row.items() if name.startswith(start)}
