"""Pictures of the robot where the simulation is furthest from what was measured."""

from __future__ import annotations


def worst_moment(nominal, extended, episode):
    return (), ""
