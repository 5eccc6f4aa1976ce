"""Sets of causes at fits of their own: values, noise and path, and what the log says for them."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from skat.diagnosis.chains import Array
from skat.diagnosis.evidence import NO_CAUSE, WIDTH_95, Gram, Priors, Weighed, weigh
from skat.diagnosis.fitting import (
    STILL,
    Fitted,
    Known,
    bent_rows,
    bound_at,
    compared,
    coordinate,
    doubled,
    first_fit,
    gram_of,
    next_fit,
    slopes_of,
    value_at,
)
from skat.diagnosis.statespace import Linear, StateSpace
from skat.effects import Effect

# Of its standard errors: values that move by less stand still.
STANDS_STILL = 0.1
# Steps of Gauss and Newton in the fit of a set; one that leads to where the log is less likely is halved.
FIT_TURNS = 16


@dataclass(frozen=True)
class Fit:
    """A set of causes, at values, a noise and about a path of its own.

    Attributes
    ----------
    members : tuple of int
        Places of the effects, ascending.
    values : dict of str to float
    fitted : Fitted
    evidence : float
        Log evidence of the set at these values, beside what all sets have in common, nats.
    widths : ndarray of shape (len(members),)
        Over which slopes by the values were taken, in coordinates.
    """

    members: tuple[int, ...]
    values: dict[str, float]
    fitted: Fitted
    evidence: float
    widths: Array


@dataclass(frozen=True)
class Fits:
    """Fits sets of causes to a log.

    Attributes
    ----------
    space : StateSpace
    effects : tuple of Effect
    priors : Priors
    known : Known
        Of the sensors' noise.
    power : float
        To which the likelihood is taken.
    """

    space: StateSpace
    effects: tuple[Effect, ...]
    priors: Priors
    known: Known
    power: float

    def first(self, look: Linear | None = None) -> Fit:
        """Return the fit of no cause, about a path from the log alone, begun with slopes that are known."""
        fitted = first_fit(self.space, {}, self.known, look)
        return self._weighed((), fitted, np.zeros(0))[0]

    def of(
        self,
        members: Sequence[int],
        places: Array,
        near: Fit,
        *,
        own_slopes: bool = True,
        guessed: bool = True,
    ) -> Fit:
        """Return the fit of a set, about the path and from the noise of another fit.

        Parameters
        ----------
        members : sequence of int
        places : ndarray of shape (len(members),)
            Coordinates to begin with.
        near : Fit
        own_slopes : bool, default=True
            Whether path and slopes by the state are its own; see `next_fit` and `compared`.
        guessed : bool, default=True
            Whether no fit has found these coordinates: with slopes of another, what has kinks is tried elsewhere, too.
        """
        members = tuple(members)
        origin = np.array([self._place(one, near.values) for one in members])
        if guessed and not own_slopes:
            places = self._by_profile(members, places, near)
        # What the set has beside `near` cannot make the log less likely, but for a step too far.
        reached = near.fitted.bound - STILL if set(near.members) <= set(members) else -np.inf
        start, best, deviations = near.fitted, None, np.zeros(len(members))
        borrowed = False
        # Values are known to about what they were moved by last.
        widths = np.abs(places - origin)
        for turn in range(FIT_TURNS):
            values = self._values(members, places)
            # A comparison looks for a memory once, and again where values were still too far off to show one.
            looks = turn == 0 or (bool(near.fitted.memory) and not start.memory)
            fitted = (
                self._next(values, start) if own_slopes else self._compared(values, start, memories=looks)
            )
            # Within its standard errors no step goes too far; one that does needs no slopes to be halved.
            less = fitted.bound < reached
            if less and best is not None and np.any(np.abs(places - origin) > deviations):
                places = (np.asarray(places) + origin) / 2
                widths = np.abs(places - origin)
                continue
            fit, one = self._weighed(members, fitted, widths)
            moved, deviations = one.values, one.deviations
            too_far = less and bool(np.any(np.abs(places - origin) > deviations))
            gained = np.inf if best is None or borrowed else fit.evidence - best.evidence
            step = moved - np.asarray(places)
            if best is None or gained > 0 or fitted.bound >= reached:
                best = fit
            # What a log is worth about the path of other values is not what it is worth about its own.
            borrowed = own_slopes and start is near.fitted and values != near.values
            if too_far:
                places = (np.asarray(places) + origin) / 2
                widths = np.abs(places - origin)
                continue
            still = np.all(np.abs(step) < STANDS_STILL * deviations)
            if gained < STILL or (still and not borrowed):
                break
            origin, places, start = places, moved, fitted
            reached = reached if borrowed else fitted.bound - STILL
            widths = np.maximum(np.abs(step), deviations)
        if best is None:
            raise RuntimeError("no turn was made")
        return self._least(best) if own_slopes else best

    def _by_profile(self, members: tuple[int, ...], places: Array, near: Fit) -> Array:
        """Return the coordinates to begin with, of what is new and has kinks the likeliest of its own and of a grid.

        Between whole rows, and between time steps, the likelihood of a delay has maxima of its own: of commands that
        come two rows late that of one and two thirds leads back to none. Where dry friction holds a joint, more of it
        does nothing else, and less of it, until the joint moves.
        """
        best = np.array(places, dtype=np.float64)
        for column, one in enumerate(members):
            if self.effects[one].name in near.values:
                continue
            grid = [
                np.where(np.arange(len(best)) == column, at, best) for at in self._kinks(one, best[column])
            ]
            if grid:
                best = max([*grid, best], key=lambda start: self._posterior(members, start, near))
        return best

    def _least(self, fit: Fit) -> Fit:
        """Return a fit with no more dry friction than holds a joint, where slopes say that the log would miss none.

        More does nothing, and so has no slope; what the set is worth is as before, as all that hold it are likely.
        """
        places = self.places(fit)
        for column, one in enumerate(fit.members):
            most, least = places[column], 0.0
            if self.effects[one].family != "dry_friction" or most <= 0:
                continue
            gram = self.gram(fit.fitted, (one,), fit.widths[[column]])
            missed = most * (gram.projections[0] + gram.products[0, 0] * most / 2)
            without = np.where(np.arange(len(places)) == column, 0.0, places)
            # What holds nothing is not missed at all.
            if (
                missed > STILL
                or self.unweighed(fit.members, without, fit).fitted.bound >= fit.fitted.bound - STILL
            ):
                continue
            widths, held = fit.widths.copy(), fit
            while most - least > STANDS_STILL * most:
                places[column] = (least + most) / 2
                about = self.unweighed(fit.members, places, fit)
                if about.fitted.bound < held.fitted.bound - STILL:
                    least = places[column]
                else:
                    most, held = places[column], about
            places[column], widths[column] = most, most - least
            fit = replace(held, evidence=fit.evidence, widths=widths)
        return fit

    def most_likely(self, fit: Fit, member: int) -> float:
        """Return the largest coordinate of a cause at which its profile is within its 95 % interval: of dry friction.

        What holds a joint holds it with any more. Of other causes it is where the fit has it.
        """
        places, column = self.places(fit), fit.members.index(member)
        found = float(places[column])
        least = fit.fitted.bound - WIDTH_95**2 / 2
        for at in self._kinks(member, found) if self.effects[member].family == "dry_friction" else ():
            if at <= found:
                continue
            places[column] = at
            if self.bound(fit.members, places, fit) < least:
                break
            found = float(at)
        return found

    def _kinks(self, member: int, place: float) -> Array:
        """Return the coordinates from which an effect with kinks may have to be begun, nearest to neutral first."""
        effect, row = self.effects[member], self.space.simulator.dt
        if effect.family == "delay" and row:
            rows: Array = row * np.unique([np.floor(place / row), np.ceil(place / row)])
            beside: Array = rows[(rows > 0) & (rows <= effect.bounds[1]) & (rows != place)]
            return beside
        if effect.family == "dry_friction":
            return doubled(float(self.priors.scales[member]) / 2, coordinate(effect, effect.bounds[1]))
        return np.zeros(0)

    def _posterior(self, members: tuple[int, ...], places: Array, near: Fit) -> float:
        prior = self.priors.log_density(members, places).sum()
        return float(self.power * self.bound(members, places, near) + prior)

    def bound(self, members: tuple[int, ...], places: Array, near: Fit) -> float:
        """Return the bound of a set at given coordinates, about the path of another fit and with its slopes."""
        return bound_at(self.space, self._values(members, places), near.fitted, self.known)

    def about(self, members: Sequence[int], places: Array, near: Fit) -> Fit:
        """Return a set as it is at given places, about the path of another fit but with slopes of its own."""
        there = self.unweighed(members, places, near)
        return self._weighed(there.members, there.fitted, there.widths)[0]

    def unweighed(self, members: Sequence[int], places: Array, near: Fit) -> Fit:
        """Return the same without slopes by the effects: nothing is known of its evidence."""
        fitted = self._next(self._values(members, places), near.fitted)
        return Fit(tuple(members), dict(fitted.values), fitted, np.nan, np.zeros(len(members)))

    def bends(self, fit: Fit) -> bool:
        """Whether some row of a fit is bent; see `bent_rows`."""
        return bool(bent_rows(self.space, fit.fitted).any())

    def places(self, fit: Fit) -> Array:
        """Return the coordinates of a fit's values."""
        return np.array([self._place(one, fit.values) for one in fit.members])

    def gram(self, fitted: Fitted, members: Sequence[int], widths: Array | None = None) -> Gram:
        """Return the Gram matrices of some effects at a fit; see `slopes_of`."""
        chosen = [self.effects[one] for one in members]
        slopes = slopes_of(self.space, fitted, chosen, self.priors.scales[list(members)], widths, means=True)
        return gram_of(self.space, fitted, slopes, chosen).gram

    def _next(self, values: Mapping[str, float], start: Fitted) -> Fitted:
        return next_fit(self.space, values, start, self.known)

    def _compared(self, values: Mapping[str, float], start: Fitted, *, memories: bool = True) -> Fitted:
        return compared(self.space, values, start, self.known, memories=memories)

    def _values(self, members: Sequence[int], places: Array) -> dict[str, float]:
        chosen = [self.effects[one] for one in members]
        return {effect.name: value_at(effect, at) for effect, at in zip(chosen, places)}

    def _place(self, member: int, values: Mapping[str, float]) -> float:
        effect = self.effects[member]
        return coordinate(effect, values.get(effect.name, effect.neutral))

    def _weighed(self, members: tuple[int, ...], fitted: Fitted, widths: Array) -> tuple[Fit, Weighed]:
        """Return a fit, and the set as slopes have it: where they would move its values."""
        values = dict(fitted.values)
        if not members:
            evidence = self.power * fitted.bound
            return Fit((), values, fitted, evidence, widths), NO_CAUSE
        gram, priors = self.gram(fitted, members, widths), self.priors.part(members)
        one = weigh(gram, priors, range(len(members)), power=self.power)
        evidence = self.power * (fitted.bound - one.likelihood) + one.evidence
        return Fit(members, values, fitted, evidence, widths), one


__all__ = ["STANDS_STILL", "Fit", "Fits"]
