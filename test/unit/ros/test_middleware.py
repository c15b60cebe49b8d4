# SPDX-License-Identifier: Apache-2.0
import re
from pathlib import Path
from xml.etree import ElementTree

import pytest

from tactile_hand_ros.errors import ConfigurationError
from tactile_hand_ros.ros import middleware
from tactile_hand_ros.ros.middleware import socket_settings

RANGE, PROFILE = "ROS_AUTOMATIC_DISCOVERY_RANGE", "FASTRTPS_DEFAULT_PROFILES_FILE"


@pytest.mark.parametrize(
    ("given", "name"),
    [
        ({}, "subnet"),
        *(({RANGE: given}, "subnet") for given in ("", "SUBNET", "SYSTEM_DEFAULT")),
        *(({RANGE: given}, "localhost") for given in ("LOCALHOST", "localhost", "off", "lan")),
    ],
)
def test_the_range_chooses_a_profile_of_sockets(given, name):
    settings = socket_settings(given)
    file = Path(settings[PROFILE])
    kinds = [each.text for each in ElementTree.parse(file).iter() if each.tag.endswith("}type")]
    assert (file.stem, kinds) == (name, ["UDPv4"])
    assert settings[RANGE] == "SUBNET"  # LOCALHOST itself would enable shared memory again


def test_the_older_variable_means_this_machine_too():
    settings = socket_settings({"ROS_LOCALHOST_ONLY": "1"})
    assert Path(settings[PROFILE]).stem == "localhost"
    assert (settings[RANGE], settings["ROS_LOCALHOST_ONLY"]) == ("SUBNET", "0")


def test_it_is_chosen_once_and_narrowed_at_need():
    first = socket_settings({RANGE: "LOCALHOST"})
    assert socket_settings(first) == {}  # a child process has nothing to change
    assert socket_settings({**first, RANGE: "LOCALHOST"}) == first
    assert socket_settings({**socket_settings({}), RANGE: "LOCALHOST"}) == first


@pytest.mark.parametrize(
    "given",
    [
        {PROFILE: "mine.xml"},
        {"FASTDDS_DEFAULT_PROFILES_FILE": "m.xml"},
        {RANGE: "OFF"},
        {"RMW_IMPLEMENTATION": "rmw_cyclonedds_cpp", RANGE: "LOCALHOST"},
    ],
)
def test_what_the_user_has_chosen_stays(given):
    assert socket_settings(given) == {}


def test_without_a_configuration_nothing_is_set(monkeypatch):
    def fail() -> Path:
        raise ConfigurationError("no configuration")

    monkeypatch.setattr(middleware, "config_directory", fail)
    assert socket_settings({}) == {}


@pytest.mark.parametrize("domain", ["", "0", "232"])
def test_domains_that_exist_are_accepted(domain):
    middleware.check_environment({"ROS_DOMAIN_ID": domain})
    middleware.check_environment({"ROS_AUTOMATIC_DISCOVERY_RANGE": "LOCALHOST"})
    middleware.check_environment({"RMW_IMPLEMENTATION": "rmw_fastrtps_cpp"})


@pytest.mark.parametrize(
    ("name", "value", "complaint"),
    [
        *(
            ("ROS_DOMAIN_ID", wrong, "expected a whole number from 0 to 232")
            for wrong in ("233", "-1", "x", "1.0", "²")
        ),
        ("ROS_AUTOMATIC_DISCOVERY_RANGE", "off", "set it to LOCALHOST or SUBNET"),
        ("RMW_IMPLEMENTATION", "rmw_none_cpp", "'rmw_none_cpp', which is not installed here"),
    ],
)
def test_settings_with_which_nodes_never_meet_are_refused(name, value, complaint):
    with pytest.raises(ConfigurationError, match=re.escape(complaint)):
        middleware.check_environment({name: value})
