#!/usr/bin/python3
"""The beam gate and the prediction, on exposures made while the test runs. Every message of the gate is judged."""

import os
import sys

import numpy as np
import rospy
import rostest
from rosgraph_msgs.msg import Log
from xray_tracking_msgs.msg import BeamGate, PatientMotion, TrackedRegion

sys.path.insert(0, os.path.dirname(os.path.abspath(__file__)))
from estimation_graph import NANOSECONDS, LiveTestCase  # noqa: E402

GOOD_EXPOSURES = 5  # the parameter's default
LATENCY = 0.115  # s, as well
STILL = np.zeros(3)


def lose(regions):
    regions[1].state = TrackedRegion.LOST


class BeamGateTest(LiveTestCase):
    def expose_until_open(self):
        for _ in range(200):
            answer, gate = self.live(STILL)
            self.assertEqual(answer.state, PatientMotion.OK, answer.reason)
            if gate.open:
                return
            rospy.sleep(0.05)
        self.fail('the gate stays closed: %s' % gate)

    def expect_closed(self, gate, reason, words=''):
        self.assertFalse(gate.open)
        self.assertEqual(gate.reason, reason, gate)
        self.assertIn(words, gate.text)

    def tearDown(self):
        with self.graph.changed:
            gates = list(self.graph.gates)
        for gate in gates:
            self.assertEqual(gate.open, gate.reason == BeamGate.NONE)
            self.assertTrue(gate.verified or not gate.open)
            self.assertTrue(gate.text)
            numbers = [gate.displacement.x, gate.displacement.y, gate.displacement.z, gate.rotation]
            self.assertTrue(np.all(np.isfinite(numbers)), gate)
            if gate.open:
                # The watchdog looks every 20 ms; the slack is for what has been judged and not sent yet.
                self.assertLess(gate.age.to_sec(), gate.max_age.to_sec() + 1e-3)
                answers = self.graph.motions.get(gate.exposure.to_nsec())
                self.assertEqual(answers[0].state, PatientMotion.OK)

    def test_closed_at_start(self):
        """What was sent before the first exposure in this process is the watchdog's."""
        first = self.graph.gates[0]
        self.expect_closed(first, BeamGate.NO_EXPOSURE)
        self.assertEqual(first.exposure.to_nsec(), 0)

    def test_opens_after_good_exposures_in_a_row(self):
        self.live(STILL, lambda regions: setattr(regions[0], 'state', TrackedRegion.LOST))
        self.expose_until_open()
        self.live(STILL, lambda regions: setattr(regions[0], 'state', TrackedRegion.LOST))
        for index in range(15):
            rospy.sleep(0.05)
            answer, gate = self.live(STILL)
            self.assertEqual(gate.open, index + 1 >= GOOD_EXPOSURES, gate)
            self.assertAlmostEqual(gate.displacement.x, answer.translation.x, places=12)

    def test_silence_closes_it_and_is_told(self):
        self.expose_until_open()
        with self.graph.changed:
            self.graph.gates.clear()
        # Nothing is sent any more.
        self.graph.wait_for(lambda: sum(g.reason == BeamGate.STALE for g in self.graph.gates) >= 20, 'stale gate')
        with self.graph.changed:
            gates = list(self.graph.gates)
        closed = [g.reason == BeamGate.STALE for g in gates]
        self.assertEqual(closed, sorted(closed), 'stays stale')
        self.assertTrue(all(not g.open for g in gates if g.age > g.max_age))
        # A good exposure alone does not open it.
        self.expect_closed(self.live(STILL)[1], BeamGate.CONFIRMING)

    def test_every_doubt_closes_it(self):
        def disagree(regions):
            regions[0].displacement_x += 3.0

        def degrade(regions):
            regions[0].state = TrackedRegion.DEGRADED

        def blind(regions):
            regions[1].state, regions[1].fault = TrackedRegion.BLIND, 'the image is that of before'

        def none(regions):
            regions[1].displacement_y = float('nan')

        def vague(regions):
            for region in regions:
                region.covariance = 1e4 * np.array(region.covariance)

        for alter, reason, words in ((lose, BeamGate.NOT_MEASURED, 'detector_b has lost'),
                                     (blind, BeamGate.NOT_MEASURED, 'detector_b is blind: the image is that of'),
                                     (disagree, BeamGate.INCONSISTENT, 'disagree'),
                                     (none, BeamGate.NOT_MEASURED, 'detector_b'),
                                     (degrade, BeamGate.UNCERTAIN, 'detector_a is degraded'),
                                     (vague, BeamGate.UNCERTAIN, 'standard deviation')):
            self.expose_until_open()
            rospy.sleep(0.05)
            self.expect_closed(self.live(STILL, alter)[1], reason, words)

    def test_transitions_are_in_the_log(self):
        lines = []
        subscriber = rospy.Subscriber('/rosout', Log, lambda message: lines.append(message.msg), queue_size=1000)
        # Until the node's log is connected, transitions are not heard.
        for _ in range(50):
            self.expose_until_open()
            rospy.sleep(0.05)
            self.live(STILL, lose)
            said = list(lines)
            if any(line.startswith('beam gate: open, ') for line in said) and \
                    any('beam gate: NOT_MEASURED, detector_b has lost' in line for line in said):
                break
        else:
            self.fail('not in the log: %s' % lines)
        subscriber.unregister()

    def test_displacement_closes_it(self):
        self.expose_until_open()
        # Slow enough for a body: less than 60 mm/s however fast the exposures follow.
        for step in range(1, 9):
            rospy.sleep(0.05)
            motion = np.array([0.0, 0.45 * step, 0.0])
            answer, gate = self.live(motion)
            self.assertEqual(answer.state, PatientMotion.OK)
            if step > 6:
                self.expect_closed(gate, BeamGate.DISPLACED)
            else:
                self.assertTrue(gate.open, gate)
            np.testing.assert_allclose([gate.displacement.x, gate.displacement.y, gate.displacement.z],
                                       motion / 1000.0, atol=1e-6)
        for step in range(7, 0, -1):
            rospy.sleep(0.05)
            self.live(np.array([0.0, 0.45 * step, 0.0]))
        rospy.sleep(0.05)

    def test_jump_closes_it_for_long(self):
        self.expose_until_open()
        rospy.sleep(0.02)
        # 2.9 mm at once, which is within the tolerance.
        answer, gate = self.live(np.array([2.9, 0.0, 0.0]))
        self.assertEqual(answer.state, PatientMotion.OK)
        if gate.reason == BeamGate.NONE:
            # More than 2.9 / 60 s passed: a busy machine.
            self.skipTest('exposures came too slowly for a jump')
        self.expect_closed(gate, BeamGate.JUMP)
        for _ in range(29):
            rospy.sleep(0.02)
            self.assertFalse(self.live(np.array([2.9, 0.0, 0.0]))[1].open)
        rospy.sleep(0.1)
        self.live(np.array([1.0, 0.0, 0.0]))

    def test_an_exposure_of_the_future_closes_it_once(self):
        self.expose_until_open()
        rospy.sleep(0.05)
        stamp = rospy.Time.now().to_nsec() + NANOSECONDS
        before = len(self.graph.gates)
        self.send(stamp, STILL)
        self.graph.wait_for(lambda: stamp in self.graph.motions and
                            any(gate.reason == BeamGate.BAD_STAMP for gate in self.graph.gates[before:]), 'gate')
        self.assertEqual(self.graph.motions[stamp][0].state, PatientMotion.BAD_STAMP)
        self.assertTrue(all(gate.exposure.to_nsec() < stamp for gate in self.graph.gates))
        for index in range(10):
            rospy.sleep(0.05)
            answer, gate = self.live(STILL)
            self.assertEqual(answer.state, PatientMotion.OK, answer.reason)
            self.assertEqual(gate.open, index + 1 >= GOOD_EXPOSURES, gate)
        self.assertNotIn(stamp, self.graph.poses)

    def test_an_old_exposure_is_no_time_that_goes_back(self):
        self.expose_until_open()
        for _ in range(30):
            rospy.sleep(0.05)
            self.send(rospy.Time.now().to_nsec() - 2 * NANOSECONDS, STILL)
            answer, gate = self.live(STILL)
            self.assertEqual(answer.state, PatientMotion.OK, answer.reason)
            self.assertTrue(gate.open, gate)

    def test_z_time_that_goes_back_closes_it_for_good(self):
        """The last of the tests: nothing here confirms that the patient is at the initial pose again."""
        self.expose_until_open()
        self.start = rospy.Time.now().to_nsec()
        self.begin_anew(at_initial_pose=False)
        for _ in range(40):
            rospy.sleep(0.05)
            answer, gate = self.live(STILL)
            self.assertEqual(answer.state, PatientMotion.NO_REFERENCE, answer.reason)
            self.assertNotIn(answer.header.stamp.to_nsec(), self.graph.poses)
            self.expect_closed(gate, BeamGate.NOT_MEASURED, 'time went back')

    def test_prediction(self):
        """For the time that is asked for, beside the pose, never on tf, and better than the pose itself."""
        graph = self.graph
        speed = np.array([3.0, -2.0, 2.5])  # mm/s
        self.expose_until_open()
        start = rospy.Time.now()
        noise = np.random.RandomState(1)

        def disturb(regions):
            for region in regions:
                region.displacement_x += 0.1 * noise.randn()
                region.displacement_y += 0.1 * noise.randn()

        sent = 0
        while sent < 80:
            self.live(speed * (rospy.Time.now() - start).to_sec(), disturb)
            sent += 1
            rospy.sleep(0.03)

        def made_here():
            return [p for p in graph.predictions if (p.header.stamp - start).to_sec() > LATENCY]
        graph.wait_for(lambda: len(made_here()) >= sent, 'predictions')
        with graph.changed:
            predictions = made_here()
            stamps = set(graph.transforms)
        self.assertEqual(len(predictions), sent)
        errors = []
        for prediction in predictions[40:]:
            stamp = prediction.header.stamp
            self.assertEqual(prediction.header.frame_id, 'treatment_room')
            self.assertNotIn(stamp.to_nsec(), stamps)
            self.assertGreater((stamp - start).to_sec(), LATENCY)
            position = prediction.pose.pose.position
            truth = graph.translation + speed * (stamp - start).to_sec()
            errors.append(np.linalg.norm(1000.0 * np.array([position.x, position.y, position.z]) - truth))
            self.assertGreater(np.linalg.eigvalsh(np.reshape(prediction.pose.covariance, (6, 6)))[0], 0.0)
        # Holding the pose would be off by the speed times the latency, 0.5 mm.
        hold = np.linalg.norm(speed) * LATENCY
        self.assertLess(np.median(errors), 0.5 * hold)


if __name__ == '__main__':
    rospy.init_node('beam_gate_test')
    rostest.rosrun('xray_tracking_motion_estimation', 'beam_gate', BeamGateTest)
