#!/usr/bin/python3
"""Three detectors that are called otherwise than the default's: all of them are tracked, registered and believed."""
import os
import sys

import numpy as np
import rospkg
import rospy
import rostest
import yaml

sys.path.insert(0, os.path.dirname(os.path.abspath(__file__)))
from graph_test_case import GraphTestCase, matrix, target_registration_error_mm  # noqa: E402
from xray_tracking_msgs.msg import PatientMotion, RefinedPose, RefinementResult, TrackedRegion  # noqa: E402

EXPOSURES = 15


class ThreeDetectorsTest(GraphTestCase):
    detectors = ("left", "right", "above")

    def test_every_exposure(self):
        refined = {}
        rospy.Subscriber("refined_pose", RefinedPose, lambda message: refined.update({message.header.stamp: message}))
        self.wait_for_subscribers({f"/{name}/{topic}": ["/registration"] for name in self.detectors
                                   for topic in ("image_raw", "camera_info")})
        self.wait_for_subscribers({"/refined_pose": [rospy.get_name()]})
        errors = self.phantom_errors_mm(EXPOSURES)
        self.wait_for(lambda: len(refined) == EXPOSURES, 30.0, "all exposures registered")
        setup_path = os.path.join(rospkg.RosPack().get_path("xray_tracking_bringup"), "test", "three_detectors.yaml")
        with open(setup_path, encoding="utf-8") as file:
            box = yaml.safe_load(file)["target_box_mm"]
        registered = []
        for stamp in sorted(self.gold):
            result = refined[stamp].result
            self.assertEqual(result.status, RefinementResult.SUCCESS, result.reason)
            pose = matrix(result.pose.pose.position, result.pose.pose.orientation)
            registered.append(target_registration_error_mm(pose, self.gold[stamp], (box["min"], box["max"])))
            self.assertEqual(self.motions[stamp].state, PatientMotion.OK, self.motions[stamp].reason)
            for name in self.detectors:
                self.assertEqual(self.regions[name][stamp].state, TrackedRegion.TRACKING)
        print(f"TRE mm: tracked: median {np.median(errors[1:]):.3f}, max {errors.max():.3f}; "
              f"registered: median {np.median(registered[1:]):.3f}, max {max(registered):.3f}")
        # 0.07 and 0.11 in repeated runs: what is published is what is registered.
        self.assertLessEqual(np.median(errors[1:]), 0.10)
        self.assertLessEqual(errors.max(), 0.2)
        self.assertLessEqual(np.median(registered[1:]), 0.10)
        self.assertLessEqual(max(registered), 0.2)


if __name__ == "__main__":
    rospy.init_node("three_detectors_test")
    rostest.rosrun("xray_tracking_bringup", "three_detectors", ThreeDetectorsTest)
