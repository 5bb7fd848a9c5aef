#!/usr/bin/python3
"""Plays a recording through the live graph and holds what it publishes against limits: see acceptance.test."""
import argparse
import csv
import json
import os
import subprocess
import sys
import tempfile
import unittest

import numpy as np
import rosbag
import rospy
import rostest
import yaml
from xray_tracking_msgs.msg import PatientMotion

LIMITS = ("max_median_mm", "max_p95_mm", "max_mm", "min_share", "min_registered", "min_verified", "max_latency_ms",
          "gate_max_mm")


def limit(text):
    return float(text) if text else None


def read_arguments():
    parser = argparse.ArgumentParser()
    for name in ("sequence", "may_be_absent", "bag", "setup_file", "method", "initial_pose_verified", "speed", "deadline",
                 "config", "out"):
        parser.add_argument("--" + name)
    for name in LIMITS:
        parser.add_argument("--" + name, type=limit)
    return parser.parse_known_args(rospy.myargv(sys.argv)[1:])[0]


def tool(*command):
    """What a command of xray_tracking_tools prints. Its exit status is judged by what it leaves."""
    return subprocess.run(["rosrun", "xray_tracking_tools", *command], stdout=subprocess.PIPE,
                          stderr=subprocess.STDOUT, text=True, check=False).stdout


def parts(bag):
    """Of a recording that was split, all, as it is named by its first one."""
    found = [bag]
    while bag.endswith("_0.bag") and os.path.isfile(f"{bag[:-6]}_{len(found)}.bag"):
        found.append(f"{bag[:-6]}_{len(found)}.bag")
    return found


def messages(bag, names):
    """(topic, message, time) of the topics with such last names."""
    for part in parts(bag):
        with rosbag.Bag(part) as recording:
            topics = [topic for topic in recording.get_type_and_topic_info().topics if topic.split("/")[-1] in names]
            yield from recording.read_messages(topics) if topics else ()


class AcceptanceTest(unittest.TestCase):
    @classmethod
    def setUpClass(cls):
        # Names are of the folder that rostest is started in; nodes run in ROS_HOME.
        os.chdir(os.environ.get("PWD", "."))
        cls.arguments = read_arguments()
        missing = cls.arguments.sequence and not os.path.isfile(os.path.join(cls.arguments.sequence, "sequence.yaml"))
        cls.absent = missing and cls.arguments.may_be_absent == "true"
        if cls.absent:
            return
        if missing:
            raise ValueError(f"{os.path.abspath(cls.arguments.sequence)}: there is no sequence.yaml in it")
        cls.temporary = tempfile.TemporaryDirectory()
        cls.out = os.path.abspath(cls.arguments.out or cls.temporary.name)
        os.makedirs(cls.out, exist_ok=True)
        cls.run_graph()

    @classmethod
    def tearDownClass(cls):
        if not cls.absent:
            cls.temporary.cleanup()

    def setUp(self):
        if self.absent:
            # rostest's result files know no skipped tests; scripts/summarize_tests.py reads this line.
            print(f"skipped: {self._testMethodName}")
            self.skipTest(f"{self.arguments.sequence} is not there")

    @classmethod
    def run_graph(cls):
        arguments = cls.arguments
        bag, setup_file = arguments.bag, arguments.setup_file
        if bool(bag) == bool(arguments.sequence):
            raise ValueError("expected either sequence:= or bag:=")
        recorded = os.path.join(cls.out, "recorded.bag")
        if os.path.exists(recorded):  # it would be judged if this run recorded nothing
            raise ValueError(f"{recorded} is of an earlier run: expected another folder for out:=")
        if arguments.sequence:
            setup_file = setup_file or os.path.join(arguments.sequence, "sequence.yaml")
            bag = os.path.join(cls.out, "exposures.bag")
            said = tool("sequence_to_bag", arguments.sequence, bag)
            if not os.path.isfile(bag):
                raise ValueError(said)
        stamps = {}
        for topic, message, _ in messages(bag, ("run_description", "camera_info")):
            if topic.endswith("/camera_info"):
                stamps.setdefault(topic.split("/")[-2], set()).add(message.header.stamp)
            elif not setup_file:
                setup_file = os.path.join(cls.out, "setup.yaml")
                with open(setup_file, "w", encoding="utf-8") as file:
                    file.write(json.loads(message.data)["setup"])
        if not setup_file:
            raise ValueError(f"{bag} has no setup in it (run_description): expected setup_file:=SETUP.yaml")
        with open(setup_file, encoding="utf-8") as file:
            setup = yaml.safe_load(file)
        if isinstance(setup["detectors"], str):
            with open(os.path.join(os.path.dirname(setup_file), setup["detectors"]), encoding="utf-8") as file:
                setup["detectors"] = yaml.safe_load(file)["detectors"]
        detectors = [detector["name"] for detector in setup["detectors"]]
        exposures = len(set.intersection(*(stamps.get(name, set()) for name in detectors)))
        if exposures < 2:
            raise ValueError(f"{bag} has {exposures} exposures of {' '.join(detectors)}, expected 2 or more")
        method = arguments.method or ("tracking_and_registration" if setup.get("ct") else "tracking")
        played = " ".join(f"'{os.path.abspath(part)}'" for part in parts(bag))
        graph = subprocess.run(
            ["roslaunch", "xray_tracking_bringup", "playback.launch", f"bag:={played}", f"setup_file:={setup_file}",
             f"detectors:={' '.join(detectors)}", f"method:={method}", f"speed:={arguments.speed}",
             f"deadline:={arguments.deadline}", f"initial_pose_verified:={arguments.initial_pose_verified}",
             f"config:={arguments.config}", f"record:={recorded}", "rviz:=false", "supervised:=true",
             f"exposures:={exposures}"], stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True, check=False)
        cls.log = graph.stdout
        with open(os.path.join(cls.out, "roslaunch.log"), "w", encoding="utf-8") as file:
            file.write(cls.log)
        cls.table = tool("evaluate_bag", recorded, cls.out, "--setup", setup_file, "--frames", str(exposures))
        print(cls.table)
        with open(os.path.join(cls.out, "tre.csv"), encoding="utf-8") as file:
            cls.frames = [row for row in csv.DictReader(file) if row["method"] == method]
        cls.exposures = exposures
        gates = [message for _, message, _ in messages(recorded, ("beam_gate",))]
        cls.open = {message.exposure.to_sec() for message in gates if message.open}
        cls.verified = {message.exposure.to_sec() for message in gates if message.verified}
        cls.registered = {message.header.stamp.to_sec() for _, message, _ in messages(recorded, ("patient_motion",))
                          if message.state == PatientMotion.OK and message.source == PatientMotion.REGISTERED}

    def told(self, frame):
        return (f"frame {frame['frame']} at {frame['stamp_s']} s, status {frame['status']}, TRE "
                f"{frame['tre_mm'] or 'unknown'} mm, {frame['wall_s']} s")

    def errors(self, name):
        """(error [mm], frame) of the exposures after the first that have a pose, by error."""
        found = sorted(((float(frame["tre_mm"]), frame) for frame in self.frames[1:] if frame["tre_mm"]),
                       key=lambda entry: entry[0])
        self.assertTrue(found, f"{name} cannot be judged: there is no gold standard, or no pose")
        return found

    def hold(self, name, figure, value, worst):
        """value against the limit of that name."""
        bound = getattr(self.arguments, name)
        print(f"{figure} is {value:.4g}, limit {name} {bound:.4g}")
        kept = value >= bound if name.startswith("min_") else value <= bound
        self.assertTrue(kept, f"{figure} is {value:.4g}, limit {name} is {bound:.4g}; worst: {worst}")

    def test_every_exposure_is_answered(self):
        self.assertIn(f"all {self.exposures} exposures were answered", self.log)
        self.assertEqual(len(self.frames), self.exposures, self.table)

    def test_share_with_a_pose(self):
        if self.arguments.min_share is None:
            return
        lost = [frame for frame in self.frames[1:] if frame["status"] != "ok"]
        reasons = [line for line in self.table.splitlines() if " lost: " in line or " failed: " in line]
        self.hold("min_share", "share of exposures with a pose", 1.0 - len(lost) / (self.exposures - 1),
                  f"{self.told(lost[0])}: {reasons[0] if reasons else ''}" if lost else "none is lost")

    @staticmethod
    def is_of(frame, stamps):
        return any(abs(float(frame["stamp_s"]) - stamp) < 1e-4 for stamp in stamps)

    def hold_share_of_all(self, name, figure, stamps):
        if getattr(self.arguments, name) is not None:
            others = [frame for frame in self.frames if not self.is_of(frame, stamps)]
            self.hold(name, figure, 1.0 - len(others) / self.exposures,
                      f"{self.told(others[0])}\n{self.table}" if others else "none is not")

    def test_share_registered(self):
        self.hold_share_of_all("min_registered", "share of exposures with a registered pose", self.registered)

    def test_share_verified(self):
        self.hold_share_of_all("min_verified", "share of exposures whose pose was verified", self.verified)

    def hold_error(self, name, figure, quantile):
        if getattr(self.arguments, name) is not None:
            found = self.errors(name)
            self.hold(name, figure, np.percentile([error for error, _ in found], quantile), self.told(found[-1][1]))

    def test_median_error(self):
        self.hold_error("max_median_mm", "median TRE [mm]", 50)

    def test_p95_error(self):
        self.hold_error("max_p95_mm", "95th percentile of TRE [mm]", 95)

    def test_largest_error(self):
        self.hold_error("max_mm", "largest TRE [mm]", 100)

    def test_latency(self):
        if self.arguments.max_latency_ms is None:
            return
        timed = [frame for frame in self.frames[1:] if frame["wall_s"]]
        self.assertTrue(timed, "max_latency_ms cannot be judged: no exposure has a time")
        worst = max(timed, key=lambda frame: float(frame["wall_s"]))
        self.hold("max_latency_ms", "longest latency [ms]", 1000.0 * float(worst["wall_s"]), self.told(worst))

    def test_open_gate(self):
        if self.arguments.gate_max_mm is None:
            return
        opened = [entry for entry in self.errors("gate_max_mm") if self.is_of(entry[1], self.open)]
        self.assertTrue(opened, f"gate_max_mm cannot be judged: the gate was never open\n{self.table}")
        self.hold("gate_max_mm", "largest TRE under an open gate [mm]", opened[-1][0], self.told(opened[-1][1]))


if __name__ == "__main__":
    rostest.rosrun("xray_tracking_bringup", "acceptance", AcceptanceTest)
