#!/usr/bin/python3
"""No open gate on a pose that the registration, here a stand-in, has not confirmed or has not for long."""

import os
import sys

import numpy as np
import rospy
import rostest
from xray_tracking_msgs.msg import BeamGate, PatientMotion, RefinementResult

sys.path.insert(0, os.path.dirname(os.path.abspath(__file__)))
from estimation_graph import LiveTestCase  # noqa: E402
from stand_in import StandIn  # noqa: E402

MAX_UNVERIFIED = 1.0  # s, as in verification.test
STILL = np.zeros(3)


def doubted(result):
    result.status, result.reason = RefinementResult.UNRELIABLE, 'the probability is 0.4'


def elsewhere(result):
    result.pose.pose.position.x += 0.02


class VerificationTest(LiveTestCase):
    @classmethod
    def setUpClass(cls):
        super().setUpClass()
        cls.stand_in = StandIn(cls.graph)

    def expose(self):
        rospy.sleep(0.05)
        answer, gate = self.live(STILL)
        self.assertEqual(answer.state, PatientMotion.OK, answer.reason)
        return gate

    def expose_until(self, condition, what):
        for _ in range(400):
            gate = self.expose()
            if condition(gate):
                return gate
        self.fail('not %s: %s' % (what, gate))

    def expect_unverified(self, number, *words):
        for _ in range(number):
            gate = self.expose()
            self.assertEqual(gate.reason, BeamGate.UNVERIFIED, gate)
            self.assertFalse(gate.verified)
        for word in words:
            self.assertIn(word, gate.text)

    def test_1_closed_until_the_registration_confirms_the_pose(self):
        self.expect_unverified(20, 'no registration has confirmed the initial pose', 'there is no service')
        self.stand_in.alter = doubted
        self.stand_in.start()
        # Requests follow each other at once, so that the last of many is the stand-in's.
        self.expect_unverified(40, 'no registration has confirmed the initial pose', 'the probability is 0.4')
        self.stand_in.alter = lambda result: None
        self.expose_until(lambda gate: gate.open, 'open')
        self.assertTrue(self.stand_in.requests[0].unverified)

    def test_2_stays_open_as_it_is_asked_in_time(self):
        self.expose_until(lambda gate: gate.open, 'open')
        asked = len(self.stand_in.requests)
        start = rospy.Time.now()
        number = 0
        while (rospy.Time.now() - start).to_sec() < 4 * MAX_UNVERIFIED:
            gate = self.expose()
            self.assertTrue(gate.open, gate)
            number += 1
        asked = len(self.stand_in.requests) - asked
        # Once half of the time is over, not at every exposure.
        self.assertGreaterEqual(asked, 4)
        self.assertLess(asked, number / 3)
        self.assertFalse(self.stand_in.requests[-1].unverified)

    def test_3_closes_once_it_has_been_doubted_for_long(self):
        self.expose_until(lambda gate: gate.open, 'open')
        self.stand_in.alter = doubted
        start = rospy.Time.now()
        gate = self.expose_until(lambda gate: not gate.open, 'closed')
        self.assertEqual(gate.reason, BeamGate.UNVERIFIED, gate)
        # It had been confirmed up to half of the bound before, and an exposure takes 50 ms on an idle machine.
        elapsed = (rospy.Time.now() - start).to_sec()
        self.assertGreater(elapsed, 0.3 * MAX_UNVERIFIED)
        self.assertLess(elapsed, 2 * MAX_UNVERIFIED)
        self.expect_unverified(20, 'no registration has confirmed the tracks since the exposure at', 'expected at most',
                               'the probability is 0.4')
        self.stand_in.alter = lambda result: None
        self.expose_until(lambda gate: gate.open, 'open')

    def test_4_closes_as_soon_as_a_believed_pose_contradicts_the_tracks(self):
        self.expose_until(lambda gate: gate.open, 'open')
        asked = len(self.stand_in.requests)
        self.stand_in.alter = elsewhere
        gate = self.expose_until(lambda gate: not gate.open, 'closed')
        self.assertEqual(gate.reason, BeamGate.UNVERIFIED, gate)
        self.assertLessEqual(len(self.stand_in.requests), asked + 2)
        self.expect_unverified(20, 'contradict each other', 'the correction is 20')
        self.stand_in.alter = lambda result: None
        self.expose_until(lambda gate: gate.open, 'open')


if __name__ == '__main__':
    rospy.init_node('verification_test')
    rostest.rosrun('xray_tracking_motion_estimation', 'verification', VerificationTest)
