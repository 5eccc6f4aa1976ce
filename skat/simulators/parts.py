"""Parts of a model: trees of bodies of which none moves another, whatever happens."""

from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray
from scipy.sparse.csgraph import connected_components

from skat.simulators.anatomy import Anatomy, actuator_name
from skat.simulators.channels import joint_name

# Families that act where the body, joint or actuator of their target is.
OF_BODIES = ("mass", "length", "radius", "inertia", "centre_of_mass", "payload")
OF_JOINTS = (
    "damping",
    "dry_friction",
    "position_friction",
    "armature",
    "stiffness",
    "stribeck",
    "backlash",
    "force",
)
OF_ACTUATORS = (
    "gain", "force_limit", "kp", "kv", "offset", "delay", "lag", "lag_torque", "dead_zone", "torque_speed",
    "current_limit",
)  # fmt: skip


def parts_of(anatomy: Anatomy) -> NDArray[np.intp]:
    """Return the part of each degree of freedom, from 0.

    Trees that may touch are of one part. So are all where anything but a contact may tie one to another: a constraint,
    a tendon, a flex, a plugin, an actuator beside a joint.
    """
    model = anatomy.model
    tied = model.neq or model.ntendon or model.nflex or model.nplugin
    if tied or len(anatomy.joint_driven) < model.nu:
        return np.zeros(model.nv, dtype=int)
    touching = np.zeros((model.ntree, model.ntree), dtype=bool)
    for pair in anatomy.pairs:
        first, second = model.body_treeid[model.geom_bodyid[[pair.first, pair.second]]]
        if first >= 0 and second >= 0:
            touching[first, second] = True
    of_trees = connected_components(touching, directed=False)[1]
    of_dofs: NDArray[np.intp] = of_trees[model.dof_treeid].astype(int)
    return of_dofs


def places_of_effects(anatomy: Anatomy, parts: NDArray[np.intp]) -> dict[str, int]:
    """Return the part of each effect that acts in one alone, by name."""
    return dict(_places(anatomy, parts))


def _places(anatomy: Anatomy, parts: NDArray[np.intp]) -> Iterator[tuple[str, int]]:
    model = anatomy.model
    for body in anatomy.moving:
        own = int(parts[model.tree_dofadr[model.body_treeid[body]]])
        name = anatomy.body_name(body)
        for family in OF_BODIES:
            yield f"{family}[{name}]", own
            yield from ((f"{family}[{name}.{axis}]", own) for axis in "xyz")
    joint_parts = [int(parts[anatomy.dofs_of(joint)[0]]) for joint in range(model.njnt)]
    for joint, own in enumerate(joint_parts):
        name = joint_name(model, joint)
        yield from ((f"{family}[{name}]", own) for family in OF_JOINTS)
        for family in ("bias", "scale", "lag"):
            yield from ((f"{family}[{kind}.{name}]", own) for kind in ("qpos", "qvel"))
    for actuator in range(model.nu):
        # Where one acts on anything but a joint all is one part.
        own = joint_parts[int(model.actuator_trnid[actuator, 0])] if actuator in anatomy.joint_driven else 0
        name = actuator_name(model, actuator)
        yield from ((f"{family}[{name}]", own) for family in OF_ACTUATORS)
        yield from ((f"{family}[ctrl.{name}]", own) for family in ("bias", "scale"))
