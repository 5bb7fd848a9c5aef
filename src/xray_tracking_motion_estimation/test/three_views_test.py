#!/usr/bin/python3
"""Three detectors of which any one may be missing."""

import os
import sys

import numpy as np
import rospy
import rostest
from xray_tracking_msgs.msg import PatientMotion, TrackedRegion

sys.path.insert(0, os.path.dirname(os.path.abspath(__file__)))
from estimation_graph import NANOSECONDS, TIMEOUT, TOLERANCE, EstimationTestCase, motion_at  # noqa: E402


class ThreeViewsTest(EstimationTestCase):
    runs = 0

    def setUp(self):
        ThreeViewsTest.runs += 1
        self.start = (800000 - 1000 * ThreeViewsTest.runs) * NANOSECONDS
        self.begin_anew()

    def expect(self, index, views):
        answer = self.answer(index)
        self.assertEqual(answer.state, PatientMotion.OK, answer.reason)
        self.assertEqual((answer.views, answer.degrees_of_freedom), (views, 2 * views - 3))
        np.testing.assert_allclose([answer.translation.x, answer.translation.y, answer.translation.z],
                                   motion_at(index) / 1000.0, rtol=0, atol=TOLERANCE)

    def test_any_one_lost(self):
        self.expose(self.regions(0), 0)
        self.expect(0, 3)
        for index, missing in enumerate((0, 1, 2), 1):
            regions = self.regions(index)
            regions[missing].state = TrackedRegion.LOST
            self.expose(regions, index)
            self.expect(index, 2)
        self.expose(self.regions(4), 4)
        self.expect(4, 3)

    def test_two_lost(self):
        self.expose(self.regions(0), 0)
        regions = self.regions(1)
        regions[0].state = regions[2].state = TrackedRegion.LOST
        self.assertEqual(self.expose(regions, 1).state, PatientMotion.LOST)

    def test_one_trained_later_or_on_what_nobody_knows(self):
        regions = self.regions(0)
        regions[2].state = TrackedRegion.TRAINING
        self.expose(regions, 0)
        self.expect(0, 2)
        self.expose(self.regions(1)[:2] + self.regions(1, reference=0)[2:], 1)
        self.expect(1, 3)
        regions = self.regions(2)
        regions[1].reference_stamp += rospy.Duration(0, 1)
        self.expose(regions, 2)
        self.expect(2, 2)

    def test_one_silent(self):
        self.expose(self.regions(0), 0)
        for missing in (0, 2):
            present = [i for i in range(3) if i != missing]
            # Sent at 10 Hz until exposures are answered without it.
            first = 1000 * (missing + 1)
            for index in range(first, first + int(TIMEOUT / 0.1)):
                regions = self.regions(index)
                for view in present:
                    self.graph.regions[view].publish(regions[view])
                rospy.sleep(0.1)
                if self.stamp(index) in self.graph.motions:
                    break
            self.expect(index, 2)
            # Back again: waited for as soon as it has been heard.
            for index in range(index + 1, index + 100):
                answer = self.expose(self.regions(index), index)
                self.assertEqual(answer.state, PatientMotion.OK, answer.reason)
                if answer.views == 3:
                    break
            self.expect(index, 3)


if __name__ == '__main__':
    rospy.init_node('three_views_test')
    rostest.rosrun('xray_tracking_motion_estimation', 'three_views', ThreeViewsTest)
