# SPDX-License-Identifier: Apache-2.0
"""Schema texts are complete, in rosbag2's order, and define the same type in other readers."""

from pathlib import Path

import pytest
from rosbags.typesys import Stores, get_types_from_msg, get_typestore

from tactile_hand_ros.bag.schema import message_definition
from tactile_hand_ros.errors import BagError

LINE = "=" * 80 + "\n"
TYPES = """
builtin_interfaces/msg/Time std_msgs/msg/Empty std_msgs/msg/Float64MultiArray rcl_interfaces/msg/Log
rcl_interfaces/msg/ParameterEvent diagnostic_msgs/msg/DiagnosticArray geometry_msgs/msg/PoseArray
geometry_msgs/msg/TwistWithCovarianceStamped sensor_msgs/msg/JointState sensor_msgs/msg/PointCloud2
sensor_msgs/msg/JoyFeedbackArray sensor_msgs/msg/MultiDOFJointState
trajectory_msgs/msg/JointTrajectory visualization_msgs/msg/MarkerArray
""".split()


@pytest.mark.parametrize("type_name", TYPES)
def test_text_means_the_same_type_as_in_rosbags(type_name):
    """Parsed alone, it yields the fields and the hash of rosbags' own Jazzy definitions."""
    jazzy = get_typestore(Stores.ROS2_JAZZY)
    own = get_typestore(Stores.EMPTY)
    own.register(get_types_from_msg(message_definition(type_name).text, type_name))
    assert own.hash_rihs01(type_name) == jazzy.hash_rihs01(type_name)
    assert own.generate_msgdef(type_name) == jazzy.generate_msgdef(type_name)


def package(root: Path, monkeypatch: pytest.MonkeyPatch, **files: str) -> None:
    """Install a message package `my_msgs` with the given files below `root`."""
    (root / "share/ament_index/resource_index/packages").mkdir(parents=True)
    (root / "share/ament_index/resource_index/packages/my_msgs").touch()
    (root / "share/my_msgs/msg").mkdir(parents=True)
    for name, text in files.items():
        path = root / "share/my_msgs/msg" / name.replace("_dot_", ".")
        path.write_bytes(text.encode())
    monkeypatch.setenv("AMENT_PREFIX_PATH", str(root))
    message_definition.cache_clear()


def test_arrays_comments_and_line_ends_are_kept(tmp_path, monkeypatch):
    kinds = ["bool", "byte", "char", "float32", "float64", "string"]
    kinds += [f"{sign}int{bits}" for sign in ("", "u") for bits in (8, 16, 32, 64)]
    root = "# µ\r\nZ[<=3] z\nstring<=4 s\nA[2]  a # B b\nmy_msgs/M m\nint32 N=1\n"
    root += "".join(f"{kind} a{i}\n{kind}[] b{i}\n" for i, kind in enumerate(kinds))
    package(tmp_path, monkeypatch, Root_dot_msg=root, Z_dot_msg="bool z\n", A_dot_msg="Z z",
            M_dot_msg="bool m\n")  # fmt: skip
    expected = (
        f"{root}\n{LINE}MSG: my_msgs/A\nZ z\n{LINE}MSG: my_msgs/Z\nbool z\n"
        f"\n{LINE}MSG: my_msgs/M\nbool m\n"
    )
    for name in ("my_msgs/msg/Root", "my_msgs/Root"):
        assert message_definition(name).text == expected


@pytest.mark.parametrize("name", ["no_such_msgs/msg/A", "std_msgs/msg/NoSuchType", "nonsense", ""])
def test_unknown_type_is_an_error_that_names_it(name):
    with pytest.raises(BagError, match=f"'{name}'.*AMENT_PREFIX_PATH"):
        message_definition(name)
