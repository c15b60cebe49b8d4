# SPDX-License-Identifier: Apache-2.0
"""MJCF files against MuJoCo's own kinematics, and fingertips fitted to meshes."""

import mujoco
import numpy as np
import pytest
import trimesh
from numpy.testing import assert_allclose
from support.hands import changed, write_hand

from tactile_hand_ros.errors import HandModelError
from tactile_hand_ros.hand.hand import Hand
from tactile_hand_ros.hand.tip_fit import fit_tip
from tactile_hand_ros.scenario.link_collisions import LinkCollisions
from tactile_hand_ros.simulation.solid import Solid

FINGER = """
<body name="f{i}_base" pos="0.1 0.0{i} 0.02" euler="10 20 3{i}">
  <inertial pos="0.01 0 0.02" mass="0.05" diaginertia="2e-5 3e-5 4e-5" quat="0.9 0.1 0.2 0.3"/>
  <joint name="f{i}_a" axis="0 0.6 0.8" pos="0.01 0.02 -0.01" range="-50 60"/>
  <joint name="f{i}_b" axis="1 0 0" pos="-0.02 0 0.01" range="-30 80" actuatorfrcrange="-1.5 1"
    damping="0.3" frictionloss="0.2"/>
  <body name="f{i}_tip" pos="0.04 0.01 0.03" quat="0.7 0.1 -0.5 0.2">
    <joint name="f{i}_c" type="slide" axis="0 1 0" range="-0.01 0.02"/>
    <geom size="0.01" mass="0.02"/>
  </body>
</body>"""
MJCF = f"""<mujoco><compiler angle="degree"/><worldbody>
<body name="thing"><freejoint/><geom size="0.1"/></body>
<body name="arm" pos="1 2 3"><joint name="elbow" range="0 1"/><geom size="0.1"/>
<body name="palm" pos="0 0 0.2" euler="40 0 0"><geom size="0.03"/>
{"".join(FINGER.format(i=i) for i in (1, 2, 3))}
</body></body></worldbody>
<actuator>
<motor joint="f1_a" gear="3" forcerange="-0.2 0.1"/>
<motor joint="f1_b" gear="2" ctrlrange="-0.4 0.3"/>
<position joint="f1_c" kp="20" ctrlrange="-0.02 0.01"/>
<position joint="f2_a" kp="20"/>
<motor joint="f2_b" gear="2" ctrlrange="-4 4"/>
</actuator></mujoco>"""


def write(folder, text=MJCF):
    path = write_hand(folder, [3, 3, 3], urdf="hand.xml", fingers=[
        {"name": f"f{i}", "tip": f"f{i}_tip", "radius": 0.01} for i in (1, 2, 3)
    ])  # fmt: skip
    (folder / "hand.xml").write_text(text)
    return path


def test_an_mjcf_is_the_hand_that_mujoco_sees(tmp_path):
    hand = Hand.load(str(write(tmp_path)))
    assert hand.joint_names == [f"f{i}_{axis}" for i in (1, 2, 3) for axis in "abc"]
    # By force, by control, by control and the joint's other end, by nothing, by the joint itself.
    assert_allclose(hand.effort_limits[:5], [0.6, 0.8, 20 * (0.02 + 0.02), 1e3, 1.5])
    assert_allclose([hand.damping[4], hand.friction[4]], [0.3, 0.2])
    lower, upper = hand.position_limits
    assert_allclose([lower[1], upper[1], lower[2]], [np.radians(-30), np.radians(80), -0.01])
    model = mujoco.MjModel.from_xml_string(MJCF)
    data, theta = mujoco.MjData(model), np.linspace(-0.4, 0.5, 9)
    for name, angle in zip(hand.joint_names, theta, strict=True):
        data.joint(name).qpos[0] = angle
    mujoco.mj_forward(model, data)
    palm, turn = data.body("palm").xpos, data.body("palm").xmat.reshape(3, 3)
    seen = [(data.body(f"f{i}_tip").xpos - palm) @ turn for i in (1, 2, 3)]
    assert_allclose(hand.tip_positions(theta), seen, atol=1e-12)
    whole = np.zeros((model.nv, model.nv))
    dofs = [model.joint(name).dofadr[0] for name in hand.joint_names]
    mujoco.mj_fullM(model, data, whole)
    assert_allclose(hand.dynamics(theta, np.zeros(9))[1], whole[np.ix_(dofs, dofs)], atol=1e-12)


def test_shapes_of_an_mjcf_that_collide_are_those_of_its_links(tmp_path):
    """A tip of 8 mm comes from the end of a capsule; a look through a box finds what it meets."""
    tip = '<geom type="capsule" size="0.008 0.02" pos="0.01 0 0" euler="0 90 0" mass="0.02"/>'
    shapes = (
        '<geom type="box" size="0.01 0.02 0.03" pos="0 0 -0.1" euler="0 0 90"/>'
        '<geom type="cylinder" size="0.01 0.05" pos="0 0.2 0" euler="90 0 0"/>'
        '<geom size="0.1" pos="0 0 1" contype="0" conaffinity="0"/>'
    )
    text = MJCF.replace('<geom size="0.01" mass="0.02"/>', tip)
    text = text.replace('<geom size="0.03"/>', '<geom size="0.03"/>' + shapes)
    path = write(tmp_path, text)
    path.write_text(path.read_text().replace("radius: 0.01", "radius: 0.0"))
    hand = Hand.load(str(path))
    assert_allclose(hand.radii, 0.008)
    given = Hand.load(str(write(tmp_path, text)))
    away = hand.tip_positions(np.zeros(9)) - given.tip_positions(np.zeros(9))
    assert_allclose(away[0], 0.03 * given.tip_rotations(np.zeros(9))[0][:, 0], atol=1e-12)
    links = LinkCollisions(hand, Solid.box(np.full(3, 2e-3)))
    places = {
        (0.0, 0.0, 0.028): True, (0.0, 0.0, 0.032): False,  # the sphere
        (0.018, 0.0, -0.1): True, (0.022, 0.0, -0.1): False, (0.0, 0.012, -0.1): False,  # the box
        (0.0, 0.248, 0.0): True, (0.0, 0.2, 0.012): False,  # the cylinder
        (0.0, 0.0, 1.0): False,
    }  # fmt: skip
    for place, touches in places.items():
        found = links.touching(np.zeros(9), np.array(place), np.eye(3))
        assert ("palm" in found) == touches, place


def load_without_radius(folder, shape):
    """Load a hand whose second tip has a shape, but no radius in the YAML file."""
    link = '<link name="f2_tip"/>', f'<link name="f2_tip">{shape}</link>'
    fingers = [{"name": f"f{i}", "tip": f"f{i}_tip", "radius": 0.02} for i in (1, 2, 3)]
    fingers[1] = {"name": "f2", "tip": "f2_tip", "axis": [0.0, 0.0, 1.0]}
    return changed(write_hand(folder, [3, 3, 3]), link, fingers=fingers)


def test_a_mesh_without_a_round_end_is_named(tmp_path):
    ball = trimesh.creation.icosphere(radius=0.02)
    bowl = ball.faces[ball.triangles[:, :, 2].max(axis=1) < 1e-3]
    trimesh.Trimesh(ball.vertices, bowl).export(tmp_path / "tip.stl")
    visual = '<visual><geometry><mesh filename="tip.stl"/></geometry></visual>'
    said = "'f2': no sphere fits the end of the mesh of 'f2_tip'"
    with pytest.raises(HandModelError, match=said):
        load_without_radius(tmp_path, visual)


@pytest.mark.parametrize(
    ("shape", "origin", "said"),
    [
        ('sphere radius="abc"', "0 0 0", "the URDF has 'abc', expected a number"),
        ("sphere", "0 0 0", "the URDF has '', expected a number"),
        ('sphere radius="0.01"', "a b c", "the URDF has 'a b c', expected three numbers"),
        ('mesh filename="tip.stl"', "0 0 0", "tip.stl' cannot be used: .*; correct the file"),
    ],
)
def test_a_damaged_fingertip_is_one_sentence(tmp_path, shape, origin, said):
    (tmp_path / "tip.stl").write_bytes(b"solid" + bytes(30))
    tip = f'<collision><origin xyz="{origin}"/><geometry><{shape}/></geometry></collision>'
    with pytest.raises(HandModelError, match=said):
        load_without_radius(tmp_path, tip)


def test_broken_mjcf_is_an_error_with_its_reason(tmp_path):
    path = write(tmp_path, MJCF.replace("<worldbody>", "<worldbody><body/><hand/>"))
    with pytest.raises(HandModelError, match="MuJoCo cannot read"):
        Hand.load(str(path))
    write(tmp_path, MJCF.replace('type="slide"', 'type="ball"').replace('range="-0.01 0.02"', ""))
    with pytest.raises(HandModelError, match="is a ball; expected hinges and slides"):
        Hand.load(str(path))


def test_a_sphere_is_fitted_to_the_end_of_a_mesh(tmp_path):
    body = trimesh.creation.capsule(height=0.05, radius=0.008, count=[64, 64])
    points, _ = trimesh.sample.sample_surface(body, 5000, seed=1)
    fit = fit_tip(points, np.array([0.0, 0.2, 1.0]))
    assert fit.radius == pytest.approx(0.008, rel=0.01) and fit.error < 5e-5
    assert_allclose(fit.center, body.bounds[1] * [0, 0, 1] - [0, 0, 0.008], atol=1e-4)

    body.export(tmp_path / "tip.stl")
    (tmp_path / "given").mkdir()
    path = write_hand(tmp_path, [3, 3, 3])
    text = path.read_text()
    visual = (
        '<visual><origin xyz="0.01 0 0" rpy="0 1.5707963 0"/><geometry>'
        '<mesh filename="package://any/tip.stl"/></geometry></visual>'
    )
    path.write_text(text.replace("radius: 0.02", "radius: 0.0", 1))
    hand = changed(path, ('<link name="f1_tip"/>', f'<link name="f1_tip">{visual}</link>'))
    given = Hand.load(str(write_hand(tmp_path / "given", [3, 3, 3])))
    assert hand.radii[0] == pytest.approx(0.008, rel=0.01) and 0.0 < hand.tip_errors[0] < 1e-4
    assert hand.radii[1] == 0.02 and hand.tip_errors[1] == 0.0
    theta = np.linspace(0.1, 0.9, 9)
    offset = (hand.tip_positions(theta) - given.tip_positions(theta))[0]
    along = given.tip_rotations(theta)[0][:, 0]
    end = 0.01 + body.bounds[1, 2] - 0.008
    assert_allclose(offset, end * along, atol=2e-4)
    path.write_text(text.replace("radius: 0.02", "radius: 0.0"))
    with pytest.raises(HandModelError, match="f2.*neither a sphere nor a mesh"):
        Hand.load(str(path))
