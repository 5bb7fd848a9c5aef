#!/usr/bin/python3
"""Every exposure of a run, judged against the setup and the poses that it was made from."""
import csv
import sys
import time
import unittest

import numpy as np
import rospy
import rostest
import yaml
from geometry_msgs.msg import PoseStamped
from sensor_msgs.msg import CameraInfo, Image
from std_srvs.srv import Trigger
from tf2_msgs.msg import TFMessage

EXPOSURES = 8
RATE = 5.0
DETECTORS = ["detector_a", "detector_b"]
TIMEOUT = 60.0


def wait_for(condition, what):
    deadline = time.monotonic() + TIMEOUT
    while not condition():
        if time.monotonic() > deadline:
            raise AssertionError("no %s within %g s" % (what, TIMEOUT))
        time.sleep(0.01)


def rotation_from_quaternion(x, y, z, w):
    return np.array([
        [1 - 2 * (y * y + z * z), 2 * (x * y - z * w), 2 * (x * z + y * w)],
        [2 * (x * y + z * w), 1 - 2 * (x * x + z * z), 2 * (y * z - x * w)],
        [2 * (x * z - y * w), 2 * (y * z + x * w), 1 - 2 * (x * x + y * y)]])


def numbers(position, orientation):
    return np.array([position.x, position.y, position.z, orientation.x, orientation.y, orientation.z, orientation.w])


class SimulatorTest(unittest.TestCase):
    @classmethod
    def setUpClass(cls):
        with open(rospy.get_param("~setup_file")) as file:
            cls.setup = yaml.safe_load(file)
        with open(rospy.get_param("~poses_file")) as file:
            columns = ["tx_mm", "ty_mm", "tz_mm", "qx", "qy", "qz", "qw"]
            cls.poses = np.array([[float(row[name]) for name in columns] for row in csv.DictReader(file)])
        cls.images = {name: [] for name in DETECTORS}
        cls.infos = {name: [] for name in DETECTORS}
        cls.truth = []
        cls.transforms = []
        subscribers = [rospy.Subscriber("patient_ground_truth", PoseStamped, cls.truth.append),
                       rospy.Subscriber("/tf", TFMessage, lambda m: cls.transforms.extend(m.transforms))]
        for name in DETECTORS:
            subscribers.append(rospy.Subscriber(name + "/image_raw", Image, cls.images[name].append))
            subscribers.append(rospy.Subscriber(name + "/camera_info", CameraInfo, cls.infos[name].append))
        wait_for(lambda: all(s.get_num_connections() > 0 for s in subscribers), "publisher of every topic")

        start = rospy.ServiceProxy("detector_simulator/start", Trigger)
        start.wait_for_service(TIMEOUT)
        cls.before_start = len(cls.truth)
        cls.refusals = []

        def started():
            answer = start()
            if not answer.success:
                cls.refusals.append(answer.message)
            return answer.success

        wait_for(started, "start")
        cls.while_running = start()
        everything = [cls.truth, cls.transforms] + list(cls.images.values()) + list(cls.infos.values())
        wait_for(lambda: all(len(messages) >= EXPOSURES for messages in everything), "exposures")
        # Three periods more, in which nothing may come.
        time.sleep(3.0 / RATE)
        cls.when_done = start()

    def test_start_answers(self):
        self.assertEqual(self.before_start, 0)
        for text in self.refusals:
            self.assertIn("not ready", text)
        self.assertFalse(self.while_running.success)
        self.assertIn("already running", self.while_running.message)
        self.assertFalse(self.when_done.success)
        self.assertIn("done", self.when_done.message)

    def test_one_stamp_an_exposure(self):
        stamps = [message.header.stamp for message in self.truth]
        self.assertEqual(len(stamps), EXPOSURES)
        self.assertEqual([t.header.stamp for t in self.transforms], stamps)
        for name in DETECTORS:
            self.assertEqual([m.header.stamp for m in self.images[name]], stamps)
            self.assertEqual([m.header.stamp for m in self.infos[name]], stamps)
        for earlier, later in zip(stamps, stamps[1:]):
            self.assertLess(earlier, later)
        # The rate is an upper bound; a busy machine may take longer.
        self.assertGreater((stamps[-1] - stamps[0]).to_sec(), 0.95 * (EXPOSURES - 1) / RATE)

    def test_truth_is_the_files(self):
        for pose, transform, row in zip(self.truth, self.transforms, self.poses):
            self.assertEqual(pose.header.frame_id, "treatment_room")
            self.assertEqual(transform.header.frame_id, "treatment_room")
            self.assertEqual(transform.child_frame_id, "patient_ground_truth")
            published = numbers(pose.pose.position, pose.pose.orientation)
            np.testing.assert_array_equal(numbers(transform.transform.translation, transform.transform.rotation),
                                          published)
            sign = np.sign(np.dot(published[3:], row[3:]))
            np.testing.assert_allclose(published[:3] * 1000.0, row[:3], atol=1e-6)
            np.testing.assert_allclose(sign * published[3:], row[3:], atol=1e-8)

    def test_images(self):
        for detector in self.setup["detectors"]:
            columns, rows = detector["image_size"]
            before = None
            for image in self.images[detector["name"]]:
                self.assertEqual(image.header.frame_id, detector["name"] + "_optical_frame")
                self.assertEqual((image.width, image.height), (columns, rows))
                self.assertEqual(image.encoding, "mono16")
                self.assertEqual(image.step, 2 * columns)
                self.assertEqual(len(image.data), 2 * columns * rows)
                self.assertEqual(image.is_bigendian, 0)
                counts = np.frombuffer(image.data, dtype="<u2").reshape(rows, columns).astype(float)
                # Air is near its counts, bone behind soft tissue lets less than a fifth through.
                self.assertGreater(counts.max(), 0.9 * 60000)
                self.assertLess(counts.min(), 0.2 * 60000)
                if before is not None:
                    self.assertGreater(np.abs(counts - before).mean(), 10.0)
                before = counts

    def test_camera_info_projects_the_target(self):
        box = self.setup["target_box_mm"]
        centre = 0.5 * (np.array(box["min"]) + np.array(box["max"]))
        for detector in self.setup["detectors"]:
            x, y, source, origin = (np.array(detector[key]) for key in
                                    ("x_direction", "y_direction", "source_mm", "origin_mm"))
            normal = np.cross(x, y)
            pitch = np.array(detector["pixel_pitch_mm"])
            for info, pose in zip(self.infos[detector["name"]], self.truth):
                self.assertEqual(info.header.frame_id, detector["name"] + "_optical_frame")
                self.assertEqual([info.width, info.height], detector["image_size"])
                p, q = pose.pose.position, pose.pose.orientation
                target = rotation_from_quaternion(q.x, q.y, q.z, q.w) @ centre + 1000.0 * np.array([p.x, p.y, p.z])
                # Where the line from the source through the target meets the panel.
                reach = np.dot(origin - source, normal) / np.dot(target - source, normal)
                on_panel = source + reach * (target - source) - origin
                expected = np.array([np.dot(on_panel, x), np.dot(on_panel, y)]) / pitch
                seen = np.array(info.K).reshape(3, 3) @ np.array([x, y, normal]) @ (target - source)
                # Metres and millimetres in double precision.
                np.testing.assert_allclose(seen[:2] / seen[2], expected, atol=1e-6)
                self.assertTrue((expected > 0).all() and (expected < detector["image_size"]).all())


if __name__ == "__main__":
    rospy.init_node("simulator_test")
    rostest.rosrun("xray_tracking_detector_simulator", "simulator_test", SimulatorTest, sys.argv)
