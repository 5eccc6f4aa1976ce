"""What a map is worth outside of what it was fitted to, and when the world changes.

Run from the root of the repository, some two minutes::

    python benchmarks/shift.py > benchmarks/results/shift.txt

Four tables. *Own law*: the share of fresh rows of the fitted law that ``in_support`` flags at a level of 99 %, for
five laws. *Later rows*: a map fitted to the first 20 steps of Hopper's episodes, tested on steps from 35 on, for each
of seven target worlds: the error by distance, and which share of the rows whose error is above twice the fit's is
flagged. *A world that changes*: batches of 25 pairs from one world and, from half way on, another; errors on the next
batch by ``partial_fit`` that forgets nothing, that forgets at a half-life chosen on past batches only, and by a refit
to the rows since the change, which nobody knows. *Near domains*: 2,000 source rows of 10 columns and few target rows of
a law near theirs, with the mean so many standard deviations off; root mean square error of the map, in standard
deviations of the source, over 100 draws.
"""

import subprocess
import sys

import numpy as np
import pandas as pd

from skat import AffineTransport, ProcrustesAffineTransport
from skat.experiments.robots import CONDITIONS, N_STEPS, replay_transitions
from skat.experiments.scores import pointwise_errors
from skat.gaussian import transport_map

LAWS = {
    "normal": lambda rng, size: rng.normal(size=size),
    "uniform": lambda rng, size: rng.uniform(size=size),
    "exponential": lambda rng, size: rng.exponential(size=size),
    "t3": lambda rng, size: rng.standard_t(3, size=size),
    "bimodal": lambda rng, size: rng.choice([-3.0, 3.0], size=size) + rng.normal(size=size),
}
HALF_LIVES = (50, 100, 200, 400, 800, 1600, None)
BATCH, N_BATCHES = 25, 80


def main():
    commit = subprocess.run(
        ["git", "describe", "--always", "--dirty"], capture_output=True, text=True
    ).stdout.strip()
    print(f"commit {commit}: {' '.join(sys.argv)}\n")
    for name, table in (
        ("Own law", own_law()),
        ("Later rows", later_rows()),
        ("A world that changes", changes()),
        ("Near domains", near_domains()),
    ):
        print(f"{name}\n{table.to_string(index=False, float_format='{:.3f}'.format)}\n", flush=True)


def own_law():
    rng = np.random.default_rng(0)
    records = []
    for law, draw in LAWS.items():
        shape = rng.normal(size=(10, 10))
        fitted, fresh = draw(rng, (4000, 10)) @ shape, draw(rng, (50_000, 10)) @ shape
        inside = AffineTransport().fit(fitted, fitted).in_support(fresh)
        records.append({"law": law, "flagged, %": 100 * (1 - inside.mean()), "to be, %": 1.0})
    return pd.DataFrame(records)


def later_rows():
    replay = replay_transitions("hopper", n_transitions=10_000, random_state=0)
    step = np.arange(len(replay.X)) % N_STEPS
    episode = np.arange(len(replay.X)) // N_STEPS
    early, own, late = (step < 20) & (episode % 2 == 0), (step < 20) & (episode % 2 == 1), step >= 35
    source, records = replay.rows("normal"), []
    for condition in CONDITIONS[1:]:
        target = replay.rows(condition)
        transport = ProcrustesAffineTransport().fit(source[early], target[early])
        error = pointwise_errors(transport.transform(source), target, replay.context)
        distance, outside = transport.support_distance(source), ~transport.in_support(source)
        bad = late & (error > 2 * error[own].mean())
        quartiles = np.quantile(distance[late], [0.25, 0.75])
        records.append(
            {
                "target": condition,
                "error, fit's steps": error[own].mean(),
                "late": error[late].mean(),
                "late, nearest quarter": error[late & (distance <= quartiles[0])].mean(),
                "farthest quarter": error[late & (distance >= quartiles[1])].mean(),
                "flagged, fit's steps": outside[own].mean(),
                "flagged, late": outside[late].mean(),
                "flagged of late errors > 2x": outside[bad].mean(),
            }
        )
    return pd.DataFrame(records)


def changes():
    replay = replay_transitions("hopper", n_transitions=BATCH * N_BATCHES, random_state=0)
    order = np.random.default_rng(0).permutation(len(replay.X))
    source, before, records = replay.rows("normal")[order], replay.rows("light")[order], []
    half = N_BATCHES // 2
    for condition in ("heavy", "long", "some_inverted"):
        after = replay.rows(condition)[order]
        target = np.vstack([before[: half * BATCH], after[half * BATCH :]])
        errors = {
            half_life: prequential(source, target, replay.context, half_life) for half_life in HALF_LIVES
        }
        chosen = chosen_on_past(errors)
        refit = since_change(source, target, replay.context, half)
        for first, last in ((0, 4), (4, 10), (10, 20), (20, 40)):
            batches = slice(half + first, half + last)
            records.append(
                {
                    "light, then": condition,
                    "rows since": f"{first * BATCH} to {last * BATCH}",
                    "no forgetting": errors[None][batches].mean(),
                    "half-life chosen on the past": chosen[batches].mean(),
                    "best half-life afterwards": min(errors[h][batches].mean() for h in HALF_LIVES),
                    "refit to rows since": np.nanmean(refit[batches]),
                }
            )
    return pd.DataFrame(records)


def prequential(source, target, context, half_life):
    """Return the error on each batch before it is added."""
    transport, errors = ProcrustesAffineTransport(), np.full(N_BATCHES, np.nan)
    for k in range(N_BATCHES):
        rows = slice(k * BATCH, (k + 1) * BATCH)
        if k >= 2:
            errors[k] = pointwise_errors(transport.transform(source[rows]), target[rows], context).mean()
        transport.partial_fit(source[rows], target[rows], half_life=half_life)
    return errors


def chosen_on_past(errors):
    """Return the errors of the half-life that was best over the four batches before each."""
    table = np.array([errors[half_life] for half_life in HALF_LIVES])
    chosen = np.full(N_BATCHES, np.nan)
    for k in range(3, N_BATCHES):
        best = np.nanmean(table[:, max(k - 4, 0) : k], axis=1).argmin()
        chosen[k] = table[best, k]
    return chosen


def since_change(source, target, context, half):
    """Return the errors on each batch of a map fitted to what has come since the change, from two batches on."""
    errors = np.full(N_BATCHES, np.nan)
    for k in range(half + 2, N_BATCHES):
        seen, rows = slice(half * BATCH, k * BATCH), slice(k * BATCH, (k + 1) * BATCH)
        transport = ProcrustesAffineTransport().fit(source[seen], target[seen])
        errors[k] = pointwise_errors(transport.transform(source[rows]), target[rows], context).mean()
    return errors


def near_domains():
    records = []
    for shift in (0.0, 0.5, 2.0):
        for n_rows in (15, 30, 100):
            rng, squares = np.random.default_rng(0), []
            for _ in range(100):
                root = rng.normal(size=(10, 10))
                change = root @ (np.eye(10) + 0.1 * rng.normal(size=(10, 10)))
                off = shift * (root @ rng.normal(size=10)) / np.sqrt(10)
                X, y = rng.normal(size=(2000, 10)) @ root.T, rng.normal(size=(n_rows, 10)) @ change.T + off
                truth = off + X @ transport_map(root @ root.T, change @ change.T).T
                maps = {
                    "identity": X,
                    "empirical": AffineTransport().fit(X, y).transform(X),
                    "shrunk covariance": AffineTransport(covariance="shrunk").fit(X, y).transform(X),
                    "and mean": AffineTransport(covariance="shrunk", mean="shrunk").fit(X, y).transform(X),
                }
                squares.append(
                    {
                        name: np.square(np.linalg.solve(root, (carried - truth).T)).sum(axis=0).mean()
                        for name, carried in maps.items()
                    }
                )
            errors = np.sqrt(pd.DataFrame(squares).mean() / 10)
            records.append({"mean off by": shift, "target rows": n_rows, **errors})
    return pd.DataFrame(records)


if __name__ == "__main__":
    main()
