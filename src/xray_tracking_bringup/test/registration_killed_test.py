#!/usr/bin/python3
"""The registration dies: tracking goes on as it was, and refinement goes on when the registration is back."""
import os
import signal
import sys

import rospy
import rostest

sys.path.insert(0, os.path.dirname(os.path.abspath(__file__)))
from graph_test_case import DETECTORS, GraphTestCase  # noqa: E402
from xray_tracking_msgs.msg import PatientMotion  # noqa: E402


class RegistrationKilledTest(GraphTestCase):
    kills = True

    def test_tracking_goes_on(self):
        self.wait_for_graph()
        self.wait_for_subscribers({f"/{name}/image_raw": ["/registration"] for name in DETECTORS})
        self.start_simulator()
        self.wait_for(lambda: self.refinements("accepted") >= 3, 60.0, "refinements")

        os.kill(self.process_of("/registration"), signal.SIGKILL)
        answered, refused = len(self.motions), self.refinements("refused")
        self.wait_for(lambda: self.refinements("refused") > refused, 30.0, "a request that nobody answers")
        accepted = self.refinements("accepted")
        self.wait_for(lambda: len(self.motions) >= answered + 10, 60.0, "answers without the registration")
        self.wait_for(lambda: self.refinements("accepted") >= accepted + 3, 90.0, "refinements by the new one")

        for stamp, motion in sorted(self.motions.items()):
            self.assertEqual(motion.state, PatientMotion.OK, f"{stamp}: {motion.reason}")
        missing = set(self.motions) - set(self.poses)
        self.assertLessEqual(len(missing), 1, "poses but for the exposure that is being answered")


if __name__ == "__main__":
    rospy.init_node("registration_killed_test")
    rostest.rosrun("xray_tracking_bringup", "registration_killed", RegistrationKilledTest)
