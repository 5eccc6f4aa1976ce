"""The findings of a diagnosis as data for other programs."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Mapping
from importlib.metadata import version
from typing import TYPE_CHECKING, Any

import numpy as np

from skat.diagnosis.report.sentences import is_first_look

if TYPE_CHECKING:
    from skat.diagnosis.estimator import SimulationDiagnosis
    from skat.diagnosis.findings import Gain
    from skat.diagnosis.posterior import CauseSet
    from skat.diagnosis.remainder import Left

# Grows where a field goes away or changes its meaning; fields may be added without.
SCHEMA = 2


def findings_as_data(
    diagnosis: SimulationDiagnosis, *, gain: Gain | None = None, error_name: str = "", **context: Any
) -> dict[str, Any]:
    """Return what a diagnosis found, as what JSON holds: dictionaries, lists, texts, numbers, True, False, None.

    `diagnosis`: fitted. `gain`: measured on data that were set aside; by default the diagnosis's own. `error_name`:
    what the numbers of the gain are, with their unit. `**context`: further fields, such as where the log came from.
    Returns: with the fields that the user guide lists. What is not finite is None: JSON has no such numbers.
    """
    gain = diagnosis.gain_ if gain is None else gain
    content = {
        "schema": SCHEMA,
        "skat": version("skat"),
        "mujoco": version("mujoco"),
        "numpy": np.__version__,
        **context,
        "verdict": diagnosis.verdict_,
        "first_look": is_first_look(diagnosis),
        "rows_fitted": diagnosis.n_rows_fitted_,
        "effects": list(diagnosis.identifiability_.index),
        "causes": diagnosis.causes_,
        "also_seen": diagnosis.also_seen_,
        "sets": [_set(one) for one in diagnosis.posterior_.sets],
        "gain": None if gain is None else {**_fields(gain), "ratio": gain.ratio, "error": error_name},
        "noise": {
            name: one
            for name, one in zip(diagnosis.simulator.residual_names, diagnosis.noise_)
            if not math.isnan(one)
        },
        "logs": [
            {
                "name": str(name),
                "noise": {channel: one for channel, one in row.items() if not math.isnan(one)},
            }
            for name, row in diagnosis.noise_of_logs_.iterrows()
        ],
        "agreement": None if diagnosis.agreement_ is None else diagnosis.agreement_.to_dict("records"),
        "actions": diagnosis.actions_,
        "computed_velocities": diagnosis.computed_velocities_,
        "smoothing": None if diagnosis.smoothing_ is None else _fields(diagnosis.smoothing_),
        "remainder": [_left(part) for part in diagnosis.remainder_.parts],
    }
    return {name: plain(one) for name, one in content.items()}


def plain(value: Any) -> Any:
    """Return a value as what JSON holds."""
    if dataclasses.is_dataclass(value) and not isinstance(value, type):
        return plain(_fields(value))
    if isinstance(value, Mapping):
        return {str(name): plain(one) for name, one in value.items()}
    if isinstance(value, np.ndarray | np.generic):
        return plain(value.tolist())
    if isinstance(value, list | tuple | set | frozenset):
        return [plain(one) for one in value]
    if isinstance(value, float):
        return value if math.isfinite(value) else None
    return value if value is None or isinstance(value, bool | int | str) else str(value)


def _fields(record: Any) -> dict[str, Any]:
    return {field.name: getattr(record, field.name) for field in dataclasses.fields(record)}


def _set(one: CauseSet) -> dict[str, Any]:
    return {"names": one.names, "probability": one.probability, "values": one.values}


def _left(part: Left) -> dict[str, Any]:
    """Return what is left in one direction, without what is only drawn."""
    fields = {**_fields(part), "share": part.share}
    for name in ("frequencies", "spectrum"):
        del fields[name]
    return fields
