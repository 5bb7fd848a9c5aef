#!/usr/bin/python3
"""Real anatomy by rosbag playback: each exposure is tracked and then registered, and both poses are judged."""
import os
import subprocess
import sys
import tempfile

import numpy as np
import rospy
import rostest
import yaml
from std_srvs.srv import SetBool

sys.path.insert(0, os.path.dirname(os.path.abspath(__file__)))
from graph_test_case import DETECTORS, GraphTestCase, matrix, target_registration_error_mm  # noqa: E402
from xray_tracking_msgs.msg import PatientMotion, RefinedPose, RefinementResult  # noqa: E402

# Translation alone, on a region of which a part moves otherwise than the target and which rotates by up to 2.4 degrees:
# no better than the method's own published limits (peers.md's figure for the paper's way is 1.07 / 1.35 mm).
MEDIAN_MM, P95_MM = 1.2, 2.4
# Of the registration with two bodies: what it is specified to reach.
REFINED_MEDIAN_MM, REFINED_P95_MM = 0.2, 0.4


class SequenceTest(GraphTestCase):
    def test_every_exposure(self):
        sequence = sys.argv[1]
        if not os.path.isfile(os.path.join(sequence, "sequence.yaml")):
            # rostest's result files know no skipped tests; scripts/summarize_tests.py reads this line.
            print("skipped: test_every_exposure")
            self.skipTest(f"{sequence} is not there")
        with open(os.path.join(sequence, "sequence.yaml"), encoding="utf-8") as file:
            box = yaml.safe_load(file)["target_box_mm"]
        with open(os.path.join(sequence, "frames.csv"), encoding="utf-8") as file:
            exposures = len({line.split(",")[0] for line in file.read().split("\n")[1:] if line})
        self.wait_for_graph()
        refined = {}
        rospy.Subscriber("refined_pose", RefinedPose, lambda message: refined.update({message.header.stamp: message}))
        with tempfile.TemporaryDirectory() as folder:
            bag = os.path.join(folder, "exposures.bag")
            subprocess.run(["rosrun", "xray_tracking_tools", "sequence_to_bag", sequence, bag], check=True)
            player = subprocess.Popen(["rosbag", "play", "--clock", "--quiet", "--pause", bag, "__name:=player"])
            try:
                listeners = {"/patient_ground_truth": [rospy.get_name()]}
                for name in DETECTORS:
                    listeners[f"/{name}/image_raw"] = ["/xray_nodelets", "/registration"]
                    listeners[f"/{name}/camera_info"] = ["/motion_estimation", "/registration"]
                self.wait_for_listeners("/player", listeners)
                self.wait_for_listeners("/motion_estimation", {"/patient_motion": ["/registration"],
                                                               "/patient_pose": ["/registration"]})
                rospy.ServiceProxy("/player/pause_playback", SetBool)(False)
                self.wait_for(lambda: len(self.motions) >= exposures and len(refined) >= exposures, 120.0,
                              f"{exposures} exposures answered")
            finally:
                player.terminate()
                player.wait()
        for stamp, motion in self.motions.items():
            self.assertEqual(motion.state, PatientMotion.OK, f"{stamp}: {motion.reason}")
        self.wait_for(lambda: len(self.poses) >= exposures, 10.0, "poses")
        errors = self.errors_mm((box["min"], box["max"]))
        print(f"TRE mm: median {np.median(errors[1:]):.3f}, max {errors.max():.3f}")
        self.assertEqual(len(errors), exposures)
        self.assertLessEqual(np.median(errors[1:]), MEDIAN_MM)
        self.assertLessEqual(np.percentile(errors[1:], 95), P95_MM)

        self.assertEqual(len(refined), exposures)
        for stamp, message in refined.items():
            self.assertEqual(message.result.status, RefinementResult.SUCCESS, f"{stamp}: {message.result.reason}")
            self.assertEqual(message.method, "tracking_and_registration")
        errors = [target_registration_error_mm(matrix(refined[stamp].result.pose.pose.position,
                                                      refined[stamp].result.pose.pose.orientation),
                                               self.gold[stamp], (box["min"], box["max"]))
                  for stamp in sorted(self.gold)]
        print(f"refined TRE mm: median {np.median(errors[1:]):.3f}, max {max(errors):.3f}")
        self.assertLessEqual(np.median(errors[1:]), REFINED_MEDIAN_MM)
        self.assertLessEqual(np.percentile(errors[1:], 95), REFINED_P95_MM)


if __name__ == "__main__":
    rospy.init_node("sequence_test")
    rostest.rosrun("xray_tracking_bringup", "sequence", SequenceTest)
