"""What is hidden: causes, pairs, effects that are in no list, and how a seed makes a world of them."""

from collections import Counter
from dataclasses import dataclass

import numpy as np

from worlds.logs import channel_names, measure, size_for
from worlds.models import KINDS, actuator_names, body_names, hinges, nominal_model

# How a family's strength, from 0, and a sign become its value.
_FACTORS = ("mass", "inertia", "length", "gravity", "contact_friction", "contact_anisotropy", "restitution")
_LINEAR_FACTORS = ("gain", "scale")


@dataclass(frozen=True)
class Row:
    """A line of the table: where an effect is hidden, which one, in which element, and how strongly at most.

    Attributes
    ----------
    kind, family : str
    targets : tuple of (str or None)
        A seed chooses among them.
    largest : tuple of two floats
        Largest strength with negative and with positive sign; 0: never with this sign.
    """

    kind: str
    family: str
    targets: tuple
    largest: tuple

    @property
    def label(self):
        """A name that is unique within its table."""
        every = "all" if self.targets == ("all",) else ("one" if self.targets[0] else "")
        if self.family == "centre_of_mass" or (len(self.targets) < 3 and self.targets[0] != "all"):
            every = "|".join(target or "" for target in self.targets[:2])
        return f"{self.kind}: {self.family}[{every}]" if every else f"{self.kind}: {self.family}"


@dataclass(frozen=True)
class Case:
    """A world that a seed made of one or two rows of a table.

    Attributes
    ----------
    kind, label : str
    seed : int
    hidden : tuple of (family, target, value)
    sizes : tuple of float
        s of each hidden effect alone.
    """

    kind: str
    label: str
    seed: int
    hidden: tuple
    sizes: tuple

    def log(self, *, fresh=False, n_episodes=30):
        """Return what is measured in this world; ``fresh``: in other episodes.

        Each label has actions, starts and noise of its own: cases that shared them would not be independent, and
        neither would their intervals and alarms.
        """
        seed = (2 * self.seed + fresh, _hash(self.label))
        return measure(self.kind, self.hidden, seed=seed, n_episodes=n_episodes)


def name(family, target):
    """Return the name that the effect goes by."""
    return family if target is None else f"{family}[{target}]"


def value_of(family, strength, sign):
    """Return an effect's value; strength 0 is neutral."""
    if family in _FACTORS:
        return float(np.exp(sign * strength))
    if family in _LINEAR_FACTORS:
        return 1.0 + sign * strength
    if family == "timestep":
        # A whole number of steps instead of HalfCheetah's and Ant's five.
        return 5 / max(1, round(5 * np.exp(-sign * strength)))
    return sign * strength


def draw(row, seed, *, s_range):
    """Return the Case that ``seed`` makes of a row: target, sign and size are random, size log-uniform in s.

    An element that cannot show the wanted size is passed over for another; the nearest of three is taken.
    """
    rng = np.random.default_rng([seed, _hash(row.label)])
    s = np.exp(rng.uniform(*np.log(s_range)))
    best = None
    for _ in range(3):
        target = row.targets[rng.integers(len(row.targets))]
        signs = [sign for sign, largest in zip((-1, 1), row.largest, strict=True) if largest > 0]
        sign = signs[rng.integers(len(signs))]
        largest = row.largest[(sign + 1) // 2]

        def make_hidden(strength, target=target, sign=sign):
            return ((row.family, target, value_of(row.family, strength, sign)),)

        strength = size_for(s, row.kind, make_hidden, largest=largest)
        hidden = make_hidden(strength)
        found = measure(row.kind, hidden, seed=2 * seed + 1, n_episodes=10).excess()
        if best is None or abs(np.log(max(found, 1e-12) / s)) < abs(np.log(max(best[1], 1e-12) / s)):
            best = hidden, found
        if abs(np.log(max(found, 1e-12) / s)) < 0.7:
            break
    hidden, found = best
    return Case(row.kind, row.label, seed, hidden, (float(found),))


def draw_pair(kind, seed, *, s_range):
    """Return a Case of two different effects, each drawn with its own size."""
    rng = np.random.default_rng([seed, _hash(kind)])
    rows = [row for row in causes() if row.kind == kind]
    first, second = (rows[i] for i in rng.choice(len(rows), size=2, replace=False))
    cases = [draw(first, seed, s_range=s_range), draw(second, seed, s_range=s_range)]
    families = [case.hidden[0][0] for case in cases]
    if "length" in families and "centre_of_mass" in families:
        return draw_pair(kind, seed + 1_000, s_range=s_range)
    return Case(
        kind,
        f"{first.label} + {second.label}",
        seed,
        cases[0].hidden + cases[1].hidden,
        cases[0].sizes + cases[1].sizes,
    )


def causes():
    """Return the table of causes over the four worlds."""
    table = []

    def add(kind, family, targets, minus, plus):
        targets = (targets,) if targets is None or isinstance(targets, str) else tuple(targets)
        table.append(Row(kind, family, targets, (minus, plus)))

    for kind in ("hopper", "halfcheetah", "ant"):
        bodies, joints, motors, sensors = _elements(kind)
        ant = kind == "ant"
        add(kind, "mass", bodies, 1.5, 1.2)
        add(kind, "mass", "all", 1.0, 1.0)
        add(kind, "length", bodies if kind == "hopper" else bodies[1:], 0.5, 0.4)
        add(kind, "gravity", None, 0.8, 0.6)
        add(kind, "tilt", ("x", "y") if ant else "x", 0.6, 0.6)
        add(kind, "damping", joints, {"hopper": 0.9, "halfcheetah": 1.3, "ant": 0.9}[kind], 6.0)
        add(kind, "dry_friction", joints, 0.0, 30.0)
        add(kind, "gain", motors, 0.8, 0.8)
        add(kind, "delay", "action", 0.0, {"hopper": 0.008, "halfcheetah": 0.05, "ant": 0.05}[kind])
        add(kind, "scale", sensors, 0.3, 0.3)
        add(kind, "inertia", bodies, 1.5, 1.2)
    for kind in ("hopper", "halfcheetah"):
        bodies, joints, motors, sensors = _elements(kind)
        add(kind, "length", "all", 0.5, 0.4)
        add(kind, "centre_of_mass", ("torso.x", "torso.z"), 0.15, 0.15)
        add(kind, "wind", ("x", "z"), 100.0, 100.0)
        add(kind, "air_drag", ("x", "all"), 0.0, 20.0)
        add(kind, "position_friction", joints, 0.0, 20.0)
        add(kind, "stiffness", joints, 0.0 if kind == "hopper" else 50.0, 60.0)
        add(kind, "bias", sensors, 0.3, 0.3)
        add(kind, "gain", "all", 0.8, 0.8)
        add(kind, "contact_friction", "all", 1.0, 1.0)
    add("hopper", "armature", _elements("hopper")[1], 0.9, 2.0)
    add("hopper", "restitution", "all", 1.5, 0.7)
    add("halfcheetah", "damping", "all", 0.0, 4.0)
    add("ant", "armature", _elements("ant")[1], 0.9, 2.0)
    add("ant", "timestep", None, 1.1, 0.6)
    add("puck", "mass", "puck", 0.7, 0.7)
    add("puck", "tilt", ("x", "y"), 0.3, 0.3)
    add("puck", "gain", ("push_x", "push_y", "twist"), 0.8, 0.8)
    add("puck", "air_drag", ("x", "y", "all"), 0.0, 3.0)
    add("puck", "damping", ("x", "y"), 0.0, 2.0)
    add("puck", "stiffness", ("x", "y"), 0.0, 4.0)
    add("puck", "contact_friction", "all", 1.0, 1.0)
    add("puck", "contact_anisotropy", "all", 1.0, 1.0)
    add("puck", "restitution", "all", 0.8, 0.8)
    add("puck", "centre_of_mass", ("puck.x", "puck.y"), 0.03, 0.03)
    add("puck", "delay", "action", 0.0, 0.02)
    add("puck", "scale", ("qvel.x", "qvel.y", "qvel.spin"), 0.3, 0.3)
    return tuple(table)


def cut():
    """Return 40 rows of the table of causes, ten for each world, every family among them."""
    rows, seen = [], Counter()
    for kind in KINDS:
        mine = [row for row in causes() if row.kind == kind]
        for _ in range(10):
            # The family least often hidden so far; of those, the one that the table has last.
            row = min(reversed(mine), key=lambda row: seen[row.family])
            mine.remove(row)
            rows.append(row)
            seen[row.family] += 1
    return tuple(rows)


def outside():
    """Return the table of effects that are in no list."""
    table = []
    for kind in ("hopper", "halfcheetah", "ant"):
        _, joints, motors, _ = _elements(kind)
        table += [
            Row(kind, "quadratic_friction", joints, (0, 3.0)),
            Row(kind, "stribeck_friction", joints, (0, 20.0)),
            Row(kind, "one_sided_spring", joints, (0, 300.0)),
            Row(kind, "saturation", motors, (0, 0.9)),
            Row(kind, "dead_band", motors, (0, 0.8)),
            Row(kind, "speed_gain", motors, (0, 1.0)),
        ]
    table += [
        Row("hopper", "periodic_force", ("x", "z"), (0, 200.0)),
        Row("halfcheetah", "cubic_spring", _elements("halfcheetah")[1], (0, 2000.0)),
        Row("halfcheetah", "magnet", ("1.0", "-1.0"), (300.0, 300.0)),
        Row("puck", "quadratic_friction", ("spin",), (0, 0.01)),
        Row("puck", "magnet", ("0.2", "-0.2"), (2.0, 2.0)),
        Row("puck", "cubic_spring", ("x", "y"), (0, 20.0)),
        Row("puck", "periodic_force", ("x", "y"), (0, 5.0)),
        Row("puck", "dead_band", ("push_x", "push_y"), (0, 0.8)),
    ]
    return tuple(table)


CONDITIONS = ("normal", "light", "heavy", "long", "short", "some_inverted", "inverted", "some_off")


def condition(kind, label):
    """Return what Table I of the paper hides in a robot under ``label``."""
    motors = actuator_names(nominal_model(kind))
    return {
        "normal": (),
        "light": (("mass", "all", 0.5),),
        "heavy": (("mass", "all", 2.0),),
        "long": (("length", "all", 1.5),),
        "short": (("length", "all", 0.5),),
        "some_inverted": tuple(("gain", motor, -1.0) for motor in motors[1::2]),
        "inverted": (("gain", "all", -1.0),),
        "some_off": tuple(("gain", motor, 0.0) for motor in motors[1::2]),
    }[label]


def _elements(kind):
    """Return the bodies, joints, motors and sensors that a seed chooses from."""
    model = nominal_model(kind)
    bodies = [body for body in body_names(model) if not (kind == "ant" and "leg" in body)]
    joints = tuple(model.joint(j).name for j in hinges(model))
    # A robot's place in the world changes nothing, and a free joint's orientation is no single number.
    sensors = [
        channel
        for channel in channel_names(kind)
        if not channel.startswith("ctrl.") and channel not in ("qpos.rootx", "qpos.rooty")
        if not channel.startswith("qpos.root.")
    ]
    return tuple(bodies), joints, tuple(actuator_names(model)), tuple(sensors)


def _hash(text):
    # Python's own hash of text differs from run to run.
    return int.from_bytes(text.encode(), "little") % (2**31 - 1)
