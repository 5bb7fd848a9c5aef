#!/usr/bin/python3
"""Good tracks alone open no gate: that they began at the initial pose is a claim."""

import os
import sys

import numpy as np
import rospy
import rostest
from xray_tracking_msgs.msg import BeamGate, PatientMotion

sys.path.insert(0, os.path.dirname(os.path.abspath(__file__)))
from estimation_graph import NANOSECONDS, LiveTestCase  # noqa: E402

UNKNOWN_TEMPLATES = 'unknown_templates' in sys.argv
WORDS = 'the first templates were learnt at' if UNKNOWN_TEMPLATES else 'initial_pose_verified is false'


class UnverifiedTest(LiveTestCase):
    template_age = 3600 * NANOSECONDS if UNKNOWN_TEMPLATES else 0

    def test_the_gate_stays_closed(self):
        start, reasons = rospy.Time.now(), []
        for _ in range(60):
            answer, gate = self.live(np.zeros(3))
            self.assertEqual(answer.state, PatientMotion.OK, answer.reason)
            reasons.append(gate.reason)
            self.assertIn(WORDS, gate.text)
            rospy.sleep(0.05)
        self.assertEqual(set(reasons), {BeamGate.UNVERIFIED})
        judged = [gate for gate in self.graph.gates if gate.exposure > start]
        self.assertFalse(any(gate.open or gate.verified for gate in judged))


if __name__ == '__main__':
    rospy.init_node('unverified_test')
    rostest.rosrun('xray_tracking_motion_estimation', 'unverified', UnverifiedTest)
