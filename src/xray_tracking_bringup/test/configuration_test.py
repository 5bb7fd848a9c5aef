#!/usr/bin/python3
"""Loads every launch and YAML file of the package set."""
import itertools
import os
import pathlib
import shlex
import subprocess
import tempfile
import unittest
import unittest.mock
import xml.etree.ElementTree

import roslaunch.config
import roslaunch.xmlloader
import roslib.packages
import rospkg
import rostest
import yaml

PACKAGES = [name for name in rospkg.RosPack().list() if name.startswith("xray_tracking_")]
METHODS = ("tracking", "registration", "tracking_and_registration")
REQUIRED_ARGUMENTS = {
    "tracker_parameters.launch": ["setup_file:=/setup.yaml"],
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
                    self.assertTrue(config.nodes or path.name == "tracker_parameters.launch")
                    for node in config.nodes:
                        self.assertTrue(roslib.packages.find_node(node.package, node.type),
                                        f"{node.package}/{node.type}")

    def test_nodes_stay_on_this_computer_unless_told_otherwise(self):
        other = {"ROS_HOSTNAME": "robot.example.org", "ROS_IP": "192.0.2.1"}
        for path in files("launch", "*.launch"):
            if path.name in ("tracker_parameters.launch", "supervisor.launch"):  # included by the others, in what they set
                continue
            required = REQUIRED_ARGUMENTS.get(path.name, [])
            for environment, arguments, expected in (({}, [], "localhost"),
                                                     ({"ROS_IP": other["ROS_IP"]}, [], other["ROS_IP"]),
                                                     (other, [], other["ROS_HOSTNAME"]),
                                                     (other, ["hostname:=here"], "here")):
                with self.subTest(path=path.name, environment=environment, arguments=arguments), \
                        unittest.mock.patch.dict(os.environ, environment):
                    for name in set(other) - set(environment):
                        os.environ.pop(name, None)
                    for node in load(path, required + arguments).nodes:
                        self.assertEqual(dict(node.env_args).get("ROS_HOSTNAME"), expected, node.name)

    def test_where_there_is_a_ct_it_is_registered(self):
        path = next(path for path in files("launch", "*.launch") if path.name == "tracking.launch")
        for source, method in (("ct", "tracking_and_registration"), ("phantom", "tracking")):
            params = load(path, REQUIRED_ARGUMENTS[path.name] + [f"source:={source}"]).params
            self.assertEqual(params["/motion_estimation/method"].value, method)
        # What is not simulated is no phantom.
        path = path.with_name("treatment_room.launch")
        for simulator, source in (("true", "phantom"), ("false", "ct")):
            params = load(path, [f"simulator:={simulator}", "registration:=true"]).params
            self.assertEqual(params["/registration/source"].value, source)

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

    def test_a_name_arrives_whole_and_of_this_folder(self):
        """With a space in it; one without a folder is of the folder that roslaunch is started in, not of ROS_HOME."""
        cases = {"treatment_room.launch": ["setup_file", "record", "data_folder"],
                 "playback.launch": ["setup_file", "record", "data_folder", "bag", "rviz_config"],
                 "tracking.launch": ["setup_file", "record", "data_folder", "rviz_config"],
                 "latency.launch": ["sequence", "json"]}
        for (name, arguments), folder in itertools.product(cases.items(), ("/room a/", "")):
            path = next(path for path in files("launch", "*.launch") if path.name == name)
            text = path.read_text()
            given = {key: folder + key + "_x" for key in arguments}
            required = [words for words in REQUIRED_ARGUMENTS.get(name, []) if words.split(":=")[0] not in arguments]
            switches = [f"{key}:=true" for key in ("rviz", "registration") if f'<arg name="{key}"' in text]
            with self.subTest(launch=name, folder=folder), unittest.mock.patch.dict(os.environ, {"PWD": "/he re"}):
                # The parts of a bag are separated by spaces.
                config = load(path, required + switches + [f"{key}:='{value}'" if key == "bag" and folder else
                                                           f"{key}:={value}" for key, value in given.items()])
                arrived = [word for node in config.nodes for word in shlex.split(node.args)]
                arrived += [param.value for param in config.params.values()]
                for key, value in given.items():
                    expected = value if folder else "/he re/" + value
                    self.assertEqual({word for word in arrived if str(word).endswith(key + "_x")}, {expected})

    def test_a_run_does_not_take_an_earlier_recording_for_its_own(self):
        run = pathlib.Path(rospkg.RosPack().get_path("xray_tracking_bringup")).parent.parent / "scripts" / "run"
        if not run.is_file():
            self.skipTest("an installed package")
        with tempfile.TemporaryDirectory() as out:
            pathlib.Path(out, "recorded.bag").touch()
            result = subprocess.run([str(run), "--headless", "--out", out], capture_output=True, text=True, timeout=20,
                                    check=False)
            self.assertEqual(result.returncode, 1)
            self.assertIn("recorded.bag", result.stderr)

    def test_acceptance_of_nothing_fails(self):
        with tempfile.TemporaryDirectory() as folder:
            pathlib.Path(folder, "recorded.bag").touch()
            cases = {f"--sequence={folder}/misspelt": "there is no sequence.yaml in it",
                     "--sequence=misspelt": f"{folder}/misspelt: there is no sequence.yaml in it",  # of this folder
                     f"--bag={folder}/recorded.bag": "recorded.bag is of an earlier run"}
            for argument, expected in cases.items():
                program = str(pathlib.Path(__file__).parent / "acceptance_test.py")
                result = subprocess.run([program, argument, f"--out={folder}", f"--gtest_output=xml:{folder}/r.xml"],
                                        env=dict(os.environ, PWD=folder), capture_output=True, text=True, timeout=50,
                                        check=False)
                with self.subTest(argument=argument):
                    self.assertIn(expected, result.stdout + result.stderr)
                    self.assertNotIn("SUCCESS", result.stdout)
            allowed = subprocess.run([program, "--sequence=/nowhere", "--may_be_absent=true",
                                      f"--gtest_output=xml:{folder}/r.xml"], capture_output=True, text=True, timeout=50,
                                     check=False)
            self.assertIn("SUCCESS", allowed.stdout)
            self.assertIn("skipped: ", pathlib.Path(folder, "r.xml").read_text())

    def test_rosdep_knows_every_dependency(self):
        source = pathlib.Path(rospkg.RosPack().get_path("xray_tracking_bringup")).parent
        rosdep = source.parent / "rosdep"
        if not rosdep.is_dir():
            self.skipTest("an installed package")
        ours = set(yaml.safe_load((rosdep / "xray_tracking.yaml").read_text()))
        theirs = {line for line in (rosdep / "known_keys.txt").read_text().splitlines() if line and line[0] != "#"}
        self.assertEqual(ours & theirs, set())
        wanted = set()
        manifests = list(source.glob("*/package.xml"))
        self.assertEqual(len(manifests), 11)
        for manifest in manifests:
            for element in xml.etree.ElementTree.parse(str(manifest)).getroot():
                if element.tag.endswith("depend"):
                    wanted.add(element.text)
            self.assertTrue((manifest.parent / "CHANGELOG.rst").is_file(), manifest)
        self.assertEqual(wanted - ours - theirs - set(rospkg.RosPack().list()), set())
        self.assertEqual((ours | theirs) - wanted, set(), "keys that nobody needs")

    def test_what_becomes_of_a_node_that_dies(self):
        for name in ("tracking.launch", "playback.launch", "treatment_room.launch"):
            path = next(path for path in files("launch", "*.launch") if path.name == name)
            arguments = REQUIRED_ARGUMENTS.get(name, []) + ["method:=tracking_and_registration", "rviz:=true",
                                                            "record:=/recorded.bag"]
            for node in load(path, arguments).nodes:
                expected = {"recorder": "nothing", "rviz": "nothing", "player": "nothing"}
                policy = "required" if node.required else "respawn" if node.respawn else "nothing"
                self.assertEqual(policy, expected.get(node.name, "respawn"), f"{name}: {node.name}")

    def test_every_parameter_file_is_loaded(self):
        launch = "".join(path.read_text() for path in files("launch", "*.launch"))
        for path in pathlib.Path(rospkg.RosPack().get_path("xray_tracking_bringup"), "config").glob("*.yaml"):
            self.assertIn(f'file="$(arg config)/{path.name}"', launch)

    def test_every_yaml_file_is_one(self):
        paths = list(files("config", "*.yaml")) + list(files("rviz", "*.rviz"))
        self.assertGreaterEqual(len(paths), 5)
        for path in paths:
            with self.subTest(path=path.name):
                self.assertIsInstance(yaml.safe_load(path.read_text()), dict)


if __name__ == "__main__":
    rostest.rosrun("xray_tracking_bringup", "configuration", ConfigurationTest)
