"""Effects in models whose compiler derives numbers from those that the effects change."""

import mujoco
import numpy as np
import pytest

from skat.simulators import MujocoSimulator


def model(body, rest=""):
    return f"<mujoco>{rest}<worldbody>{body}</worldbody></mujoco>"


def swinging(joint="", geom='size=".1" pos="0 0 .3"', inside="", name="b"):
    return f'<body name="{name}"><joint name="j" axis="0 1 0" {joint}/><geom {geom}/>{inside}</body>'


def stepped(text, row, n_steps):
    """Return [qpos, qvel] of plain MuJoCo after some steps."""
    plain = mujoco.MjModel.from_xml_string(text)
    data = mujoco.MjData(plain)
    data.qpos[:], data.qvel[:] = np.split(np.array(row, dtype=float), [plain.nq])
    mujoco.mj_step(plain, data, n_steps)
    return np.r_[data.qpos, data.qvel]


def four_bar(equality, *, crank=0.2, coupler=0.4, rocker=0.2):
    rod = '<geom type="capsule" fromto="0 0 0 {} 0 {}" size=".01" mass=".1" contype="0" conaffinity="0"/>'
    return model(
        f"""<body name="crank"><joint axis="0 1 0"/>{rod.format(0, crank)}
          <body name="coupler" pos="0 0 {crank}"><joint axis="0 1 0"/>{rod.format(coupler, 0)}
          <site name="end" pos="{coupler} 0 0"/></body></body>
        <body name="rocker" pos=".4 0 0"><joint axis="0 1 0"/>{rod.format(0, rocker)}
          <site name="top" pos="0 0 {rocker}"/></body>""",
        f"<equality>{equality}</equality>",
    )


@pytest.mark.parametrize(
    "equality",
    [
        '<connect body1="coupler" body2="rocker" anchor=".4 0 0"/>',
        '<weld body1="coupler" body2="rocker" anchor="0 0 .2"/>',
    ],
)
def test_ends_of_a_closed_loop_stay_on_their_links(equality):
    row = [0.3, -0.2, 0.1, 0.5, 0.0, 0.0]
    simulator = MujocoSimulator(four_bar(equality), frame_skip=20)
    np.testing.assert_allclose(
        simulator.predict([row])[0], stepped(four_bar(equality), row, 20), rtol=1e-9, atol=1e-9
    )
    by_sites = equality[: equality.index(" ")] + ' site1="end" site2="top"/>'
    for link in ("crank", "coupler", "rocker"):
        longer = four_bar(by_sites, **{link: 1.3 * {"coupler": 0.4}.get(link, 0.2)})
        found = simulator.predict([row], effects={f"length[{link}]": 1.3})
        np.testing.assert_allclose(found[0], stepped(longer, row, 20), rtol=1e-9, atol=1e-9)


def test_centre_of_mass_keeps_the_inertia_where_a_given_one_is_ignored():
    inertial = '<inertial mass="1" pos=".1 0 0" diaginertia=".1 .1 .1"/>'
    text = model(
        swinging(geom='type="box" size=".1 .1 .3"', inside=inertial), '<compiler inertiafromgeom="true"/>'
    )
    simulator = MujocoSimulator(text)
    nominal, moved = simulator.compiled(), simulator.compiled({"centre_of_mass[b.x]": 0.01})
    np.testing.assert_allclose(moved.body_mass, nominal.body_mass)
    np.testing.assert_allclose(moved.body_inertia, nominal.body_inertia)
    np.testing.assert_allclose(moved.body_ipos[1], [0.01, 0, 0], atol=1e-12)


@pytest.mark.parametrize("bounds", ['boundmass="3"', 'boundmass="3" boundinertia="0.5"'])
def test_bounds_of_the_compiler_do_not_undo_a_mass(bounds):
    text = model(swinging(geom='size=".1" pos="0 0 .3" mass="1"'), f"<compiler {bounds}/>")
    simulator = MujocoSimulator(text)
    nominal, heavy = simulator.compiled(), simulator.compiled({"mass[b]": 2.0})
    reference = mujoco.MjModel.from_xml_string(text)
    np.testing.assert_allclose(nominal.body_mass, reference.body_mass)
    np.testing.assert_allclose(nominal.body_inertia, reference.body_inertia)
    np.testing.assert_allclose(heavy.body_mass, 2 * nominal.body_mass)
    np.testing.assert_allclose(heavy.body_inertia, 2 * nominal.body_inertia)


def test_damping_ratio_of_a_servo_is_a_damping():
    servo = '<actuator><position joint="j" kp="10" dampratio="1"/></actuator>'
    simulator = MujocoSimulator(model(swinging(), servo))
    nominal = simulator.compiled().actuator_biasprm[0]
    assert nominal[2] < 0
    np.testing.assert_allclose(simulator.compiled({"gain[j]": -2.0}).actuator_biasprm[0], -2 * nominal)
    np.testing.assert_allclose(simulator.compiled({"mass[b]": 2.0}).actuator_biasprm[0], nominal)


def test_spring_given_by_its_time_constant_takes_effects():
    simulator = MujocoSimulator(model(swinging('springdamper=".5 1"')))
    nominal = simulator.compiled()
    assert nominal.dof_damping[0] > 0
    for effect, field, change in (
        ("damping", "dof_damping", 0.5),
        ("stiffness", "jnt_stiffness", 3),
        ("mass", "", 0),
    ):
        values = {f"{effect}[j]": float(change)} if field else {"mass[b]": 2.0}
        edited = simulator.compiled(values)
        for name in ("dof_damping", "jnt_stiffness"):
            np.testing.assert_allclose(
                getattr(edited, name), getattr(nominal, name) + change * (name == field)
            )


def test_automatic_length_of_a_tendon_is_that_of_the_given_model():
    sites = '<site name="s0" pos="0 0 1.5"/>' + swinging(
        geom='type="capsule" fromto="0 0 0 .5 0 0" size=".1"', inside='<site name="s1" pos=".5 0 0"/>'
    )
    tendon = '<tendon><spatial stiffness="5"><site site="s0"/><site site="s1"/></spatial></tendon>'
    simulator = MujocoSimulator(model(sites, tendon))
    longer = simulator.compiled({"length[b]": 1.5})
    np.testing.assert_allclose(longer.tendon_lengthspring, simulator.compiled().tendon_lengthspring)


def test_delay_after_a_shorter_time_step_is_written_with_room_for_it(tmp_path):
    text = model(
        swinging(),
        '<option timestep=".01" integrator="implicitfast"/><actuator><motor joint="j"/></actuator>',
    )
    simulator = MujocoSimulator(text, frame_skip=2).extended({"delay[action]": 0.03, "timestep": 0.5})
    (path,) = simulator.to_mjcf(tmp_path / "delayed.xml")
    written = mujoco.MjModel.from_xml_path(str(path))
    assert written.opt.timestep == 0.005
    assert written.actuator_history[0, 0] == 7


def test_actuators_whose_parameters_are_no_forces_have_no_gain():
    others = """<dcmotor name="dc" joint="j" motorconst="0.05" resistance="2"/>
      <general name="muscle" joint="j" gaintype="muscle" biastype="muscle" lengthrange="0.5 1.5"
      gainprm="0.75 1.05 50 200 0.5 1.6 1.5 1.3 1.2" biasprm="0.75 1.05 50 200 0.5 1.6 1.5 1.3 1.2"/>"""
    motors = f'<actuator>{others}<motor name="m" joint="j"/><position name="p" joint="j" kv="1"/></actuator>'
    names = {effect.name for effect in MujocoSimulator(model(swinging(), motors)).effects()}
    assert {"gain[m]", "gain[p]"} <= names
    assert not {"gain[dc]", "gain[muscle]"} & names


def test_length_of_a_link_made_of_a_mesh_moves_its_centre():
    points = np.array([[0, 0, 0], [0.5, 0, 0], [0, 0.1, 0], [0, 0, 0.1], [0.5, 0.1, 0.1]])
    mesh = f'<asset><mesh name="m" vertex="{" ".join(map(str, points.ravel()))}"/></asset>'
    simulator = MujocoSimulator(
        model(swinging(geom='type="mesh" mesh="m" euler="0 20 0"'), mesh), frame_skip=50
    )
    nominal, longer = simulator.compiled(), simulator.compiled({"length[b]": 1.5})
    np.testing.assert_allclose(longer.body_ipos[1], 1.5 * nominal.body_ipos[1])
    np.testing.assert_allclose(longer.body_mass, nominal.body_mass)
    fitted = MujocoSimulator(model(swinging(geom='type="capsule" mesh="m"'), mesh))
    np.testing.assert_allclose(
        fitted.compiled({"length[b]": 1.5}).body_ipos[1], 1.5 * fitted.compiled().body_ipos[1]
    )


def test_length_is_the_same_for_a_text_and_for_what_was_read_from_it():
    text = model(swinging(geom='type="box" fromto="0 0 0 0 0 .4" size=".1"'))
    for given in (text, mujoco.MjSpec.from_string(text)):
        longer = MujocoSimulator(given).compiled({"length[b]": 2.0})
        np.testing.assert_allclose(longer.geom_size[0], [0.1, 0.1, 0.2])
        np.testing.assert_allclose(longer.geom_pos[0], [0, 0, 0.4])


@pytest.mark.parametrize("kind", ["capsule", "cylinder"])
@pytest.mark.parametrize("shell", ["true", "false"])
def test_longer_links_weigh_what_they_did(kind, shell):
    geom = f'type="{kind}" fromto="0 0 0 0 0 .4" size=".1" shellinertia="{shell}"'
    simulator = MujocoSimulator(model(swinging(geom=geom)))
    np.testing.assert_allclose(
        simulator.compiled({"length[b]": 2.0}).body_mass, simulator.compiled().body_mass
    )


def test_drag_along_oblique_slides_is_that_of_the_velocity():
    slides = '<joint type="slide" axis="1 0 0"/><joint type="slide" axis="1 1 0"/>'
    text = model(f'<body name="b">{slides}<geom size=".1" mass="1"/></body>', '<option gravity="0 0 0"/>')
    row = [[0, 0, 1, -np.sqrt(2)]]  # The body moves along y.
    simulator = MujocoSimulator(text)
    np.testing.assert_allclose(simulator.predict(row, effects={"air_drag[x]": 1.0}), simulator.predict(row))


def test_contacts_that_the_model_overrides_have_no_effects():
    plane, ball = '<geom type="plane" size="1 1 .1"/>', '<body><freejoint/><geom size=".1"/></body>'
    for flag, listed in (("disable", True), ("enable", False)):
        simulator = MujocoSimulator(model(plane + ball, f'<option><flag override="{flag}"/></option>'))
        assert ("contact_friction[all]" in {effect.name for effect in simulator.effects()}) == listed


def test_elements_without_names_get_names_that_no_other_has():
    inner = '<body pos=".3 0 0"><joint axis="0 1 0"/><geom size=".1" pos=".1 0 0"/></body>'
    text = model(
        '<geom type="plane" size="1 1 .1"/><body name="body2"><joint name="joint1" axis="0 1 0"/>'
        f'<geom name="geom0" size=".1" pos=".1 0 0"/>{inner}</body>'
    )
    simulator = MujocoSimulator(text)
    assert simulator.state_names[:2] == ("qpos.joint1", "qpos.joint1_")
    names = [effect.name for effect in simulator.effects()]
    assert len(set(names)) == len(names)
    assert {"mass[body2]", "mass[body2_]", "damping[joint1]", "damping[joint1_]"} <= set(names)
    row = [[0.1, 0.2, 0, 0]]
    assert np.isfinite(simulator.predict(row, effects={"contact_anisotropy[all]": 0.5})).all()
    with pytest.raises(ValueError, match=r"two effects of the model would be called mass\[all\]"):
        MujocoSimulator(text.replace("body2", "all")).effects()


def test_names_may_have_brackets():
    simulator = MujocoSimulator(
        model(swinging(name="b[0]"), '<actuator><motor name="m[0]" joint="j"/></actuator>')
    )
    assert simulator.predict([[0, 0, 0.5]]).shape == (1, 2)
    heavy = next(effect for effect in simulator.effects() if effect.name == "mass[b[0]]")
    assert heavy.target == "b[0]"
    assert heavy.describe(2.0) == "the mass of b[0] is 2 times the model's"


def test_materials_of_tendons_meshes_and_lights_are_left_out_too():
    assets = """<asset><texture name="t" type="2d" builtin="flat" width="8" height="8"/><material name="m" texture="t"/>
      <mesh name="s" material="m" vertex="0 0 0 .5 0 0 0 .1 0 0 0 .1"/></asset>
      <tendon><spatial material="m"><site site="s0"/><site site="s1"/></spatial></tendon>"""
    body = swinging(geom='type="mesh" mesh="s"', inside='<site name="s1"/>')
    text = model('<light type="image" texture="t"/><site name="s0" pos="0 0 1.5"/>' + body, assets)
    assert MujocoSimulator(text).predict([[0, 0]]).shape == (1, 2)


def test_attached_models_and_their_angles_are_taken_along(tmp_path):
    (tmp_path / "arm.xml").write_text(
        """<mujoco model="arm"><compiler angle="radian"/><worldbody><body name="arm" euler="0 0 1.5"><joint name="j"
        axis="0 1 0"/><geom type="capsule" fromto="0 0 0 .3 0 0" size=".02"/><body name="tip" pos=".3 0 0"
        euler="0 0 1.5"><joint name="k" axis="0 1 0" pos=".1 0 0"/><geom size=".03" pos=".2 0 0"/></body></body>
        </worldbody></mujoco>"""
    )
    scene = tmp_path / "scene.xml"
    scene.write_text(
        model('<frame><attach model="arm" body="arm" prefix="l_"/></frame>').replace(
            "<worldbody>", '<asset><model name="arm" file="arm.xml"/></asset><worldbody>'
        )
    )
    simulator = MujocoSimulator(scene)
    (tmp_path / "arm.xml").unlink()

    def anchors(values):
        compiled = simulator.compiled(values)
        data = mujoco.MjData(compiled)
        mujoco.mj_kinematics(compiled, data)
        return data.xanchor.copy()

    nominal = anchors({})
    np.testing.assert_allclose(anchors({"length[l_tip]": 2.0}), nominal, atol=1e-9)
    np.testing.assert_allclose(anchors({"length[l_arm]": 2.0})[1], 2 * nominal[1], atol=1e-9)
    assert simulator.predict([[0, 0, 0, 0]]).shape == (1, 4)


def test_stripped_paths_are_those_of_the_compiler(tmp_path):
    (tmp_path / "assets").mkdir()
    (tmp_path / "assets" / "part.obj").write_text(
        "v 0 0 0\nv 1 0 0\nv 0 1 0\nv 0 0 1\nf 1 3 2\nf 1 2 4\nf 1 4 3\nf 2 3 4\n"
    )
    text = model(
        swinging(geom='type="mesh" mesh="m"'),
        '<compiler meshdir="assets" strippath="true"/><asset><mesh name="m" file="some/where/part.obj"/></asset>',
    )
    (tmp_path / "robot.xml").write_text(text)
    assert MujocoSimulator(tmp_path / "robot.xml").predict([[0, 0]]).shape == (1, 2)


def test_joints_of_flexible_bodies_have_no_effects_that_mujoco_refuses():
    flex = (
        '<flexcomp name="cloth" type="grid" count="3 3 1" spacing=".1 .1 .1" pos="0 0 1" mass=".1" dim="2">'
        '<edge equality="true"/></flexcomp>'
    )
    simulator = MujocoSimulator(model(flex))
    assert not any(effect.family == "damping" for effect in simulator.effects())


@pytest.mark.parametrize(
    "equality", ['<connect body1="a" body2="b" anchor=".1 0 0"/>', '<weld body1="a" body2="b"/>']
)
def test_ends_of_a_closed_loop_are_found_where_static_bodies_are_fused(equality):
    post = '<body name="post"><geom size=".1" pos="0 3 0"/></body>'
    other = '<body name="a" pos=".3 0 0"><freejoint/><geom size=".05"/></body>'
    text = model(
        post + other + swinging(),
        f'<compiler fusestatic="true"/><equality>{equality}</equality>',
    )
    row = [0.31, 0, 0.02, 1, 0, 0, 0, 0.1, *np.zeros(7)]
    found = MujocoSimulator(text, frame_skip=20).predict([row])[0]
    np.testing.assert_allclose(found, stepped(text, row, 20), rtol=1e-9, atol=1e-9)


@pytest.mark.parametrize("fused", ["", 'fusestatic="true"'])
def test_bounds_and_a_total_of_masses_are_those_of_the_compiler(fused, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)  # where MuJoCo logs its warning
    light = '<body name="a" pos="1 0 0"><joint name="k" axis="0 1 0"/><geom size=".05" mass="1" pos="0 0 .3"/></body>'
    post = '<body name="post"><geom size=".1" pos="0 3 0"/></body>'
    text = model(
        post + light + swinging(), f'<compiler {fused} settotalmass="100" boundmass="3" boundinertia=".4"/>'
    )
    row = [0.5, -0.3, 0.2, 0.1]
    simulator = MujocoSimulator(text, frame_skip=20)
    np.testing.assert_allclose(simulator.predict([row])[0], stepped(text, row, 20), rtol=1e-9, atol=1e-9)
    simulator.to_mjcf(tmp_path / "same.xml")
    same = stepped((tmp_path / "same.xml").read_text(), row, 20)
    np.testing.assert_allclose(same, stepped(text, row, 20), rtol=1e-9, atol=1e-9)


def test_an_explicit_inertia_grows_with_the_square_of_a_links_length():
    arm = """<mujoco><worldbody><body name="link"><joint axis="0 1 0"/>
      <inertial pos=".2 0 0" mass="2" diaginertia=".03 .02 .015"/><geom size=".05" pos=".4 0 0"/>
    </body></worldbody></mujoco>"""
    longer = MujocoSimulator(arm).compiled({"length[link]": 1.5})
    np.testing.assert_allclose(longer.body_inertia[1], 1.5**2 * np.array([0.03, 0.02, 0.015]), rtol=1e-12)
    assert longer.body_mass[1] == 2


@pytest.mark.parametrize(("place", "has"), [("0 0 0", False), ("0.2 0 0", True), ("0 0.1 -0.2", True)])
def test_a_ball_on_a_joint_away_from_its_centre_has_a_length(place, has):
    text = f"""<mujoco><worldbody><body name="ball"><joint name="hinge" axis="0 1 0" pos="{place}"/>
    <geom type="sphere" size=".05"/></body></worldbody></mujoco>"""
    assert ("length[ball]" in [effect.name for effect in MujocoSimulator(text).all_effects()]) == has


def test_sites_that_tie_a_loop_get_names_that_no_other_has():
    """A model may have been written with such sites before."""
    taken = '<site name="equality0_1" pos=".1 0 0"/><site name="equality0_1_" pos="0 .1 0"/>'
    other = f'<body name="a" pos=".3 0 0"><freejoint/><geom size=".05"/>{taken}</body>'
    text = model(other + swinging(), '<equality><connect body1="a" body2="b" anchor=".1 0 0"/></equality>')
    row = [0.31, 0, 0.02, 1, 0, 0, 0, 0.1, *np.zeros(7)]
    found = MujocoSimulator(text, frame_skip=20).predict([row])[0]
    np.testing.assert_allclose(found, stepped(text, row, 20), rtol=1e-9, atol=1e-9)


def test_a_total_mass_is_held_up_as_the_compiler_would_hold_it(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)  # where MuJoCo logs its warning
    text = model(swinging().replace('name="b"', 'name="b" gravcomp=".8"'), '<compiler settotalmass="3"/>')
    simulator = MujocoSimulator(text)
    plain = mujoco.MjModel.from_xml_string(text)
    np.testing.assert_array_equal(simulator.compiled().body_gravcomp, plain.body_gravcomp)
    np.testing.assert_allclose(simulator.compiled({"mass[b]": 2.0}).body_gravcomp[1], 0.4)
