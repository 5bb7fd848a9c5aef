#!/usr/bin/python3
"""The treatment room on tf and in markers, against what the setup file's numbers say."""

import json
import math
import os
import subprocess
import unittest

import numpy as np
import rosgraph
import roslib.packages
import rosnode
import rospy
import rostest
import yaml
from geometry_msgs.msg import PoseWithCovarianceStamped
from std_msgs.msg import String
from tf2_msgs.msg import TFMessage
from visualization_msgs.msg import Marker, MarkerArray
from xray_tracking_msgs.msg import BeamGate, TrackedRegion

WAIT_S = 60.0


def load_setup():
    path = rospy.get_param("/setup_file")
    with open(path) as file:
        setup = yaml.safe_load(file)
    if isinstance(setup["detectors"], str):
        with open(os.path.join(os.path.dirname(path), setup["detectors"])) as file:
            setup["detectors"] = yaml.safe_load(file)["detectors"]
    return setup


def rotation(quaternion):
    """Matrix of a unit quaternion message."""
    x, y, z, w = quaternion.x, quaternion.y, quaternion.z, quaternion.w
    return np.array([[1 - 2 * (y * y + z * z), 2 * (x * y - z * w), 2 * (x * z + y * w)],
                     [2 * (x * y + z * w), 1 - 2 * (x * x + z * z), 2 * (y * z - x * w)],
                     [2 * (x * z - y * w), 2 * (y * z + x * w), 1 - 2 * (x * x + y * y)]])


def vector(message):
    return np.array([message.x, message.y, message.z])


class TreatmentRoomPublisherTest(unittest.TestCase):
    @classmethod
    def setUpClass(cls):
        cls.setup_file = load_setup()
        cls.detectors = {d["name"]: {k: np.array(v, float) for k, v in d.items() if k != "name"}
                         for d in cls.setup_file["detectors"]}
        cls.markers = {}
        cls.subscriber = rospy.Subscriber("treatment_room_markers", MarkerArray, cls.take_markers, queue_size=100)
        cls.pose_publisher = rospy.Publisher("patient_pose", PoseWithCovarianceStamped, queue_size=100)
        cls.gate_publisher = rospy.Publisher("beam_gate", BeamGate, queue_size=100)
        cls.region_publishers = {name: rospy.Publisher(name + "/tracked_region", TrackedRegion, queue_size=100)
                                 for name in cls.detectors}
        cls.wait_for(lambda: cls.markers, "markers")
        cls.wait_for(lambda: cls.pose_publisher.get_num_connections() > 0, "a subscriber of patient_pose")
        for name, publisher in cls.region_publishers.items():
            cls.wait_for(lambda: publisher.get_num_connections() > 0, "a subscriber of " + name)

    @classmethod
    def take_markers(cls, message):
        cls.markers = {(m.ns, m.id): m for m in message.markers}

    @classmethod
    def wait_for(cls, condition, what):
        deadline = rospy.get_time() + WAIT_S
        while not condition():
            if rospy.is_shutdown() or rospy.get_time() > deadline:
                raise AssertionError("no " + what)
            rospy.sleep(0.02)

    def points(self, ns, marker_id):
        return np.array([vector(p) for p in self.markers[(ns, marker_id)].points])

    def pixel(self, name, u, v):
        """Room position of a pixel, docs/frames.md's formula [m]."""
        d = self.detectors[name]
        return 1e-3 * (d["origin_mm"] + u * d["pixel_pitch_mm"][0] * d["x_direction"] +
                       v * d["pixel_pitch_mm"][1] * d["y_direction"])

    def test_says_what_a_recording_is_evaluated_by(self):
        said = json.loads(rospy.wait_for_message("run_description", String, WAIT_S).data)
        setup = yaml.safe_load(said["setup"])
        self.assertEqual([detector["name"] for detector in setup["detectors"]], list(self.detectors))
        self.assertEqual(setup["target_box_mm"], self.setup_file["target_box_mm"])
        self.assertEqual(said["parameters"]["treatment_room_publisher"]["trail_length"], 5)
        self.assertEqual(said["epoch_ns"], 0)
        self.assertTrue(all(said["versions"][name] for name in ("xray_tracking", "roscpp", "opencv", "eigen")))

    def test_static_transforms(self):
        transforms = {t.child_frame_id: t
                      for t in rospy.wait_for_message("/tf_static", TFMessage, WAIT_S).transforms}
        self.assertEqual(set(transforms), {name + "_optical_frame" for name in self.detectors} | {"target"})
        for name, d in self.detectors.items():
            t = transforms[name + "_optical_frame"]
            self.assertEqual(t.header.frame_id, "treatment_room")
            np.testing.assert_allclose(vector(t.transform.translation), 1e-3 * d["source_mm"], atol=1e-9)
            # Directions are given to six digits in the file and re-orthonormalised.
            np.testing.assert_allclose(rotation(t.transform.rotation),
                                       np.column_stack([d["x_direction"], d["y_direction"],
                                                        np.cross(d["x_direction"], d["y_direction"])]), atol=2e-6)
        target = transforms["target"]
        self.assertEqual(target.header.frame_id, "patient")
        box = self.setup_file["target_box_mm"]
        np.testing.assert_allclose(vector(target.transform.translation),
                                   0.5e-3 * (np.array(box["min"]) + np.array(box["max"])), atol=1e-9)
        np.testing.assert_allclose(rotation(target.transform.rotation), np.eye(3), atol=1e-12)

    def test_room_markers(self):
        for i, (name, d) in enumerate(self.detectors.items()):
            np.testing.assert_allclose(vector(self.markers[("sources", i)].pose.position), 1e-3 * d["source_mm"],
                                       atol=1e-9)
            columns, rows = d["image_size"]
            corners = [self.pixel(name, u, v) for u, v in
                       [(-0.5, -0.5), (columns - 0.5, -0.5), (columns - 0.5, rows - 0.5), (-0.5, rows - 0.5)]]
            np.testing.assert_allclose(self.points("panel_outlines", i), corners + corners[:1], atol=2e-6)
            np.testing.assert_allclose(self.points("beams", i)[1::2], corners, atol=2e-6)
            np.testing.assert_allclose(self.points("beams", i)[::2], [1e-3 * d["source_mm"]] * 4, atol=1e-9)
            source, foot = self.points("central_rays", i)
            np.testing.assert_allclose(source, 1e-3 * d["source_mm"], atol=1e-9)
            # The central ray is at right angles to the panel and ends on it.
            self.assertAlmostEqual(np.dot(foot - source, d["x_direction"]), 0.0, delta=1e-5)
            self.assertAlmostEqual(np.dot(foot - source, d["y_direction"]), 0.0, delta=1e-5)
            self.assertAlmostEqual(np.dot(foot - corners[0], np.cross(d["x_direction"], d["y_direction"])), 0.0,
                                   delta=1e-5)
        box = self.points("target_box", 0)
        self.assertEqual(self.markers[("target_box", 0)].header.frame_id, "patient")
        self.assertEqual(len(box), 24)
        limits = self.setup_file["target_box_mm"]
        np.testing.assert_allclose(box.min(axis=0), 1e-3 * np.array(limits["min"]), atol=1e-9)
        np.testing.assert_allclose(box.max(axis=0), 1e-3 * np.array(limits["max"]), atol=1e-9)
        sides = box[1::2] - box[::2]
        self.assertTrue(all(np.count_nonzero(np.abs(side) > 1e-9) == 1 for side in sides), "an edge is a diagonal")
        self.assertIn(("isocentre", 0), self.markers)

    def test_tracked_regions(self):
        for i, name in enumerate(self.detectors):
            region = TrackedRegion(state=TrackedRegion.TRACKING, model=TrackedRegion.AFFINE, displacement_x=3.5,
                                   displacement_y=-2.25, linear=[0.9, -0.2, 0.3, 1.1])
            region.region.x_offset, region.region.y_offset = 100, 120
            region.region.width, region.region.height = 51, 31
            self.region_publishers[name].publish(region)
            key = ("region_rays", i)
            self.wait_for(lambda: key in self.markers and self.markers[key].color.g > 0.5 and
                          self.markers[key].color.r < 0.5, "green ray")
            source, centre = self.points(*key)
            np.testing.assert_allclose(source, 1e-3 * self.detectors[name]["source_mm"], atol=1e-9)
            np.testing.assert_allclose(centre, self.pixel(name, 125 + 3.5, 135 - 2.25), atol=2e-6)
            # The last corner, half of 51 x 31 px from the centre before the motion.
            corner = (128.5 + 0.9 * 25.5 - 0.2 * 15.5, 132.75 + 0.3 * 25.5 + 1.1 * 15.5)
            np.testing.assert_allclose(self.points("regions", i)[2], self.pixel(name, *corner), atol=2e-6)

            region.state = TrackedRegion.DEGRADED
            self.region_publishers[name].publish(region)
            self.wait_for(lambda: self.markers[key].color.r > 0.5 and self.markers[key].color.g > 0.5, "yellow ray")
            np.testing.assert_allclose(self.points("regions", i)[2], self.pixel(name, *corner), atol=2e-6)

            region.state, region.displacement_x = TrackedRegion.LOST, math.nan
            self.region_publishers[name].publish(region)
            self.wait_for(lambda: self.markers[key].color.r > 0.5 and self.markers[key].color.g < 0.5, "red ray")
            np.testing.assert_allclose(self.points(*key)[1], self.pixel(name, 125, 135), atol=2e-6)

            # What a tracker said last is not shown as if it still said so.
            region.state, region.displacement_x = TrackedRegion.TRACKING, 0.0
            self.region_publishers[name].publish(region)
            self.wait_for(lambda: self.markers[key].color.g > 0.8, "green ray")
            self.wait_for(lambda: self.markers[key].color.g < 0.8, "faded ray of a silent tracker")

            region.state = TrackedRegion.UNTRAINED
            self.region_publishers[name].publish(region)
            self.wait_for(lambda: self.markers[key].action == Marker.DELETE, "deleted ray")

    def publish_pose(self, second, x, w=1.0):
        pose = PoseWithCovarianceStamped()
        pose.header.stamp = rospy.Time(second)
        pose.header.frame_id = "treatment_room"
        pose.pose.pose.position.x = x
        pose.pose.pose.orientation.w = w
        self.pose_publisher.publish(pose)

    def test_trail(self):
        box = self.setup_file["target_box_mm"]
        centre = 0.5e-3 * (np.array(box["min"]) + np.array(box["max"]))

        def trail_is(positions):
            trail = self.markers[("trail", 0)]
            return len(trail.points) == len(positions) and np.allclose(
                self.points("trail", 0), [centre + [x, 0, 0] for x in positions], atol=1e-9)

        for k in range(8):  # more than trail_length
            self.publish_pose(100 + k, 0.001 * k)
        self.wait_for(lambda: trail_is([0.003, 0.004, 0.005, 0.006, 0.007]), "trail of the last five poses")
        self.publish_pose(109, math.nan)
        self.publish_pose(110, 0.0, w=0.0)
        self.publish_pose(111, 0.011)
        self.wait_for(lambda: trail_is([0.004, 0.005, 0.006, 0.007, 0.011]), "trail without the bad poses")
        self.publish_pose(4294967295, 0.012)
        self.publish_pose(111, 0.013)
        self.publish_pose(112, 0.014)
        self.wait_for(lambda: trail_is([0.005, 0.006, 0.007, 0.011, 0.014]), "trail without the future and repetitions")
        self.publish_pose(50, 0.050)
        self.publish_pose(51, 0.051)
        self.wait_for(lambda: trail_is([0.050, 0.051]), "new trail after time has jumped back")

    def test_beam_gate(self):
        def shows(green, word):
            marker = self.markers[("beam_gate", 0)]
            return (marker.color.g > marker.color.r) == green and word in marker.text

        self.wait_for(lambda: self.gate_publisher.get_num_connections() > 0, "a subscriber of beam_gate")
        self.wait_for(lambda: shows(False, "nothing on beam_gate"), "hold before anything came")

        def shows_when_sent(green, word, message, valid_for=10.0):
            message.valid_until = rospy.Time.now() + rospy.Duration(valid_for)
            self.gate_publisher.publish(message)
            return shows(green, word)

        self.wait_for(lambda: shows_when_sent(True, "all well", BeamGate(open=True, text="all well")), "open gate")
        reason = "too far " + "away " * 20 + "from where it was"
        self.wait_for(lambda: shows_when_sent(False, "too far", BeamGate(reason=BeamGate.DISPLACED, text=reason)),
                      "closed gate")
        lines = self.markers[("beam_gate", 0)].text.split("\n")
        self.assertEqual(" ".join(lines), "HOLD: " + reason)
        self.assertTrue(all(30 < len(line) <= 44 for line in lines[:-1]), lines)
        self.wait_for(lambda: shows_when_sent(True, "all well", BeamGate(open=True, text="all well")), "open gate")
        self.wait_for(lambda: shows(False, "nothing on beam_gate"), "hold as nothing comes any more")
        # Of a link that stalls, or of a bag that is played beside.
        self.wait_for(lambda: shows_when_sent(False, "not valid", BeamGate(open=True, text="all well"), -1.0),
                      "hold for what has lost its validity")
        contradiction = BeamGate(open=True, reason=BeamGate.DISPLACED, text="both")
        self.wait_for(lambda: shows_when_sent(False, "both", contradiction), "hold for what contradicts itself")

    def test_a_misspelt_parameter_is_named(self):
        program = roslib.packages.find_node("xray_tracking_tools", "treatment_room_publisher")[0]
        rospy.set_param("/misspelt/treatment_room_publisher/trail_lenght", 5)
        node = subprocess.Popen([program, "__ns:=/misspelt", "_setup_file:=" + rospy.get_param("/setup_file")],
                                stdout=subprocess.PIPE, stderr=subprocess.STDOUT, universal_newlines=True)
        try:
            rospy.wait_for_message("/misspelt/treatment_room_markers", MarkerArray, WAIT_S)
        finally:
            node.terminate()
        said, _ = node.communicate(timeout=WAIT_S)
        self.assertIn("parameter /misspelt/treatment_room_publisher/trail_lenght is set, but there is none", said)

    def test_bad_setup_is_survived(self):
        names = ["/bad/no_file", "/bad/not_a_setup", "/bad/no_parameter", "/bad/bad_trail"]
        for name in names:
            self.wait_for(lambda: rosnode.rosnode_ping(name, max_count=1), "answer of " + name)
        publishers = rosgraph.Master("/test").getSystemState()[0]
        self.assertNotIn("/bad/treatment_room_markers", [topic for topic, _ in publishers])


if __name__ == "__main__":
    rospy.init_node("treatment_room_publisher_test")
    rostest.rosrun("xray_tracking_tools", "treatment_room_publisher", TreatmentRoomPublisherTest)
