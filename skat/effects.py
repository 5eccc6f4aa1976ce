"""Effects: the named physical quantities in which a simulation and the world may differ."""

import difflib
import math
import re
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, field
from functools import partial
from types import MappingProxyType
from typing import Any

FACTOR, FORCE = 0.2, 0.3
NAME_PATTERN = re.compile(r"(?P<family>[A-Za-z_]\w*)(\[(?P<target>([^\[\]]|\[[^\[\]]*\])+)\])?")


@dataclass(frozen=True)
class Family:
    """What all effects of one family share, whatever has them.

    What a family edits, its bounds, and which elements of a model have it, stand in one row of the simulator's own
    table.

    Parameters
    ----------
    name : str
    words, words_all : str
        What it is, with the target put in for ``{}``; the same for the target "all". Empty: the effect's name.
    unit : tuple of str
        That of slides (or the only one), and that of hinges; () where it is the element's own.
    neutral : float
        1 of factors, 0 of what is added.
    typical : float, optional
        As `Effect`'s. None: a rule of the simulator, or the default.
    odds : float
        As `Effect`'s.
    force_share : float, optional
        As `Effect`'s.
    order : int
        Edits of a model are made in this order; those that need the outcome of others come later.
    only : tuple of str
        Units for which the words hold; () for any.
    form : str
        How values are told: "" plainly, "more" as more or less than the model's, "shift" as a shift, "limit" as one
        where the model has none.
    aliases : tuple of str
        Families that act the same wherever only what they have in common shows.
    inertial : bool
        Whether they change what forces have to move: to another inertia a lasting force is another one, while of
        friction it stays, as it is what friction holds.
    """

    name: str
    words: str = ""
    words_all: str = ""
    unit: tuple[str, ...] = ("1",)
    neutral: float = 1.0
    typical: float | None = None
    odds: float = 1.0
    force_share: float | None = None
    order: int = 0
    only: tuple[str, ...] = ()
    form: str = ""
    aliases: tuple[str, ...] = ()
    inertial: bool = False


_DRAG, _TORQUE, _DAMPING, _SPRING = ("kg/m",), ("N", "N m"), ("N s/m", "N m s/rad"), ("N/m", "N m/rad")
_ADDED = partial(Family, neutral=0.0)
_FORCE = partial(Family, neutral=0.0, force_share=FORCE)
_MORE = partial(Family, neutral=0.0, force_share=FORCE, form="more")
# Odds and typical sizes: engineers' judgement of what is often wrong, and by how much. A user's own go first.
_TABLE = (
    Family("mass", "the mass of {}", "the mass of every body", typical=0.2, aliases=("payload",),
           inertial=True),
    Family("length", "the length of {}", "the length of every link", typical=0.03, odds=0.2, inertial=True),
    Family("radius", "the radius of {}", "the radius of every wheel", typical=0.03, odds=0.2, order=1),
    Family("inertia", "the rotational inertia of {}", typical=0.2, odds=0.3, order=2, inertial=True),
    _ADDED("centre_of_mass", "the centre of mass along {}", unit=("m",), typical=0.03, odds=0.3, order=3, only=("m",),
           form="shift", aliases=("mass", "payload"), inertial=True),
    Family("gravity", "gravity", "gravity", typical=0.02, odds=0.1),
    _ADDED("tilt", "the ground's slope along {}", unit=("rad",), typical=0.03, odds=0.2, only=("rad",)),
    _FORCE("wind", "a constant force along {}", unit=("N",), odds=0.3, only=("N",)),
    _FORCE("air_drag", "quadratic air drag along {}", "quadratic air drag", unit=_DRAG, odds=0.3),
    _MORE("damping", "viscous damping of {}", "viscous damping of every joint", unit=_DAMPING),
    _MORE("dry_friction", "dry friction of {}", "dry friction of every joint", unit=_TORQUE),
    _FORCE("position_friction", "dry friction that grows with the position of {}", unit=_SPRING, odds=0.2),
    _MORE("armature", "the armature of {}", "the armature of every joint", unit=("kg", "kg m2"), inertial=True),
    _MORE("stiffness", "the stiffness of {}", "the stiffness of every joint", unit=_SPRING, odds=0.3),
    _MORE("tendon_damping", "viscous damping of tendon {}", unit=("N s/m",)),
    _MORE("tendon_dry_friction", "dry friction of tendon {}", unit=("N",)),
    _MORE("tendon_stiffness", "the stiffness of tendon {}", unit=("N/m",), odds=0.3),
    Family("gain", "gain[{}]", "gain[all]", typical=FACTOR),
    Family("force_limit", "the force limit of {}", "the force limit of every actuator", typical=FACTOR, odds=0.5),
    Family("kp", "the position gain of {}", "the position gain of every servo", typical=FACTOR),
    Family("kv", "the velocity gain (kv) of the servo {}", "the velocity gain (kv) of every servo", typical=FACTOR),
    _ADDED("offset", "the offset of the command of {}", unit=(), typical=0.03, odds=0.5),
    _ADDED("delay", "the delay of {}", "the delay of every action", unit=("s",), order=10, only=("s",)),
    _ADDED("lag", "the lag of {}", "the lag of every actuator", unit=("s",), typical=0.02, odds=0.5, order=9,
           only=("s",)),
    _ADDED("lag_torque", "the lag of the torque of {}", unit=("s",), typical=0.02, odds=0.5, only=("s",)),
    _ADDED("dead_zone", "half of the dead zone of {}", unit=(), typical=0.01, odds=0.5, aliases=("backlash",)),
    _ADDED("backlash", "the play between motor and link of {}", unit=("m", "rad"), typical=0.01, odds=0.5, order=11),
    _FORCE("stribeck", "the friction by which {} sticks when it is slow", unit=_TORQUE, odds=0.5),
    Family("stribeck_speed", "the speed up to which {} sticks", unit=("m/s", "rad/s"), neutral=2.0, typical=1.0),
    Family("stribeck_exponent", "the exponent of the sticking of {}", neutral=2.0, typical=1.0),
    _ADDED("load_friction", "friction of {} per load on its gear", unit=("1",), typical=0.1, odds=0.5),
    _ADDED("load_stribeck", "friction of {} per load when it is slow", unit=("1",), typical=0.1, odds=0.3),
    *(
        _ADDED(f"load_{kind}_{side}", f"friction of {{}} per {words}, {side}", unit=unit, typical=0.1, odds=0.1)
        for kind, words, unit in (
            ("friction", "load", ("1",)),
            ("stribeck", "load when it is slow", ("1",)),
            ("square", "square of the load when it is slow", ("1/N", "1/(N m)")),
        )
        for side in ("motor", "external")
    ),
    _ADDED("torque_speed", "the force that {} loses per speed", unit=("N s/m", "N m s/rad"), force_share=FORCE,
           odds=0.5),
    Family("current_limit", "the largest force of {}", unit=_TORQUE, neutral=math.nan, force_share=FORCE, odds=0.5,
           form="limit"),
    _ADDED("payload", "a weight on {}", unit=("kg",), odds=1.0, order=4, only=("kg",), inertial=True),
    Family("contact_friction", "the contact friction of {}", "the contact friction", typical=FACTOR, order=5),
    Family("contact_anisotropy", "the contact friction of {} along its second direction",
           "the contact friction along its second direction", typical=FACTOR, odds=0.2, order=6),
    Family("restitution", "the contact damping ratio of {}", "the contact damping ratio", typical=FACTOR, odds=0.3,
           order=7, only=("1",)),
    Family("timestep", "the time step", "the time step", typical=0.7, odds=0.1, order=8),
    _ADDED("bias", "the bias of sensor {}", unit=(), typical=0.01, odds=0.3),
    Family("scale", "the scale of sensor {}", "the scale of every sensor", typical=0.02, odds=0.2),
    _FORCE("force", "a constant force on {}", unit=_TORQUE, odds=0.1, only=_TORQUE),
)  # fmt: skip
# The target that stands for all, where it is not "all".
EVERY = {"delay": "action"}
FAMILIES = MappingProxyType({family.name: family for family in _TABLE})


def is_inertial(effect: str) -> bool:
    """Whether an effect, by its name, changes what forces have to move."""
    family = FAMILIES.get(effect.partition("[")[0])
    return family is not None and family.inertial


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
    typical : float, optional
        How far from neutral values often are: the scale of a Cauchy prior, on the logarithm of factors (.2: by a
        fifth), otherwise in `unit`. By default that of the family; of a family that has none, .2 of a factor and a
        tenth of the range of other values.
    odds : float, optional
        How likely the effect is a cause before anything was measured, relative to others. By default the family's;
        1 of a family that is not known.
    force_share : float, optional
        Where it is given, `typical` is what makes up this share of the force that the nominal model puts on the
        joint or actuator in the poses of its anatomy. Whoever has a log may put in the force there.
    aliases : tuple of str, default=()
        Names of effects that act the same wherever only what they have in common shows, as the mass of a body and a
        shift of its centre both change its first moment.

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
    typical: float = field(default=math.nan, kw_only=True, repr=False)
    odds: float = field(default=math.nan, kw_only=True, repr=False)
    force_share: float | None = field(default=None, kw_only=True, repr=False)
    aliases: tuple[str, ...] = field(default=(), kw_only=True, compare=False, repr=False)
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
        object.__setattr__(self, "typical", self._prior("typical"))
        object.__setattr__(self, "odds", self._prior("odds"))

    def _prior(self, what: str) -> float:
        value = getattr(self, what)
        if math.isnan(value):
            value = getattr(FAMILIES.get(self.family), what, None)
        if value is None:
            value = {
                "typical": 0.2 if self.is_factor else (self.bounds[1] - self.bounds[0]) / 10,
                "odds": 1.0,
            }[what]
        if not 0 < value < math.inf:
            raise ValueError(f"{what} of {self.name} must be positive and finite; got {value:g}")
        return float(value)

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
        """Return the value as a float within the bounds; sums and products may be beyond them by rounding.

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
        rounding = 1e-9 * (high - low)
        if not math.isfinite(number) or not low - rounding <= number <= high + rounding:
            raise ValueError(
                f"{self.name} = {number:g} is out of bounds: expected a value from {low:g} to {high:g} "
                f"({self.unit}); {self.neutral:g} is neutral"
            )
        return min(max(number, low), high)


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


# Of families whose sentences begin with the name itself.
_MEANINGS = {
    "gain": ("the force of the actuator {} for its command", "the force of every actuator for its command"),
    "gravity": ("the strength of gravity", ""),
}


def _sentence(name: str, unit: str, neutral: float, value: float) -> str:
    family = name.partition("[")[0]
    phrase = _phrase(name, unit, neutral)
    form = FAMILIES[family].form if family in FAMILIES else ""
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
        if form == "more":
            return f"{phrase} is {abs(value):.3g} {unit} {'more' if value >= 0 else 'less'} than the model's"
        if form == "shift":
            return f"{phrase} is shifted by {value:.3g} {unit}"
    named_unit = "" if unit == "1" else f" {unit}"
    beside = f" (the model has {neutral:.3g}{named_unit})" if neutral else ""
    if form == "limit":
        beside = " (the model has no limit)"
    return f"{phrase} is {value:.3g}{named_unit}{beside}"


def _phrase(name: str, unit: str, neutral: float) -> str:
    """Return what an effect is, in words where its family, target and unit are those of the words; else its name."""
    family, _, bracket = name.partition("[")
    target = bracket.removesuffix("]")
    record = FAMILIES.get(family)
    if record is None:
        return name
    words = record.words_all if target in ("all", EVERY.get(family)) else record.words.format(target)
    if target.startswith("ctrl.") and family in ("bias", "scale"):
        words = f"the {family} of the command of {target.removeprefix('ctrl.')}"
    stated_in_full = neutral not in (0, 1) and record.only
    if stated_in_full or unit not in (record.only or (unit,)) or not (target or "{}" not in record.words):
        return name
    return words or name
