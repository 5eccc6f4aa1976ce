"""Measured data from their public sources, and simulated measurements, each a `Bunch` of transitions."""

from skat.datasets.ball_drops import ball_drop_simulator, fetch_ball_drops
from skat.datasets.cube_tosses import cube_toss_simulator, fetch_cube_tosses
from skat.datasets.originals import data_home
from skat.datasets.pendulum import fetch_pendulum, pendulum_simulator
from skat.datasets.pucks import make_hidden_puck, make_real_puck
from skat.episodes import split_episodes

__all__ = [
    "ball_drop_simulator",
    "cube_toss_simulator",
    "data_home",
    "fetch_ball_drops",
    "fetch_cube_tosses",
    "fetch_pendulum",
    "make_hidden_puck",
    "make_real_puck",
    "pendulum_simulator",
    "split_episodes",
]
