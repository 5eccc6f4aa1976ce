"""What all figures share: colours, markers, axes, and how a column is named."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from collections.abc import Sequence

    from matplotlib.axes import Axes
    from matplotlib.figure import Figure, SubFigure

MEASURED, BEFORE, AFTER = "#555555", "#E69F00", "#0072B2"
METHODS = (AFTER, "#D55E00", "#009E73", "#CC79A7", BEFORE, "#56B4E9", "#000000")
MARKERS = "osD^vPX"


def new_axes(ax: Axes | None, size: tuple[float, float]) -> tuple[Axes, Figure | SubFigure]:
    """Return Axes and their figure, new ones of a size in inches where there are none."""
    from matplotlib import pyplot

    if ax is None:
        _, ax = pyplot.subplots(figsize=size, layout="constrained")
    return ax, ax.figure


def trim(ax: Axes) -> None:
    """Leave out the frame at the top and to the right."""
    ax.spines[["top", "right"]].set_visible(False)


def column_of(feature: int | str, names: Sequence[str], n_columns: int) -> int:
    """Return the index of a column given by index or by name."""
    if isinstance(feature, str):
        if feature not in names:
            raise ValueError(f"there is no column {feature!r}; there are {names}.")
        return names.index(feature)
    if not isinstance(feature, int | np.integer) or isinstance(feature, bool):
        raise ValueError(f"a column is given by number or by name; {feature!r} is neither.")
    if not -n_columns <= feature < n_columns:
        raise ValueError(f"there is no column {feature}; there are {n_columns}.")
    return int(feature) % n_columns
