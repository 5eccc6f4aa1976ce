"""Effects: the named physical quantities in which a simulation and the world may differ."""

import difflib
import math
import re
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, field
from functools import partial
from typing import Any

NAME_PATTERN = re.compile(r"(?P<family>[A-Za-z_]\w*)(\[(?P<target>([^\[\]]|\[[^\[\]]*\])+)\])?")


@dataclass(frozen=True)
class Effect:
    """A named physical quantity of a simulator that may differ from the model's.

    Parameters
    ----------
    name : str
        ``"family[target]"`` or ``"family"``, for example ``"mass[torso]"`` or ``"gravity"``.
    unit : str
        Unit of the value; ``"1"`` for factors.
    neutral : float
        The value at which the simulation is the model as it was given: 1 for factors, 0 for what is added. Any other
        is the model's own value of a quantity that values state in full.
    bounds : tuple of two floats
        Lowest and highest value that make physical sense; ``neutral`` lies within them.
    apply : callable, optional
        ``apply(spec, value)`` edits a copied ``mujoco.MjSpec`` in place. None if no edit of the model
        expresses the effect, or if the simulator is not MuJoCo's.
    describe : callable, optional
        ``describe(value)`` returns a sentence. By default a sentence made from the name, the unit and the
        value.

    Attributes
    ----------
    family : str
        The name before the bracket.
    target : str or None
        The name within the bracket: a body, a joint, an axis, "all"; None if the family has no target.

    Raises
    ------
    ValueError
        If the name has another form, or if not ``low <= neutral <= high`` with ``low < high``.

    Examples
    --------
    >>> from skat.effects import Effect
    >>> heavier = Effect("mass[torso]", unit="1", neutral=1.0, bounds=(0.05, 20.0))
    >>> heavier.family, heavier.target
    ('mass', 'torso')
    >>> heavier.describe(1.08)
    "the mass of torso is 1.08 times the model's"
    """

    name: str
    unit: str = field(kw_only=True)
    neutral: float = field(kw_only=True)
    bounds: tuple[float, float] = field(kw_only=True)
    apply: Callable[[Any, float], None] | None = field(default=None, kw_only=True, compare=False, repr=False)
    describe: Callable[[float], str] = field(default=None, kw_only=True, compare=False, repr=False)  # type: ignore[assignment]
    family: str = field(init=False, compare=False, repr=False)
    target: str | None = field(init=False, compare=False, repr=False)

    def __post_init__(self) -> None:
        match = NAME_PATTERN.fullmatch(self.name)
        if match is None:
            raise ValueError(f"an effect's name is 'family' or 'family[target]'; got {self.name!r}")
        low, high = self.bounds
        if not (low <= self.neutral <= high and low < high):
            raise ValueError(
                f"bounds of {self.name} must enclose the neutral value {self.neutral:g}; got ({low:g}, "
                f"{high:g})"
            )
        if not math.isfinite(high - low):
            raise ValueError(f"bounds of {self.name} must be finite; got ({low:g}, {high:g})")
        object.__setattr__(self, "family", match["family"])
        object.__setattr__(self, "target", match["target"])
        given: Callable[[float], str] | None = self.describe
        # Of an effect that was made from another one, the sentence is made anew.
        if given is None or getattr(given, "func", None) is _sentence:
            given = partial(_sentence, self.name, self.unit, self.neutral)
        object.__setattr__(self, "describe", given)

    @property
    def meaning(self) -> str:
        """What the quantity is, in words.

        Examples
        --------
        >>> Effect("dry_friction[elbow]", unit="N m", neutral=0.0, bounds=(0.0, 1.0)).meaning
        'dry friction of elbow'
        """
        words = _phrase(self.name, self.unit, self.neutral)
        if words != self.name:
            return words
        one, every = _MEANINGS.get(self.family, ("", ""))
        return every if self.target == "all" else one.format(self.target)

    @property
    def is_factor(self) -> bool:
        """Whether values multiply (neutral 1, without a unit) rather than add."""
        return self.neutral == 1 and self.unit == "1"

    def combined(self, first: float, second: float) -> float:
        """Return the value that stands for both: the product of factors, otherwise the sum of what each one adds.

        Examples
        --------
        >>> Effect("wind[x]", unit="N", neutral=0.0, bounds=(-1.0, 1.0)).combined(0.25, 0.5)
        0.75
        """
        return first * second if self.is_factor else first + (second - self.neutral)

    def checked(self, value: Any) -> float:
        """Return the value as a float.

        Raises
        ------
        TypeError
            If it is not a number.
        ValueError
            If it is not finite or out of bounds.
        """
        try:
            number = float(value)
        except (TypeError, ValueError):
            raise TypeError(
                f"the value of {self.name} must be a number ({self.unit}); got {value!r}"
            ) from None
        low, high = self.bounds
        if not math.isfinite(number) or not low - 1e-9 * abs(low) <= number <= high + 1e-9 * abs(high):
            raise ValueError(
                f"{self.name} = {number:g} is out of bounds: expected a value from {low:g} to {high:g} "
                f"({self.unit}); {self.neutral:g} is neutral"
            )
        return number


def checked_values(effects: Iterable[Effect], values: Mapping[str, float] | None) -> dict[str, float]:
    """Return the values as floats, in the effects' order, after a check of every name and value.

    Parameters
    ----------
    effects : iterable of Effect
        The effects that exist.
    values : mapping from name to value, or None
        None: no values.

    Raises
    ------
    TypeError
        If ``values`` is no mapping, or a value no number.
    ValueError
        If a name does not exist (the message lists names that are close, and the families), or a value is out
        of bounds.
    """
    if values is None:
        return {}
    if not isinstance(values, Mapping):
        raise TypeError(
            f"effects must be a dictionary from names to values; got {type(values).__name__}: {values!r}"
        )
    known = {effect.name: effect for effect in effects}
    for name in values:
        if name not in known:
            raise ValueError(unknown_name_message(name, known))
    return {name: known[name].checked(values[name]) for name in known if name in values}


def unknown_name_message(name: Any, known: Iterable[str]) -> str:
    """Return the error text for an effect that does not exist: close names, then the families."""
    known = list(known)
    close = difflib.get_close_matches(str(name), known, n=4, cutoff=0.5)
    targets: dict[str, list[str]] = {}
    for other in known:
        family, _, target = other.partition("[")
        targets.setdefault(family, []).append(target.removesuffix("]"))
    hint = f"Close names: {', '.join(close)}. " if close else ""
    family = str(name).partition("[")[0]
    if family in targets:
        hint += f"Targets of {family}: {', '.join(targets[family])}. "
    listing = ", ".join(f"{other}[...]" if any(found) else other for other, found in targets.items())
    return (
        f"unknown effect {name!r}. {hint}Families of this simulator: {listing or 'none'}. effects() "
        f"lists all names"
    )


# Family -> (what it is, with the target put in for {}; the same for the target "all"; how it compares).
_PHRASES = {
    "mass": ("the mass of {}", "the mass of every body"),
    "inertia": ("the rotational inertia of {}", ""),
    "length": ("the length of {}", "the length of every link"),
    "radius": ("the radius of {}", "the radius of every wheel"),
    "gravity": ("gravity", "gravity"),
    "gain": ("gain[{}]", "gain[all]"),
    "offset": ("the offset of the command of {}", ""),
    "contact_friction": ("the contact friction of {}", "the contact friction"),
    "contact_anisotropy": (
        "the contact friction of {} along its second direction",
        "the contact friction along its second direction",
    ),
    "restitution": ("the contact damping ratio of {}", "the contact damping ratio"),
    "scale": ("the scale of sensor {}", "the scale of every sensor"),
    "timestep": ("the time step", "the time step"),
    "centre_of_mass": ("the centre of mass along {}", ""),
    "tilt": ("the ground's slope along {}", ""),
    "wind": ("a constant force along {}", ""),
    "air_drag": ("quadratic air drag along {}", "quadratic air drag"),
    "damping": ("viscous damping of {}", "viscous damping of every joint"),
    "dry_friction": ("dry friction of {}", "dry friction of every joint"),
    "force": ("a constant force on {}", ""),
    "position_friction": ("dry friction that grows with the position of {}", ""),
    "armature": ("the armature of {}", "the armature of every joint"),
    "stiffness": ("the stiffness of {}", "the stiffness of every joint"),
    "tendon_damping": ("viscous damping of tendon {}", ""),
    "tendon_dry_friction": ("dry friction of tendon {}", ""),
    "tendon_stiffness": ("the stiffness of tendon {}", ""),
    "force_limit": ("the force limit of {}", "the force limit of every actuator"),
    "kp": ("the position gain of {}", "the position gain of every servo"),
    "kv": ("the velocity gain (kv) of the servo {}", "the velocity gain (kv) of every servo"),
    "delay": ("the delay of every {}", ""),
    "bias": ("the bias of sensor {}", ""),
}


# Of families whose sentences begin with the name itself.
_MEANINGS = {
    "gain": ("the force of the actuator {} for its command", "the force of every actuator for its command"),
    "gravity": ("the strength of gravity", ""),
}

# Families whose words hold for these units alone.
_UNITS = {
    "wind": ("N",),
    "force": ("N", "N m"),
    "tilt": ("rad",),
    "centre_of_mass": ("m",),
    "restitution": ("1",),
    "delay": ("s",),
}
_ADDED = ("damping", "dry_friction", "armature", "stiffness")


def _sentence(name: str, unit: str, neutral: float, value: float) -> str:
    family = name.partition("[")[0]
    phrase = _phrase(name, unit, neutral)
    is_factor = neutral == 1 and unit == "1"
    if family == "gain" and is_factor:
        if abs(value + 1) < 0.05:
            return f"{phrase} is inverted"
        if abs(value) < 0.05:
            return f"{phrase} is disabled"
    if family == "contact_anisotropy" and phrase != name:
        return f"{phrase} is {value:.3g} times that along the first"
    if is_factor:
        return f"{phrase} is {value:.3g} times the model's"
    if neutral == 0 and phrase != name:
        if family.removeprefix("tendon_") in _ADDED:
            return f"{phrase} is {abs(value):.3g} {unit} {'more' if value >= 0 else 'less'} than the model's"
        if family == "centre_of_mass":
            return f"{phrase} is shifted by {value:.3g} {unit}"
    named_unit = "" if unit == "1" else f" {unit}"
    beside = f" (the model has {neutral:.3g}{named_unit})" if neutral else ""
    return f"{phrase} is {value:.3g}{named_unit}{beside}"


def _phrase(name: str, unit: str, neutral: float) -> str:
    """Return what an effect is, in words where its family, target and unit are those of the words; else its name."""
    family, _, bracket = name.partition("[")
    target = bracket.removesuffix("]")
    one, every = _PHRASES.get(family, (name, name))
    words = every if target == "all" else one.format(target)
    stated_in_full = neutral not in (0, 1) and family in _UNITS
    if stated_in_full or unit not in _UNITS.get(family, (unit,)) or not (target or "{}" not in one):
        return name
    return words or name
