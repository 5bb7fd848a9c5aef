#!/usr/bin/python3
"""Poses on tf are those of the registration, and tracked ones where it refuses."""
import os
import sys

import numpy as np
import rospkg
import rospy
import rostest
import yaml

sys.path.insert(0, os.path.dirname(os.path.abspath(__file__)))
from graph_test_case import DETECTORS, GraphTestCase  # noqa: E402
from xray_tracking_msgs.msg import PatientMotion, RefinedPose, RefinementResult  # noqa: E402

EXPOSURES = 30
# Tracking of translations alone is 0.47 mm off in the median: the target's box is turned by up to 2 degrees. Registered
# poses were 0.058 / 0.087 mm in the median and at most.
MEDIAN_MM, P95_MM = 0.10, 0.15


class RefinementTest(GraphTestCase):
    def test_every_exposure(self):
        setup_path = os.path.join(rospkg.RosPack().get_path("xray_tracking_core"), "config", "phantom_neck.yaml")
        with open(setup_path, encoding="utf-8") as file:
            box = yaml.safe_load(file)["target_box_mm"]
        self.box = (box["min"], box["max"])
        refined = {}
        rospy.Subscriber("refined_pose", RefinedPose, lambda message: refined.update({message.header.stamp: message}))
        self.wait_for_graph()
        self.wait_for_subscribers({f"/{name}/{topic}": ["/registration"] for name in DETECTORS
                                   for topic in ("image_raw", "camera_info")})
        self.wait_for_subscribers({"/refined_pose": [rospy.get_name()], "/diagnostics": [rospy.get_name()]})
        self.start_simulator()
        self.wait_for(lambda: len(self.motions) == len(self.poses) == len(refined) == EXPOSURES, 90.0,
                      "all exposures tracked and registered")
        for stamp, motion in self.motions.items():
            self.assertEqual(motion.state, PatientMotion.OK, f"{stamp}: {motion.reason}")
        self.assertEqual(sorted(refined), sorted(self.gold))
        errors = self.errors_mm(self.box)
        print(f"published: TRE mm: median {np.median(errors[1:]):.3f}, max {errors.max():.3f}")
        getattr(self, sys.argv[1])(refined, errors)

    def accepted(self, refined, errors):
        for stamp, message in refined.items():
            self.assertEqual(message.result.status, RefinementResult.SUCCESS, f"{stamp}: {message.result.reason}")
            self.assertEqual(self.motions[stamp].source, PatientMotion.REGISTERED, self.motions[stamp].not_registered)
        self.assertLessEqual(np.median(errors[1:]), MEDIAN_MM)
        self.assertLessEqual(np.percentile(errors[1:], 95), P95_MM)
        self.assertEqual(len(self.verified()), EXPOSURES)
        self.wait_for(lambda: self.refinements("accepted") == EXPOSURES, 10.0, "all refinements are accepted")

    def refused(self, refined, errors):
        for stamp, message in refined.items():
            self.assertEqual(message.result.status, RefinementResult.UNRELIABLE, f"{stamp}: {message.result.reason}")
            self.assertEqual(self.motions[stamp].source, PatientMotion.TRACKED)
            self.assertIn("probability", self.motions[stamp].not_registered)
        self.wait_for(lambda: self.refinements("refused") == EXPOSURES, 10.0, "all refinements are refused")
        self.assertEqual(self.refinements("accepted"), 0)
        self.assertIn("probability", self.diagnosis["last refusal"])
        self.assert_never_verified("probability")
        # As good as tracking is, which shows what the refinement is for.
        self.assertLess(errors[0], 1e-6)
        self.assertGreater(np.median(errors[1:]), 0.2)
        self.assertLess(errors.max(), 2.0)


if __name__ == "__main__":
    rospy.init_node("refinement_test")
    rostest.rosrun("xray_tracking_bringup", "refinement", RefinementTest)
