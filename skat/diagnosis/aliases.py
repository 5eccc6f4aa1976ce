"""What cannot be told apart from a named effect, by this log."""

from dataclasses import replace

import numpy as np

from skat.diagnosis.evidence import is_ruled_out

# Rivals are refitted where they have at least half of the cause's direction, to first order ...
LEAST_LIKE = 0.75
# ... and leave less than this loss in noise units, or this share of it; so many of each cause.
FAR_APART = 100.0
SIMILAR = 0.1
SHORTLIST = 8
# So many are refitted whatever they leave: over wide steps, directions of effects that are the same may differ.
NEAREST = 2
# What stands in a cause's place may have far to go, and must not be refused for not having arrived.
REFIT_STEPS = 30


def find_aliases(estimates, proposals, values, line, progress):
    """Return for each named effect those that, put in its place and refitted, explain the log as well.

    Parameters
    ----------
    estimates : Estimates
    proposals : Proposals
    values : dict of str to float
        The final model.
    line : Linearisation
        There.
    progress : callable
        ``progress("aliases", done, total)``.

    Returns
    -------
    dict of str to tuple of str
    """
    progress("aliases", 0, len(values))
    refits = estimates.refits
    losses = refits.losses(refits.whitened([values])[0])
    aliases = {}
    for done, name in enumerate(values, start=1):
        rest = {other: value for other, value in values.items() if other != name}
        nearest = _rivals(
            estimates.effects, name, values, _with_directions(estimates, name, values, rest, line)
        )
        # Of two limits in a row the one behind shows nothing, as long as the first one is reached.
        flat = [other for k, other in enumerate(line.names) if not line.derivatives[..., k].any()]
        hidden = [other for other in flat if other != name and other not in nearest]
        models = [{**rest, rival: start} for rival, start in nearest.items()]
        models += [{**rest, **start} for start in proposals.asleep(rest, hidden)]
        for model in models:
            estimates.residuals.choose_steps(model, list(model))
        fits = refits.fit(models, n_steps=REFIT_STEPS)
        aliases[name] = tuple(
            rival
            for fit in fits
            for rival in fit.values
            if rival not in rest and not is_ruled_out(fit.losses, losses)
        )
        progress("aliases", done, len(values))
    return aliases


def _with_directions(estimates, name, values, rest, line):
    """Return the linearisation with directions for what is flat at a model in which a named effect is flat, too.

    Friction so high that nothing slides has no derivative, nor has what could stand for it: directions are then taken
    at the model without the cause, or that of the cause is what it explains, where it has none there either.
    """
    flat = [k for k in range(len(line.names)) if not line.derivatives[..., k].any()]
    own = line.names.index(name)
    if own not in flat:
        return line
    derivatives = line.derivatives.copy()
    derivatives[..., flat] = estimates.residuals.derivatives(rest, [line.names[k] for k in flat])
    if not derivatives[..., own].any():
        without, present = estimates.refits.whitened([rest, values])
        derivatives[..., own] = (without - present) / (values[name] - estimates.effects[name].neutral)
    return replace(line, derivatives=derivatives)


def _rivals(effects, name, values, line):
    """Return the effects that may stand for a named one, nearest first, and the values that match it best."""
    derivatives = line.derivatives.reshape(-1, len(line.names))
    others = [line.names.index(other) for other in values if other != name]
    others = [k for k in others if derivatives[:, k].any()]
    columns = derivatives
    if others:
        basis = np.linalg.qr(derivatives[:, others] / np.linalg.norm(derivatives[:, others], axis=0))[0]
        columns = derivatives - basis @ (basis.T @ derivatives)
    norms = np.linalg.norm(columns, axis=0)
    own = columns[:, line.names.index(name)]
    usable = norms > 1e-6 * np.maximum(np.linalg.norm(derivatives, axis=0), 1e-300)
    cosines = np.where(usable, own @ columns / np.maximum(norms * np.linalg.norm(own), 1e-300), 0.0)
    distance = values[name] - effects[name].neutral
    # To first order a rival leaves this share of what the cause explains.
    share = 1 - cosines**2
    near = (share * np.sum((own * distance) ** 2) < FAR_APART) | (share < SIMILAR)
    rivals: dict[str, float] = {}
    for k in np.argsort(share):
        like = line.names[k] not in values and share[k] < LEAST_LIKE
        if like and (near[k] or len(rivals) < NEAREST) and len(rivals) < SHORTLIST:
            effect = effects[line.names[k]]
            move = distance * cosines[k] * np.linalg.norm(own) / norms[k]
            rivals[effect.name] = float(np.clip(effect.neutral + move, *effect.bounds))
    return rivals
