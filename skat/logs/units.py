"""Units that logs are in, as factors and offsets to those of a simulator."""

import math
import re
from collections.abc import Sequence
from dataclasses import dataclass

from skat.simulators.tables import Array

# Factor to the SI unit, and what it measures: A angle, L length, T torque or force, S time.
BASE = {
    "rad": (1.0, "A"),
    "deg": (math.pi / 180, "A"),
    "rev": (2 * math.pi, "A"),
    "turns": (2 * math.pi, "A"),
    "mrad": (1e-3, "A"),
    "rpm": (2 * math.pi / 60, "A/s"),
    "rps": (2 * math.pi, "A/s"),
    "m": (1.0, "L"),
    "cm": (1e-2, "L"),
    "mm": (1e-3, "L"),
    "um": (1e-6, "L"),
    "N": (1.0, "T"),
    "Nm": (1.0, "T"),
    "N m": (1.0, "T"),
    "mNm": (1e-3, "T"),
    "s": (1.0, "S"),
    "ms": (1e-3, "S"),
    "us": (1e-6, "S"),
    "ns": (1e-9, "S"),
}
KNOWN = (
    "rad, deg, rev, mrad, rad/s, deg/s, rpm, rps, m, cm, mm, um (also /s), N, Nm, mNm, s, ms, us, ns, "
    "ticks:<per turn>, percent:<low>:<high>, A:<N m per A>, mA:<N m per A>, x:<factor>; before it - for the "
    "opposite sign, behind it +<offset> or -<offset> in the same unit"
)
WHOLE = re.compile(
    r"^(?P<sign>[-+]?)(?P<unit>[a-zA-Z%][^+]*?)(?P<offset>(?<![eE:])[-+]\d[\d.]*(?:[eE][-+]?\d+)?)?$"
)
# Of a whole turn or so less: what the first stamp of a clock that counts from 1970 is, s.
LEAST_DATE = 1e8


@dataclass(frozen=True)
class Unit:
    """A unit: simulator's value = factor * (sign * theirs + offset) + origin.

    Attributes
    ----------
    text : str
        As the user wrote it.
    factor : float
    sign : float
        1 or -1.
    offset : float
        In their unit.
    origin : float
        In the simulator's unit, of a range whose lower end is not 0.
    kind : str
        What it measures: "A", "A/s", "L", "L/s", "T", "S"; "" where any.
    """

    text: str
    factor: float = 1.0
    sign: float = 1.0
    offset: float = 0.0
    origin: float = 0.0
    kind: str = ""

    @property
    def plain(self) -> bool:
        """Whether it changes nothing."""
        return self.factor == 1.0 and self.sign == 1.0 and self.offset == 0.0 and self.origin == 0.0

    def applied(self, values: Array) -> Array:
        """Return values in the simulator's unit."""
        if self.plain:
            return values
        moved = values if self.sign > 0 and not self.offset else self.sign * values + self.offset
        return self.factor * moved + self.origin


def parsed_unit(text: str, *, limits: tuple[float, float] | None = None) -> Unit:
    """Return the unit that a text says.

    Parameters
    ----------
    text : str
    limits : (float, float), optional
        Ends of the range that a percentage is of, in the simulator's unit.

    Raises
    ------
    ValueError
        If it is unknown, with those that are known.
    """
    found = WHOLE.match(text.strip())
    if not found:
        raise ValueError(f"the unit {text!r} is unknown; known: {KNOWN}.")
    sign = -1.0 if found["sign"] == "-" else 1.0
    offset = float(found["offset"] or 0.0)
    factor, kind, origin = _scaled(found["unit"].strip(), text, limits)
    if origin is not None:
        low, base = origin
        return Unit(text, factor, sign, offset, base - factor * low, kind)
    return Unit(text, factor, sign, offset, 0.0, kind)


def _scaled(
    unit: str, text: str, limits: Sequence[float] | None
) -> tuple[float, str, tuple[float, float] | None]:
    """Return (factor, kind, (their lower end, ours) or None)."""
    name, *arguments = unit.split(":")
    try:
        numbers = [float(argument) for argument in arguments]
    except ValueError:
        raise ValueError(f"the unit {text!r} has {unit.partition(':')[2]!r} where numbers belong.") from None
    if not all(math.isfinite(number) for number in numbers):
        raise ValueError(f"the unit {text!r} needs finite numbers.")
    if name in BASE and not numbers:
        return (*BASE[name], None)
    stem = name.removesuffix("/s")
    if stem != name and stem in BASE and BASE[stem][1] in "AL" and not numbers:
        return BASE[stem][0], f"{BASE[stem][1]}/s", None
    if name == "ticks" and len(numbers) == 1 and numbers[0]:
        return 2 * math.pi / numbers[0], "A", None
    if name in ("A", "mA") and len(numbers) == 1 and numbers[0]:
        return numbers[0] * (1.0 if name == "A" else 1e-3), "T", None
    if name == "x" and len(numbers) == 1 and numbers[0]:
        return numbers[0], "", None
    if name in ("percent", "%"):
        return _percent(numbers, text, limits)
    hints = {
        "A": "A:<N m per A>, the motor's torque constant",
        "mA": "mA:<N m per A>, the motor's torque constant",
        "ticks": "ticks:<per turn>, such as ticks:4096",
        "x": "x:<factor>",
    }
    if name in hints:
        raise ValueError(f"the unit {text!r} lacks its number: write {hints[name]}.")
    raise ValueError(f"the unit {text!r} is unknown; known: {KNOWN}.")


def _percent(
    numbers: list[float], text: str, limits: Sequence[float] | None
) -> tuple[float, str, tuple[float, float] | None]:
    if len(numbers) == 4:
        low, high, *limits = numbers
    elif len(numbers) == 2:
        low, high = numbers
    else:
        raise ValueError(
            f"the unit {text!r} needs the values at both ends of the calibrated range: percent:-100:100, and, where "
            "these ends are not the model's limits, percent:-100:100:<low in rad>:<high in rad>."
        )
    if limits is None:
        raise ValueError(
            f"the unit {text!r} is of a range, and the model has no limits there: write percent:{numbers[0]:g}:"
            f"{numbers[1]:g}:<low in rad>:<high in rad>."
        )
    if low == high:
        raise ValueError(f"the unit {text!r} has a range without length.")
    return (limits[1] - limits[0]) / (high - low), "", (low, limits[0])
