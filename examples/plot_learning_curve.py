"""
How many transitions does a transport need?
===========================================

Before the robot is measured for a day one would like to know how many transitions are enough, and which
transport makes the most of them. Transports are scikit-learn estimators: pairs go in as ``X`` (simulated
rows) and ``y`` (measured rows), and `learning_curve` and `GridSearchCV` do the rest, with the scorers of
`skat.metrics`.

Here both worlds are simulated: the simulation is Gymnasium's Hopper, and the "measured" one has links half as
long again.
"""

# %%
# Pairs: the same states and actions, and what follows them in either world. A row is (state, action, next
# state), without the place in the world.

import numpy as np
import pandas as pd
from sklearn.model_selection import GridSearchCV, ShuffleSplit, learning_curve
from sklearn.pipeline import Pipeline

from skat import AffineTransport, ConditionalAffineTransport, IdentityTransport, ProcrustesAffineTransport
from skat.experiments import replay_transitions
from skat.metrics import affinity_scorer, paired_error_scorer
from skat.plotting import LearningCurveDisplay

replay = replay_transitions("hopper", n_transitions=1200, conditions=("normal", "long"), random_state=0)
X, y = replay.rows("normal"), replay.rows("long")
print(f"{X.shape[0]} pairs of {X.shape[1]} columns, of which {replay.context} are state and action")

# %%
# Two scorers. The first compares each carried row with its own partner; the second, the paper's affinity
# score, compares the two clouds of rows and sees no pairs. In both, greater is better.
#
# Always the same 300 rows are held out in a split, whatever the number to fit: affinity scores of samples of
# different sizes do not compare.

scoring = {"error": paired_error_scorer, "affinity": affinity_scorer()}
splits = ShuffleSplit(n_splits=5, test_size=300, random_state=0)
transports = {
    "affine": AffineTransport(),
    "Procrustes, whitened": ProcrustesAffineTransport(),
    "conditional on state and action": ConditionalAffineTransport(context=replay.context),
}
sizes = [50, 100, 200, 400, 800]

curves = []
for name, transport in transports.items():
    pipeline = Pipeline([("transport", transport)])
    for scorer in scoring:
        _, _, scores = learning_curve(
            pipeline,
            X,
            y,
            train_sizes=sizes,
            cv=splits,
            scoring=scoring[scorer],
            shuffle=True,
            random_state=0,
        )
        for size, of_splits in zip(sizes, scores):
            curves += [
                {"method": name, "scorer": scorer, "pairs": size, "score": score} for score in of_splits
            ]
curves = pd.DataFrame(curves)
print(curves.pivot_table(index=["scorer", "method"], columns="pairs", values="score").round(3))

# %%
# The error of a carried row, against that of the simulation as it is.

errors = curves[curves["scorer"] == "error"].assign(error=lambda frame: -frame["score"])
untouched = -paired_error_scorer(IdentityTransport().fit(X, y), X, y)
LearningCurveDisplay.from_frame(errors, size="pairs", value="error", baseline=untouched)

# %%
# The affinity score ranks the methods as the error does here, but it is flatter: more than half of the
# columns that it sees are state and action, which are right from the start.

LearningCurveDisplay.from_frame(curves[curves["scorer"] == "affinity"], size="pairs", value="score")

# %%
# Which transport, with which parameters, for 200 pairs? `GridSearchCV` swaps the whole step of the pipeline.
# It reports both scores, and takes the best by error.

few = np.random.default_rng(0).permutation(len(X))[:200]
grid = [
    {
        "transport": [AffineTransport()],
        "transport__covariance": ["empirical", "shrunk"],
        "transport__metric_scale": [None, "target"],
    },
    {
        "transport": [ProcrustesAffineTransport()],
        "transport__alignment": ["raw", "whitened"],
        "transport__covariance": ["empirical", "shrunk"],
    },
    {"transport": [ConditionalAffineTransport(context=replay.context)]},
]
search = GridSearchCV(
    Pipeline([("transport", AffineTransport())]), grid, scoring=scoring, refit="error", cv=5
)
search.fit(X[few], y[few])
found = pd.DataFrame(search.cv_results_)
with pd.option_context("display.max_colwidth", None):
    found = found.sort_values("rank_test_error")[["params", "mean_test_error", "mean_test_affinity"]]
    print(found.round(3).to_string(index=False))

# %%
# The best one, refitted to the 200 pairs, on the 1,000 others.

rest = np.setdiff1d(np.arange(len(X)), few)
print(f"simulation as it is: {untouched:.3f}")
print(f"{search.best_estimator_['transport']}: {-paired_error_scorer(search, X[rest], y[rest]):.3f}")
