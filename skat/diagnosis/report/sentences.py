"""The findings in sentences."""

from __future__ import annotations

from collections.abc import Mapping, Sequence, Sized
from typing import TYPE_CHECKING, Any

import numpy as np

from skat.diagnosis.comparison import ceiling_sentence, is_beaten
from skat.diagnosis.remainder import PAST, is_unexplained
from skat.diagnosis.report.tables import GAP, is_guarded, plain_unit, probability_text
from skat.rounding import amount, interval_text, size_text
from skat.simulators.base import Simulator, is_sensor

if TYPE_CHECKING:
    import pandas as pd

    from skat.diagnosis.estimator import SimulationDiagnosis
    from skat.diagnosis.findings import Cause, Gain
    from skat.diagnosis.remainder import Left

# An error of less than so many times the floor says little of a share of its excess.
NEAR_FLOOR = 2.0
MANY_CAUSES = 4
# So far out in its tail a normal law is no longer to be believed.
LEAST_P = 1e-9
# Beyond rounding, no cause explains more than all of an excess.
MOST_EXPLAINED = 1.05


def verdict_sentences(diagnosis: SimulationDiagnosis, comparisons: Sequence[pd.DataFrame]) -> list[str]:
    """Return the verdict of a diagnosis in sentences.

    `diagnosis`: fitted. `comparisons`: from `compare_transports`; where a transport does better, the verdict says so.
    """
    unexplained = diagnosis.verdict_ == "unexplained"
    neutral = {effect.name: effect.neutral for effect in diagnosis.simulator.effects(also="all")}
    sentences = [cause_sentence(cause, neutral.get(cause.name, 0.0)) for cause in diagnosis.causes_]
    for cause in diagnosis.causes_:
        if cause.aliases:
            others = [f"{alias.name} ({plain_percent(alias.probability)})" for alias in cause.aliases]
            each = "each of them" if len(others) > 1 else "it"
            sentences.append(
                f"These data cannot tell {cause.name} from {listed(others)}: put in its place, {each} explains the "
                "log nearly as well."
            )
    sentences += cautions(diagnosis.causes_)
    if diagnosis.agreement_ is not None:
        sentences += [_agreement(row) for row in diagnosis.agreement_.to_dict("records")]
    if diagnosis.verdict_ == "nothing detected":
        looked_at = "What was looked at" if is_first_look(diagnosis) else "The log"
        sentences.append(
            f"{looked_at} shows no difference from the simulation that noise and random forces would not explain."
        )
    if unexplained:
        rest = remainder_sentence(diagnosis)
        sentences.insert(
            0, f"Beside what is named below, {rest}." if diagnosis.causes_ else f"{capital(rest)}."
        )
    elif clear_parts(diagnosis):
        within = f"Less than the tolerance of {100 * diagnosis.tolerance:g} %, but no chance"
        sentences.append(f"{within}: {left_sentence(_largest(clear_parts(diagnosis)))}.")
    if is_first_look(diagnosis):
        sentences.insert(
            0,
            f"A first look, at {diagnosis.n_rows_fitted_:,} of {diagnosis.n_rows_:,} rows: smaller causes are not "
            "seen, and a whole fit (without quick) is to confirm what is named.",
        )
    return sentences + [
        ceiling_sentence(errors) for errors in comparisons if unexplained or is_beaten(errors)
    ]


def _agreement(row: Mapping[Any, Any]) -> str:
    """Return what several logs say of a cause by themselves, and whether they agree."""
    start, unit = "value in ", "" if row["unit"] in ("", "1") else f" {row['unit']}"
    told = [
        f"{value:.3g}{unit} in {name.removeprefix(start)}"
        for name, value in row.items()
        if name.startswith(start) and not np.isnan(value)
    ]
    if row["agreement"] == "not compared":
        return f"Of {row['cause']} not more than one log tells a value by itself."
    agree = "agree" if row["agreement"] == "agree" else "do not agree"
    return f"On {row['cause']} the logs {agree} ({p_text(row['p_corrected'])}): {', '.join(told)}."


def p_text(p: float) -> str:
    """Return a p-value in words, no smaller than a normal law is to be believed."""
    return f"p < {LEAST_P:.0e}" if p < LEAST_P else f"p = {p:.2g}"


def cautions(causes: Sequence[Cause]) -> list[str]:
    """Return the sentences of caution about causes, a list."""
    sentences = []
    if len(causes) >= MANY_CAUSES:
        sentences.append("So many causes together may stand for one that is not in the list.")
    sensors = [cause.name for cause in causes if is_sensor(cause.name)]
    if sensors and len(sensors) < len(causes):
        sentences.append(
            f"{listed(sensors)} beside another cause may stand for something that is not in the list: check what the "
            "sensor reads where the true value is known."
        )
    if any(cause.family == "delay" for cause in causes):
        sentences.append(
            "A filter that delays the velocities measured, and motors that answer slowly, look like a delay of the "
            "commands: rule them out."
        )
    return sentences


def gain_sentence(diagnosis: SimulationDiagnosis, gain: Gain) -> str:
    """Return a Gain of a fitted diagnosis in a sentence."""
    before, after = amount(gain.nominal), amount(gain.extended)
    if gain.horizon == "episode":
        text = f"the open-loop error of whole episodes goes from {before} to {after}"
    else:
        simulator = diagnosis.simulator
        where = f" {horizon_text(simulator, gain.horizon)}" if simulator.state_names else ""
        text = f"the squared error{where} goes from {before} to {after} times what a right model has"
    return f"{text}; {share_sentence(diagnosis, gain)}"


def horizon_text(simulator: Simulator, horizon: float | str) -> str:
    """Return in words how far ahead a Gain predicts."""
    if horizon == "episode":
        return "whole episodes"
    if not simulator.state_names:
        return "each row by itself"
    if simulator.dt:
        return f"{horizon:.3g} s ahead"
    return f"{horizon:g} row{'' if horizon == 1 else 's'} ahead"


def share_sentence(diagnosis: SimulationDiagnosis, gain: Gain) -> str:
    """Return in a sentence which share of the excess a Gain of a fitted diagnosis explains."""
    share, low, high = (f"{100 * one:.0f}" for one in (gain.explained, *gain.interval))
    pieces = "episodes" if gain.horizon == "episode" else "rows"
    is_wide = gain.interval[1] - gain.interval[0] > 1
    is_near = gain.nominal <= gain.floor or (is_wide and gain.nominal < NEAR_FLOOR * gain.floor)
    # A share of more than all of it says that the floor is too high.
    if (is_near or gain.explained > MOST_EXPLAINED) and _hides_in_the_noise(diagnosis):
        return "the noise estimate itself contains what is unexplained, so that no share of it can be given."
    if gain.nominal <= gain.floor:
        return "the simulation's error was no larger than a right model's, so that there is no excess to explain."
    if is_near:
        return "that is too close to the noise to say which share of the excess is explained."
    if is_wide:
        return f"{share} % of the excess is explained, in too few {pieces} to bound the share."
    if np.isnan(gain.interval[0]):
        return f"{share} % of the excess is explained, in too few {pieces} for an interval."
    return f"{share} % of the excess is explained (95 %: {low} to {high} %)."


def remainder_sentence(diagnosis: SimulationDiagnosis) -> str:
    """Return in words why a verdict is "unexplained"."""
    if not is_law_left(diagnosis):
        if apart := diagnosis._apart():
            return f"the logs do not agree on {listed(apart)}"
        if not diagnosis.settled_:
            return (
                "the search for causes had not come to rest: its turns were over, or fits and slopes differ"
            )
        return f"the simulation diverges in {100 * diagnosis.diverged_share_:.0f} % of the rows, which tell nothing"
    return left_sentence(_largest(clear_parts(diagnosis)))


def _largest(parts: Sequence[Left]) -> Left:
    return max(parts, key=lambda part: (part.ahead, part.predictable / part.scale))


def left_sentence(part: Left) -> str:
    """Return in words what a `Left` of the remainder follows."""
    unit = plain_unit(part.unit)
    size = f"{part.predictable:.2g} {unit}".rstrip()
    size += f" (rms), {100 * part.predictable / part.scale:.2g} % of what acts there,"
    if part.regressor == "constant":
        return f"at {part.name} {size} are left at all times, which no cause explains"
    if part.regressor == PAST:
        looks = "" if part.word in ("none", "white") else f" ({part.word})"
        return f"what is left at {part.name} goes on as before{looks}: its past predicts {size} that no cause explains"
    return f"what is left at {part.name} depends on {part.regressor}, which predicts {size} that no cause explains"


def is_first_look(diagnosis: SimulationDiagnosis) -> bool:
    """Whether a part of the rows was left out of a fit, so that a whole fit may say more."""
    return diagnosis.n_rows_fitted_ < diagnosis.n_rows_


def clear_parts(diagnosis: SimulationDiagnosis) -> list[Left]:
    """Return the parts of what is left that follow a law beyond chance."""
    return [part for part in diagnosis.remainder_.parts if part.evidence > -np.log(diagnosis.alpha)]


def is_law_left(diagnosis: SimulationDiagnosis) -> bool:
    """Whether what is left follows a law that matters; else an unexplained verdict has another reason."""
    gain = None if diagnosis._prediction is None else diagnosis._prediction.gain
    return is_unexplained(diagnosis.remainder_, gain, tolerance=diagnosis.tolerance, alpha=diagnosis.alpha)


def _hides_in_the_noise(diagnosis: SimulationDiagnosis) -> bool:
    """Whether what is unexplained counted as noise, or as a random force, where that was estimated."""
    is_estimated = isinstance(diagnosis.noise, str) or bool(diagnosis.simulator.state_names)
    return diagnosis.verdict_ == "unexplained" and is_estimated and is_law_left(diagnosis)


def cause_sentence(cause: Cause, neutral: float = 0.0) -> str:
    """Return a Cause in a sentence, with its interval; without a size where the interval says none.

    `neutral`: the value at which it does nothing.
    """
    if is_guarded(cause.value, cause.interval, neutral):
        unit = "" if cause.unit in ("", "1") else f" {cause.unit}"
        ends = interval_text(cause.interval).replace(" to ", " and ")
        return f"{cause.name} lies between {ends}{unit} (95 %), too wide to say a size."
    sentence = cause.sentence if cause.sentence.startswith(cause.name) else capital(cause.sentence)
    end = (
        "; the estimate is at the end of the range allowed, so something else may be behind it"
        if cause.at_bound
        else ""
    )
    interval = f"95 %: {interval_text(cause.interval)}"
    low, high = cause.interval
    if low <= cause.value <= high and not low <= float(f"{cause.value:.3g}") <= high:
        # Rounded as in the sentence, the value would lie outside its own interval.
        interval = f"{size_text(cause.value, cause.interval)}; {interval}"
    return f"{sentence.rstrip('.')} ({interval}){end}."


def capital(text: str) -> str:
    """Return a text that begins a sentence."""
    return text[:1].upper() + text[1:]


def counted(things: Sized, word: str) -> str:
    """Return how many things there are, in words."""
    return f"{len(things)} {word}{'' if len(things) == 1 else 's'}"


def plain_percent(probability: float) -> str:
    """Return a probability in percent, for a line of text."""
    return probability_text(probability).replace(GAP, " ")


def listed(names: Sequence[str]) -> str:
    """Return names as a sentence lists them."""
    *first, last = names
    return f"{', '.join(first)} and {last}" if first else last
