"""What is told of two logs: causes with intervals and aliases, the gain on windows held out, and sizes of forces."""

from collections.abc import Mapping
from dataclasses import dataclass, field, replace

import numpy as np

from skat.diagnosis.chains import Array, Mask
from skat.diagnosis.changes.question import Question
from skat.diagnosis.changes.strengths import OverStrengths
from skat.diagnosis.evidence import Weighed, Weigher
from skat.diagnosis.findings import Alias, Cause, Gain
from skat.diagnosis.forces.force_space import joined
from skat.diagnosis.forces.machines import Candidate
from skat.diagnosis.prediction import measured_gain
from skat.diagnosis.search import ALIAS_FACTOR, alternatives
from skat.simulators import MujocoSimulator

# Changes that are tried, in typical sizes.
TRIED = np.geomspace(0.01, 100, 81)


@dataclass(frozen=True)
class Changes:
    """What changed between two logs.

    Attributes
    ----------
    changes : tuple of Cause
        Most telling first. The value is by how much an effect is more in the second log; of factors, how many times
        what it was.
    verdict : {"nothing changed", "named", "ambiguous", "unexplained"}
    gain : Gain or None
        Of windows of the second log that were held out: mean squared missing force over its noise, with what is
        common in the model, and with the changes, too; the channels are rms forces, N or N m.
    common : dict of str to tuple of two floats
        Of each degree of freedom, by the name of its speed: rms force that the model as it is lacks in the two logs,
        and what is left with all that is common in it, N or N m; of servos that exert no more than they may.
    mistake : str
        How columns of the second log seem to be mixed up, or which motor is as good as dead in it; empty if none.
    reason : str
        Why the verdict is "unexplained", in a sentence; empty of all others.
    detectable : dict of str to float
        Where nothing changed: of each effect by how much it would have had to change, either way, to be named; of
        factors the share of what it is. Infinite where no possible change would have been.
    """

    changes: tuple[Cause, ...]
    verdict: str
    gain: Gain | None
    common: dict[str, tuple[float, float]]
    mistake: str = ""
    reason: str = ""
    detectable: Mapping[str, float] = field(default_factory=dict)


def causes_of(
    question: Question, best: Weighed, worth: Weigher, nats: Mapping[int, float]
) -> tuple[Cause, ...]:
    """Return the members of a set as they are told, most telling first.

    Parameters
    ----------
    question : Question
    best : Weighed
        The set that is named; its values are in units of scales.
    worth : Weigher
        By which others are about as likely: the aliases.
    nats : mapping from place to float
        What each member is worth, in log odds.
    """
    if not best.members:
        return ()
    others = alternatives(worth(best.members), worth, np.log(ALIAS_FACTOR))
    found = []
    for place, value, half in zip(best.members, best.values, best.half_widths):
        one = question.candidates[place]
        aliases: dict[str, float] = {}
        for other, lost in others[place]:
            name = question.candidates[other].effect.name
            if name != one.effect.name:
                aliases[name] = aliases.get(name, 0.0) + float(np.exp(-lost))
        total = 1 + sum(aliases.values()) + float(np.exp(-nats[place]))
        unit = question.scales[place]
        centre = float(one.told(value * unit))
        low, high = (float(one.told((value + side * half) * unit)) for side in (-1, 1))
        found.append(
            Cause(
                name=one.effect.name,
                family=one.effect.family,
                target=one.effect.target,
                value=centre,
                interval=(low, high),
                unit=one.effect.unit,
                probability=1 / total,
                evidence=float(nats[place]),
                aliases=tuple(
                    Alias(name, share / total)
                    for name, share in sorted(aliases.items(), key=lambda pair: -pair[1])
                ),
                sentence=_sentence(one, centre),
            )
        )
    return tuple(sorted(found, key=lambda cause: -cause.evidence))


def _sentence(one: Candidate, value: float) -> str:
    words = one.effect.meaning
    if one.is_factor:
        return f"{words} is {value:.4g} times what it was"
    unit = "" if one.effect.unit == "1" else f" {one.effect.unit}"
    place = ""
    if one.beside:
        place = ", about at (" + ", ".join(f"{at:.2g}" for at in one.beside.values()) + ") m"
    return f"{words}: {abs(value):.4g}{unit} {'more' if value > 0 else 'less'} than it was{place}"


def detectable_of(question: Question, worth: OverStrengths, needed: float) -> dict[str, float]:
    """Return the least change of each effect that would have been named in the second log, in its unit.

    Either way, and all larger ones. Of weights it is that at the place on the body where they act most, of delays one
    of those that are tried; infinite where none is possible that would have been named.

    Parameters
    ----------
    question : Question
    worth : OverStrengths
    needed : float
        What a name needs, nats.
    """
    candidates, priors = question.candidates, worth.priors
    ways = [worth.gains_of(side * TRIED[:, None] * np.ones(len(candidates))) >= needed for side in (-1, 1)]
    told = np.logical_and.accumulate(np.logical_and(*ways)[::-1], axis=0)[::-1]
    least = np.where(told.any(axis=0), TRIED[np.argmax(told, axis=0)], np.inf)
    least[least > np.maximum(-priors.low, priors.high)] = np.inf
    found: dict[str, float] = {}
    for one, size, scale in zip(candidates, least, question.scales):
        if not one.late:
            found[one.effect.name] = min(found.get(one.effect.name, np.inf), float(size * scale))
    late = np.array([one.late for one in candidates])
    gains = worth.gains_of(late * question.simulator.dt / question.scales)
    for name in {one.effect.name for one in candidates if one.late}:
        missed = [abs(one) for one, gain in zip(late, gains) if one and gain < needed]
        sizes = [abs(one) for one in late if one and abs(one) > max(missed, default=0.0)]
        found[name] = min(sizes, default=np.inf) * question.simulator.dt
    return found


def gain_of(question: Question, value: Array, differences: Array) -> Gain | None:
    """Return the gain on the windows that were held out, None if none were.

    Parameters
    ----------
    question : Question
    value : ndarray of shape (n_effects,)
        What is common, in units of sizes.
    differences : ndarray of shape (n_candidates,)
        In units of scales.
    """
    mine = question.held_out
    if not mine.any():
        return None
    nominal, extended = (
        question.left(value, step)[1][mine] for step in (np.zeros(len(differences)), differences)
    )
    rows, noise = question.sides[1].part(mine), question.law.noise[1][mine]
    return measured_gain(
        np.stack([(nominal / noise) ** 2, (extended / noise) ** 2, np.ones(len(noise))]),
        rows.stretch,
        np.random.RandomState(0),
        horizon=0.0,
        channels={
            name: (_rms(nominal, own), _rms(extended, own))
            for joint, name in enumerate(_dof_names(question.simulator))
            if (own := rows.joint == joint).any()
        },
    )


def sizes_of(question: Question, value: Array) -> dict[str, tuple[float, float]]:
    """Return rms of the force that the model as it is lacks, and of what is left with what is common in it, N or N m.

    By the name of the speed of each degree of freedom, of both logs; ``value`` (n_effects,) is in units of sizes.
    """
    rows = joined([replace(side, columns=side.columns[:, :0]) for side in question.sides])
    left = np.concatenate(question.left(value, np.zeros(len(question.candidates))))
    return {
        name: (_rms(rows.nominal, rows.joint == joint), _rms(left, rows.joint == joint))
        for joint, name in enumerate(_dof_names(question.simulator))
    }


def _rms(values: Array, chosen: Mask) -> float:
    return float(np.sqrt(np.mean(values[chosen] ** 2)))


def _dof_names(simulator: MujocoSimulator) -> tuple[str, ...]:
    return tuple(simulator.residual_names[len(simulator.residual_names) // 2 :])
