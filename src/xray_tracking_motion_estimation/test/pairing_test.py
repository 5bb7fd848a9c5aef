#!/usr/bin/python3
"""Views that are exposed a few milliseconds apart, put together by a tolerance."""

import os
import sys

import numpy as np
import rospy
import rostest
from xray_tracking_msgs.msg import PatientMotion

sys.path.insert(0, os.path.dirname(os.path.abspath(__file__)))
from estimation_graph import NANOSECONDS, EstimationTestCase, motion_at  # noqa: E402

LATER = 4000000  # ns, within the launch file's tolerance
TARGET_SPEED = 0.015  # m/s, the default


class PairingTest(EstimationTestCase):
    def setUp(self):
        self.start = 800000 * NANOSECONDS
        self.begin_anew()

    def apart(self, index, reference=0, later=LATER):
        """Detector b's stamps, its template's reference included, are later."""
        regions = self.regions(index, reference)
        regions[1].header.stamp += rospy.Duration(0, later)
        regions[1].reference_stamp += rospy.Duration(0, LATER)
        return regions

    def test_pairs_and_admits_to_it(self):
        for index in range(20):
            answer = self.expose(self.apart(index), index)
            self.assertEqual(answer.state, PatientMotion.OK, answer.reason)
            np.testing.assert_allclose([answer.translation.x, answer.translation.y, answer.translation.z],
                                       motion_at(index) / 1000.0, rtol=0, atol=1e-7)
        together = self.expose(self.apart(20, later=0), 20)
        self.assertEqual(together.state, PatientMotion.OK)
        more = np.reshape(answer.covariance, (3, 3)) - np.reshape(together.covariance, (3, 3))
        added = (TARGET_SPEED * 1e-9 * LATER) ** 2
        # What detector b alone sees takes all of it, stretched by views that are 70 degrees apart.
        self.assertLess(np.linalg.eigvalsh(more)[2], 1.05 * added / np.sin(np.radians(70)) ** 2)
        self.assertGreater(np.linalg.eigvalsh(more)[2], 0.9 * added)
        # A template trained on an exposure so put together: known by its own view's stamp.
        answer = self.expose(self.apart(21, reference=10), 21)
        self.assertEqual(answer.state, PatientMotion.OK, answer.reason)
        np.testing.assert_allclose([answer.translation.x, answer.translation.y, answer.translation.z],
                                   motion_at(21) / 1000.0, rtol=0, atol=1e-7)

    def test_too_far_apart(self):
        self.start -= 1000 * NANOSECONDS
        self.begin_anew()
        for index in range(4):
            self.publish(self.apart(index, later=12 * LATER))
        self.expose(self.apart(10, reference=10), 10)
        for index in range(4):
            self.assertNotIn(self.stamp(index), self.graph.motions)


if __name__ == '__main__':
    rospy.init_node('pairing_test')
    rostest.rosrun('xray_tracking_motion_estimation', 'pairing', PairingTest)
