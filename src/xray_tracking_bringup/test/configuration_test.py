#!/usr/bin/python3
"""Loads every launch and YAML file of the package set."""
import itertools
import pathlib
import unittest

import roslaunch.config
import roslaunch.xmlloader
import roslib.packages
import rospkg
import rostest
import yaml

PACKAGES = [name for name in rospkg.RosPack().list() if name.startswith("xray_tracking_")]
METHODS = ("tracking", "registration", "tracking_and_registration")
REQUIRED_ARGUMENTS = {
    "trackers.launch": ["setup_file:=/setup.yaml"],
    "tracking.launch": ["setup_file:=/setup.yaml"],
    "playback.launch": ["bag:=/exposures.bag", "setup_file:=/setup.yaml"],
    "supervisor.launch": ["start_mode:=simulator", "start_service:=/start", "exposures:=1"],
    "latency.launch": ["sequence:=/sequence"],
}


def files(folder, pattern):
    for package in PACKAGES:
        yield from sorted(pathlib.Path(rospkg.RosPack().get_path(package), folder).rglob(pattern))


def load(path, arguments):
    config = roslaunch.config.ROSLaunchConfig()
    roslaunch.xmlloader.XmlLoader(resolve_anon=False).load(str(path), config, argv=arguments, verbose=False)
    return config


class ConfigurationTest(unittest.TestCase):
    def test_every_launch_file_loads_and_its_nodes_exist(self):
        paths = list(files("launch", "*.launch"))
        self.assertGreaterEqual(len(paths), 3)
        for path in paths:
            for switch, method in itertools.product(("false", "true"), METHODS):
                arguments = list(REQUIRED_ARGUMENTS.get(path.name, []))
                text = path.read_text()
                values = {"rviz": switch, "supervised": switch, "method": method}
                arguments += [f"{name}:={value}" for name, value in values.items() if f'<arg name="{name}"' in text]
                with self.subTest(path=path.name, arguments=arguments):
                    config = load(path, arguments)
                    self.assertEqual(config.config_errors, [])
                    self.assertTrue(config.nodes)
                    for node in config.nodes:
                        self.assertTrue(roslib.packages.find_node(node.package, node.type),
                                        f"{node.package}/{node.type}")

    def test_where_there_is_a_ct_it_is_registered(self):
        path = next(path for path in files("launch", "*.launch") if path.name == "tracking.launch")
        for source, method in (("ct", "tracking_and_registration"), ("phantom", "tracking")):
            params = load(path, REQUIRED_ARGUMENTS[path.name] + [f"source:={source}"]).params
            self.assertEqual(params["/motion_estimation/method"].value, method)

    def test_who_verifies_the_pose(self):
        path = next(path for path in files("launch", "*.launch") if path.name == "tracking.launch")
        arguments = REQUIRED_ARGUMENTS[path.name]
        for method, mode in zip(METHODS, ("never", "every_frame", "every_frame")):
            params = load(path, arguments + [f"method:={method}"]).params
            self.assertEqual(params["/motion_estimation/method"].value, method)
            self.assertEqual(params["/motion_estimation/refinement/mode"].value, mode)
            self.assertNotIn("/registration/method", params)
            self.assertIs(params["/motion_estimation/gate/initial_pose_verified"].value, False)
        for name in ("tracking.launch", "playback.launch", "treatment_room.launch"):
            path = next(path for path in files("launch", "*.launch") if path.name == name)
            params = load(path, REQUIRED_ARGUMENTS.get(name, []) + ["initial_pose_verified:=true"]).params
            self.assertIs(params["/motion_estimation/gate/initial_pose_verified"].value, True)

    def test_what_becomes_of_a_node_that_dies(self):
        # Who has the state of the run ends it, as a new one would not know where the patient is; all else begins anew.
        for name in ("tracking.launch", "playback.launch", "treatment_room.launch"):
            path = next(path for path in files("launch", "*.launch") if path.name == name)
            arguments = REQUIRED_ARGUMENTS.get(name, []) + ["method:=tracking_and_registration", "rviz:=true",
                                                            "record:=/recorded.bag"]
            for node in load(path, arguments).nodes:
                expected = {"xray_nodelets": "required", "motion_estimation": "required", "recorder": "nothing",
                            "rviz": "nothing", "player": "nothing", "detector_simulator": "nothing"}
                policy = "required" if node.required else "respawn" if node.respawn else "nothing"
                self.assertEqual(policy, expected.get(node.name, "respawn"), f"{name}: {node.name}")

    def test_every_yaml_file_is_one(self):
        paths = list(files("config", "*.yaml")) + list(files("rviz", "*.rviz"))
        self.assertGreaterEqual(len(paths), 5)
        for path in paths:
            with self.subTest(path=path.name):
                self.assertIsInstance(yaml.safe_load(path.read_text()), dict)


if __name__ == "__main__":
    rostest.rosrun("xray_tracking_bringup", "configuration", ConfigurationTest)
