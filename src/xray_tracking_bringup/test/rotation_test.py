#!/usr/bin/python3
"""Trackers of the euclidean model on a phantom that rotates by up to three degrees, every pose judged."""
import os
import sys

import numpy as np
import rospy
import rostest

sys.path.insert(0, os.path.dirname(os.path.abspath(__file__)))
from graph_test_case import DETECTORS, GraphTestCase  # noqa: E402
from xray_tracking_msgs.msg import PatientMotion, TrackedRegion  # noqa: E402

EXPOSURES = 30
# What two views see of it is the rotation about their rays, the rest stays. Translation alone comes to 0.47 and 1.05 mm,
# these trackers to 0.32 and 0.70, in repeated runs.
MEDIAN_MM, LARGEST_MM = 0.38, 0.84


class RotationTest(GraphTestCase):
    def test_every_exposure(self):
        errors = self.phantom_errors_mm(EXPOSURES)
        first = self.gold[min(self.gold)]
        turned = [np.degrees(np.arccos(np.clip((np.trace(pose[:3, :3] @ first[:3, :3].T) - 1) / 2, -1, 1)))
                  for pose in self.gold.values()]
        print(f"TRE mm: median {np.median(errors[1:]):.3f}, max {errors.max():.3f}; largest rotation {max(turned):.2f}")
        self.assertGreater(max(turned), 2.0)
        self.assertLess(np.median(errors[1:]), MEDIAN_MM)
        self.assertLess(errors.max(), LARGEST_MM)
        for stamp, motion in self.motions.items():
            self.assertEqual(motion.state, PatientMotion.OK, motion.reason)
            for name in DETECTORS:
                region = self.regions[name][stamp]
                self.assertEqual(region.model, TrackedRegion.EUCLIDEAN)
                # A rotation and nothing else.
                linear = np.reshape(region.linear, (2, 2))
                np.testing.assert_allclose(linear @ linear.T, np.eye(2), atol=1e-9)
        # The launch files' default: good poses, for which nobody vouches.
        self.assert_never_verified("initial_pose_verified is false")


if __name__ == "__main__":
    rospy.init_node("rotation_test")
    rostest.rosrun("xray_tracking_bringup", "rotation", RotationTest)
