"""Contacts of a model: which geoms can touch, with which parameters, and edits of these.

MuJoCo infers the parameters of a contact from its two geoms. A factor on one contact alone, or a friction
that differs between the two tangential directions, needs an explicit pair; the edits here add it with the
inferred parameters.
"""

from dataclasses import dataclass

import mujoco
import numpy as np
from numpy.typing import NDArray

from skat.simulators.channels import element_name, free_name

DISABLE_CONTACT = int(mujoco.mjtDisableBit.mjDSBL_CONTACT)
OVERRIDE = int(mujoco.mjtEnableBit.mjENBL_OVERRIDE)
DISABLE_FILTERPARENT = int(mujoco.mjtDisableBit.mjDSBL_FILTERPARENT)


@dataclass(frozen=True)
class ContactPair:
    """Two geoms that can touch.

    Attributes
    ----------
    first, second : int
        Indices of the geoms.
    is_explicit : bool
        Whether the model names the pair; otherwise MuJoCo forms the contact from the geoms.
    name : str
        The explicit pair's name, or ``"geom1/geom2"``.
    has_friction : bool
    """

    first: int
    second: int
    is_explicit: bool
    name: str
    has_friction: bool


def geom_name(model: mujoco.MjModel, geom: int) -> str:
    """Return the geom's name, or ``geom<id>``."""
    return element_name(model, mujoco.mjtObj.mjOBJ_GEOM, geom, "geom")


def contact_pairs(model: mujoco.MjModel) -> tuple[ContactPair, ...]:
    """Return every pair of geoms that MuJoCo checks for contact.

    Source: MuJoCo documentation, Computation, "Collision detection".
    """
    if model.opt.disableflags & DISABLE_CONTACT:
        return ()
    pairs = []
    for index in range(model.npair):
        first, second = int(model.pair_geom1[index]), int(model.pair_geom2[index])
        name = model.pair(index).name or f"{geom_name(model, first)}/{geom_name(model, second)}"
        pairs.append(ContactPair(first, second, True, name, bool(model.pair_dim[index] > 1)))
    explicit = {frozenset((pair.first, pair.second)) for pair in pairs}
    excluded = {int(signature) for signature in model.exclude_signature}
    for first in range(model.ngeom):
        for second in range(first + 1, model.ngeom):
            if frozenset((first, second)) not in explicit and _may_touch(model, first, second, excluded):
                name = f"{geom_name(model, first)}/{geom_name(model, second)}"
                both = [first, second]
                condim = _mixed_condim(model.geom_condim[both], model.geom_priority[both])
                pairs.append(ContactPair(first, second, False, name, condim > 1))
    return tuple(pairs)


def flex_condims(model: mujoco.MjModel) -> tuple[int, ...]:
    """Return the number of dimensions of each contact that flexes can have: with geoms, each other and themselves.

    No pair of geoms stands for these: what is multiplied in all contacts is multiplied in them too.
    """
    if model.opt.disableflags & DISABLE_CONTACT:
        return ()
    types, affinities, condims, priorities = (
        np.concatenate([getattr(model, f"geom_{name}"), getattr(model, f"flex_{name}")])
        for name in ("contype", "conaffinity", "condim", "priority")
    )
    # Where a passive flex meets these, the force is no contact's.
    fixed = np.concatenate([model.body_weldid[model.geom_bodyid] == 0, np.ones(model.nflex, bool)])
    found = []
    for flex in range(model.nflex):
        first = model.ngeom + flex
        for second in range(first + 1):
            alone = second == first and (model.flex_rigid[flex] or not model.flex_selfcollide[flex])
            meet = types[first] & affinities[second] or types[second] & affinities[first]
            if meet and not alone and not (model.flex_passive[flex] and fixed[second]):
                found.append(_mixed_condim(condims[[first, second]], priorities[[first, second]]))
    return tuple(found)


def scale_friction(pairs: tuple[ContactPair, ...], spec: mujoco.MjSpec, factor: float) -> None:
    """Multiply the sliding friction of some contacts."""
    for pair in pairs:
        element = explicit_pair(spec, pair)
        element.friction[:2] = element.friction[:2] * factor


def scale_all_friction(spec: mujoco.MjSpec, factor: float) -> None:
    """Multiply the sliding friction of every contact; MuJoCo takes the larger of two coefficients."""
    for element in [*spec.geoms, *spec.flexes]:
        element.friction[0] = element.friction[0] * factor
    for pair in spec.pairs:
        pair.friction[:2] = pair.friction[:2] * factor


def set_anisotropy(pairs: tuple[ContactPair, ...], spec: mujoco.MjSpec, ratio: float) -> None:
    """Multiply the friction along the second tangential direction of some contacts."""
    for pair in pairs:
        element = explicit_pair(spec, pair)
        element.friction[1] = element.friction[1] * ratio


def scale_damping_ratio(pairs: tuple[ContactPair, ...], spec: mujoco.MjSpec, factor: float) -> None:
    """Multiply the damping ratio (second number of solref) of some contacts."""
    for pair in pairs:
        element = explicit_pair(spec, pair)
        element.solref[1] = element.solref[1] * factor


def scale_all_damping_ratios(spec: mujoco.MjSpec, factor: float) -> None:
    """Multiply the damping ratio of every contact; averages and minima of solref keep the factor."""
    for element in [*spec.geoms, *spec.flexes, *spec.pairs]:
        element.solref[1] = element.solref[1] * factor


def explicit_pair(spec: mujoco.MjSpec, pair: ContactPair) -> mujoco.MjsPair:
    """Return the explicit pair of two geoms; if there is none, add it with the parameters MuJoCo would infer.

    All are given: what is not comes from the model's default pair, which an inferred contact does not heed.

    Source: MuJoCo documentation, Modeling, "Contact parameters".
    """
    first, second = spec.geoms[pair.first], spec.geoms[pair.second]
    for index, geom in ((pair.first, first), (pair.second, second)):
        geom.name = geom.name or free_name(f"geom{index}", [one.name for one in spec.geoms])
    for element in spec.pairs:
        if {element.geomname1, element.geomname2} == {first.name, second.name}:
            return element
    leading: tuple[mujoco.MjsGeom, ...] = (first, second)
    if first.priority != second.priority:
        leading = (max(leading, key=lambda geom: geom.priority),)
    friction = np.max([geom.friction for geom in leading], axis=0)
    weights = np.array([geom.solmix for geom in leading])
    weights = weights / weights.sum() if weights.sum() > 0 else np.full(len(leading), 1 / len(leading))
    solrefs = np.array([geom.solref for geom in leading])
    direct = (solrefs[:, 0] <= 0).any()
    return spec.add_pair(
        geomname1=first.name,
        geomname2=second.name,
        condim=max(geom.condim for geom in leading),
        friction=friction[[0, 0, 1, 2, 2]],
        solref=solrefs.min(axis=0) if direct else weights @ solrefs,
        solreffriction=np.zeros(2),  # that of the normal direction
        solimp=weights @ np.array([geom.solimp for geom in leading]),
        margin=first.margin + second.margin,
        gap=first.gap + second.gap,
        adhesion=sum(geom.adhesion for geom in leading),
    )


def _mixed_condim(condims: NDArray[np.int32], priorities: NDArray[np.int32]) -> int:
    return int(condims[priorities == priorities.max()].max())


def _may_touch(model: mujoco.MjModel, first: int, second: int, excluded: set[int]) -> bool:
    bodies = sorted(int(body) for body in model.geom_bodyid[[first, second]])
    welds = [int(model.body_weldid[body]) for body in bodies]
    if welds[0] == welds[1] or (bodies[0] << 16) + bodies[1] in excluded:
        return False
    types, affinities = model.geom_contype[[first, second]], model.geom_conaffinity[[first, second]]
    if not (types[0] & affinities[1] or types[1] & affinities[0]):
        return False
    if not model.opt.disableflags & DISABLE_FILTERPARENT and 0 not in welds:
        parents = [int(model.body_weldid[model.body_parentid[weld]]) for weld in welds]
        return parents[0] != welds[1] and parents[1] != welds[0]
    return True
