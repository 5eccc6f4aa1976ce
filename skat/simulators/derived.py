"""What MuJoCo's compiler derives from masses, lengths and poses, written down before effects change these."""

import warnings

import mujoco
import numpy as np

from skat.simulators.edits import heed_inertials, scale_mass

BODY, SITE = mujoco.mjtObj.mjOBJ_BODY, mujoco.mjtObj.mjOBJ_SITE
CONNECT, WELD = mujoco.mjtEq.mjEQ_CONNECT, mujoco.mjtEq.mjEQ_WELD


def write_down(spec: mujoco.MjSpec) -> None:
    """Put into a spec, in place, the numbers that its compiler would derive anew from edited ones.

    So that an effect changes what it says and nothing else: a heavier link is not made lighter again by
    ``settotalmass`` or ``boundmass``, nor its servo more damped by ``dampratio``, and the two ends of a closed loop
    stay on their links.
    """
    _masses(spec)
    model = _compiled(spec)
    _controllers(spec, model)
    _springs(spec, model)
    _loops(spec, model)


def _compiled(spec: mujoco.MjSpec) -> mujoco.MjModel:
    """Return the compiled model, its bodies in the spec's order."""
    copy = spec.copy()
    copy.compiler.fusestatic = False
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        return copy.compile()


def _masses(spec: mujoco.MjSpec) -> None:
    """Write down masses and inertias that bounds decide, and then scale all to their total, as the compiler does."""
    compiler = spec.compiler
    total, compiler.settotalmass = compiler.settotalmass, -1
    if compiler.boundmass > 0 or compiler.boundinertia > 0:
        bounded = _compiled(spec)
        compiler.boundmass = compiler.boundinertia = 0
        try:
            free = _compiled(spec)
        except ValueError:  # A body that moves has no mass but for the bounds: all are written down.
            free = None
        heed_inertials(spec)
        for index, body in enumerate(spec.bodies):
            same = free is not None and all(
                np.array_equal(getattr(free, name)[index], getattr(bounded, name)[index])
                for name in ("body_mass", "body_inertia")
            )
            if index and not same:
                body.explicitinertial = True
                body.fullinertia = np.full(6, np.nan)
                body.ialt.type = mujoco.mjtOrientation.mjORIENTATION_QUAT
                body.mass, body.inertia = bounded.body_mass[index], bounded.body_inertia[index]
                body.ipos, body.iquat = bounded.body_ipos[index], bounded.body_iquat[index]
    if total > 0:
        scale_mass(range(len(spec.bodies)), spec, total / float(np.sum(_compiled(spec).body_mass)))


def _controllers(spec: mujoco.MjSpec, model: mujoco.MjModel) -> None:
    """Replace a damping ratio, which a servo's third parameter is while it is positive, by the damping."""
    for index, actuator in enumerate(spec.actuators):
        if actuator.biastype == mujoco.mjtBias.mjBIAS_AFFINE and actuator.biasprm[2] > 0:
            actuator.biasprm = model.actuator_biasprm[index]


def _springs(spec: mujoco.MjSpec, model: mujoco.MjModel) -> None:
    for index, joint in enumerate(spec.joints):
        if np.any(joint.springdamper):
            joint.stiffness[0] = model.jnt_stiffness[index]
            joint.damping[0] = model.dof_damping[model.jnt_dofadr[index]]
            joint.springdamper = np.zeros(2)
    for index, tendon in enumerate(spec.tendons):
        if tendon.springlength[0] == -1:
            tendon.springlength = model.tendon_lengthspring[index]


def _loops(spec: mujoco.MjSpec, model: mujoco.MjModel) -> None:
    """Tie what connects two bodies to a site on each of them, where the compiler had put it."""
    for index, equality in enumerate(spec.equalities):
        if equality.objtype != BODY or equality.type not in (CONNECT, WELD):
            continue
        data, first, second = model.eq_data[index], model.eq_obj1id[index], model.eq_obj2id[index]
        straight = np.array([1.0, 0.0, 0.0, 0.0])
        ends = [(first, data[:3], straight), (second, data[3:6], straight)]
        if equality.type == WELD:
            ends = [(first, data[3:6], data[6:10]), (second, data[:3], straight)]
        names = []
        for end, (body, place, turn) in enumerate(ends, start=1):
            name = f"equality{index}_{end}"
            taken = {site.name for site in spec.sites}
            while name in taken:
                name += "_"
            spec.bodies[body].add_site(name=name, pos=place, quat=turn)
            names.append(name)
        equality.objtype, (equality.name1, equality.name2) = SITE, names
