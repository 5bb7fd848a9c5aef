#!/usr/bin/python3
"""Trackers learn new templates while the graph runs, one alone and both: every exposure has its pose all the same."""
import os
import sys
import threading

import numpy as np
import rospkg
import rospy
import rostest
import yaml

sys.path.insert(0, os.path.dirname(os.path.abspath(__file__)))
from graph_test_case import DETECTORS, GraphTestCase  # noqa: E402
from std_srvs.srv import Trigger  # noqa: E402
from xray_tracking_msgs.msg import PatientMotion, TrackedRegion  # noqa: E402
from xray_tracking_msgs.srv import TrainRegion, TrainRegionResponse  # noqa: E402

EXPOSURES = 50


class NewTemplatesTest(GraphTestCase):
    def after(self, exposures, calls):
        """Has services called at once when so many exposures are answered. calls: service -> argument or nothing"""
        self.wait_for(lambda: len(self.motions) >= exposures, 60.0, f"{exposures} exposures")
        responses = {}
        threads = [threading.Thread(target=lambda s=service, a=arguments: responses.update({s: s(*a)}))
                   for service, arguments in calls.items()]
        for thread in threads:
            thread.start()
        for thread in threads:
            thread.join()
        return responses

    def references(self, name):
        """Reference stamps of a detector's answers, each once, in order."""
        with self.lock:
            stamps = [self.regions[name][stamp].reference_stamp for stamp in sorted(self.regions[name])]
        return [stamp for k, stamp in enumerate(stamps) if k == 0 or stamp != stamps[k - 1]]

    def test_every_exposure(self):
        setup_path = os.path.join(rospkg.RosPack().get_path("xray_tracking_core"), "config", "phantom_neck.yaml")
        with open(setup_path, encoding="utf-8") as file:
            box = yaml.safe_load(file)["target_box_mm"]
        self.wait_for_graph()
        self.start_simulator()
        self.wait_for(lambda: self.regions["detector_a"], 60.0, "a tracked region")
        region = next(iter(self.regions["detector_a"].values())).region
        train = rospy.ServiceProxy("detector_a/train_region", TrainRegion)
        for response in self.after(8, {train: (region,)}).values():
            self.assertEqual(response.status, TrainRegionResponse.OK, response.message)
        resets = [rospy.ServiceProxy(f"{name}/reset", Trigger) for name in DETECTORS]
        for response in self.after(18, {reset: () for reset in resets}).values():
            self.assertTrue(response.success, response.message)
        for response in self.after(28, {rospy.ServiceProxy("detector_b/retrain", Trigger): ()}).values():
            self.assertTrue(response.success, response.message)
        self.wait_for(lambda: len(self.motions) >= EXPOSURES, 60.0, "all exposures")
        self.wait_for(lambda: len(self.poses) >= EXPOSURES, 10.0, "a pose of every exposure")

        self.assertEqual([len(self.references(name)) for name in DETECTORS], [3, 2], "templates")
        for stamp, motion in self.motions.items():
            self.assertEqual(motion.state, PatientMotion.OK, f"{stamp}: {motion.reason}")
        for name in DETECTORS:
            self.assertEqual({answer.state for answer in self.regions[name].values()}, {TrackedRegion.TRACKING})
        errors = self.errors_mm((box["min"], box["max"]))
        print(f"TRE mm: median {np.median(errors[1:]):.3f}, max {errors.max():.3f}")
        # A new reference's place is known as well as a track: two changes add their errors, of about 0.1 mm each.
        # 0.05 and 0.10 in repeated runs.
        self.assertLessEqual(np.median(errors[1:]), 0.08)
        self.assertLessEqual(errors.max(), 0.2)


if __name__ == "__main__":
    rospy.init_node("new_templates_test")
    rostest.rosrun("xray_tracking_bringup", "new_templates", NewTemplatesTest)
