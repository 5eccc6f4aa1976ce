"""Worlds with hidden effects: measured logs whose truth is known, made without any code of ``skat``.

A world is a nominal model, effects hidden in it as raw edits or forces, another solver of the contacts, and
sensors with Student-t noise of 1 % of each channel's spread, rounded to a grid.
`measure` gives what a user would have: rows of inputs and outputs. `Log.excess` gives what a user has not:
how much larger the nominal model's error is than the true model's.
"""

from worlds.logs import Log, channel_names, measure, size_for
from worlds.models import FRAME_SKIP, KINDS, body_names, nominal_mjcf, nominal_model

__all__ = [
    "FRAME_SKIP",
    "KINDS",
    "Log",
    "body_names",
    "channel_names",
    "measure",
    "nominal_mjcf",
    "nominal_model",
    "size_for",
]
