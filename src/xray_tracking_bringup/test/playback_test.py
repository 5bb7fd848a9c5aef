#!/usr/bin/python3
"""A bag that is played in a loop, paused and recorded: each time everything begins anew, and the recording is enough."""
import csv
import json
import os
import signal
import subprocess
import sys
import tempfile
import time

import numpy as np
import rosbag
import rospy
import rostest
from geometry_msgs.msg import Point, Quaternion
from std_srvs.srv import SetBool
from visualization_msgs.msg import MarkerArray

sys.path.insert(0, os.path.dirname(os.path.abspath(__file__)))
from graph_test_case import DETECTORS, GraphTestCase, matrix  # noqa: E402
from xray_tracking_msgs.msg import PatientMotion  # noqa: E402

EXPOSURES = 6
PASSES = 2


class PlaybackTest(GraphTestCase):
    def test_loop_pause_and_recording(self):
        sequence = sys.argv[1]
        if not os.path.isfile(os.path.join(sequence, "sequence.yaml")):
            # rostest's result files know no skipped tests; scripts/summarize_tests.py reads this line.
            print("skipped: test_loop_pause_and_recording")
            self.skipTest(f"{sequence} is not there")
        with tempfile.TemporaryDirectory() as folder:
            exposures, recording = os.path.join(folder, "exposures.bag"), os.path.join(folder, "recorded.bag")
            subprocess.run(["rosrun", "xray_tracking_tools", "sequence_to_bag", sequence, exposures, "--frames",
                            str(EXPOSURES)], check=True)
            graph = subprocess.Popen(
                ["roslaunch", "xray_tracking_bringup", "playback.launch", f"bag:={exposures}",
                 f"setup_file:={sequence}/sequence.yaml", "rviz:=false", "deadline:=5", "loop:=true", "pause:=true",
                 f"record:={recording}", "record_split_mb:=4"])
            try:
                passes = self.play()
            finally:
                graph.send_signal(signal.SIGINT)
                graph.wait()
            self.judge_passes(passes)
            self.judge_recording(os.path.join(folder, "recorded_0.bag"), passes[-1], folder)

    def play(self):
        """@return of each pass the registered poses by stamp"""
        self.order, ahead = [], []

        def take(motion):
            if motion.state == PatientMotion.OK:
                ahead.append((motion.header.stamp - rospy.Time.now()).to_sec())
            self.order.append(motion)

        trails = []
        subscribers = [
            rospy.Subscriber("patient_motion", PatientMotion, take, queue_size=1000),
            rospy.Subscriber("treatment_room_markers", MarkerArray,
                             lambda message: trails.extend(len(marker.points) for marker in message.markers
                                                           if marker.ns == "trail"), queue_size=1000)]
        me = rospy.get_name()
        everybody = ["/motion_estimation", "/xray_nodelets", "/registration"]
        topics = {"/clock": everybody}
        for name in DETECTORS:
            topics[f"/{name}/image_raw"] = ["/xray_nodelets", "/registration", "/recorder"]
            topics[f"/{name}/camera_info"] = ["/motion_estimation", "/registration", "/recorder"]
        self.wait_for_listeners("/player", topics)
        self.wait_for_listeners("/motion_estimation", {"/patient_pose": [me, "/recorder", "/treatment_room_publisher"],
                                                       "/patient_motion": [me, "/recorder"]})
        self.wait_for_listeners("/treatment_room_publisher", {"/treatment_room_markers": [me],
                                                              "/run_description": ["/recorder"]})
        pause = rospy.ServiceProxy("/player/pause_playback", SetBool)
        pause(False)
        self.wait_for(lambda: len(self.order) >= 2, 60.0, "two exposures")
        pause(True)
        time.sleep(1.0)  # for what was under way
        stands = len(self.order)
        time.sleep(1.5)  # of three exposures
        self.assertEqual(len(self.order), stands, "nothing comes while it is paused")
        passes = [{}]
        seen = 0
        pause(False)

        def played():
            nonlocal seen
            for motion in self.order[seen:]:
                stamp = motion.header.stamp
                if passes[-1] and stamp <= max(passes[-1]):
                    passes.append({})
                if motion.state != PatientMotion.OK or motion.source != PatientMotion.REGISTERED:
                    # The next pass had begun before the last exposure was answered.
                    self.assertEqual(len(passes[-1]), EXPOSURES - 1,
                                     f"{stamp.to_sec()}: {motion.reason} {motion.not_registered}")
                    self.poses.pop(stamp, None)
                elif stamp in self.poses:
                    passes[-1][stamp] = self.poses.pop(stamp)
                else:
                    return False
                seen += 1
            return len(passes) > PASSES or (len(passes) == PASSES and len(passes[-1]) == EXPOSURES)

        self.wait_for(played, 120.0, f"{PASSES} passes")
        pause(True)
        time.sleep(1.0)
        for subscriber in subscribers:
            subscriber.unregister()
        self.assertLessEqual(max(trails), EXPOSURES, "the trail begins anew")
        self.assertLess(max(ahead), 1.0, "no pose of the pass before comes into the next one")
        return passes[:PASSES]

    def judge_passes(self, passes):
        for each in passes:
            self.assertGreaterEqual(len(each), EXPOSURES - 1)
        for stamp in set(passes[0]) & set(passes[1]):
            np.testing.assert_allclose(passes[1][stamp], passes[0][stamp], rtol=0, atol=1e-12)

    def judge_recording(self, recording, poses, folder):
        parts = sorted(name for name in os.listdir(folder) if name.startswith("recorded_"))
        self.assertGreaterEqual(len(parts), 2, "split by size")
        for part in parts:
            with rosbag.Bag(os.path.join(folder, part)) as bag:
                said = [json.loads(message.data) for _, message, _ in bag.read_messages("/run_description")]
            self.assertTrue(said, f"{part} says what it was recorded with")
            self.assertIn("detectors", said[0]["setup"])
            self.assertIn("xray_tracking", said[0]["versions"])
            self.assertEqual(said[0]["parameters"]["motion_estimation"]["method"], "tracking_and_registration")
        # The same rules without ROS, from the recording alone, give the same poses, to what a message's numbers are
        # rounded by.
        subprocess.run(["rosrun", "xray_tracking_tools", "evaluate_sequence", "--bag", recording, "--methods",
                        "tracking_and_registration", "--out", folder], check=True)
        with open(os.path.join(folder, "poses.csv"), encoding="utf-8") as file:
            rows = [row for row in csv.DictReader(file) if row["method"] == "tracking_and_registration"]
        self.assertEqual(len(rows), EXPOSURES)
        for row, stamp in zip(rows, sorted(poses)):  # which may lack the last
            position = [float(row[key]) for key in ("tx_mm", "ty_mm", "tz_mm")]
            offline = matrix(Point(*(value / 1000.0 for value in position)),
                             Quaternion(*(float(row[key]) for key in ("qx", "qy", "qz", "qw"))))
            # In mm, and in rad over the lever of the patient frame's origin.
            np.testing.assert_allclose(1000.0 * poses[stamp][:3, 3], 1000.0 * offline[:3, 3], rtol=0, atol=1e-6)
            np.testing.assert_allclose(poses[stamp][:3, :3], offline[:3, :3], rtol=0, atol=1e-8)


if __name__ == "__main__":
    rospy.init_node("playback_test")
    rostest.rosrun("xray_tracking_bringup", "playback", PlaybackTest)
