#!/usr/bin/python3
"""Feeds the node with tracks projected by numpy from known motions and judges every exposure's answer."""

import os
import sys

import numpy as np
import rospy
import rostest
from diagnostic_msgs.msg import DiagnosticStatus
from tf2_msgs.msg import TFMessage
from xray_tracking_msgs.msg import PatientMotion, TrackedRegion

sys.path.insert(0, os.path.dirname(os.path.abspath(__file__)))
from estimation_graph import (NANOSECONDS, TIMEOUT, TOLERANCE, EstimationTestCase, motion_at,  # noqa: E402
                              rotation_about, rotation_from_xyzw, value)


class MotionEstimationTest(EstimationTestCase):
    runs = 0

    def setUp(self):
        # Every test is a run that begins earlier than the one before: recorded exposures without their clock.
        MotionEstimationTest.runs += 1
        self.start = (800000 - 1000 * MotionEstimationTest.runs) * NANOSECONDS
        self.begin_anew()

    def expect_pose(self, index, motion=None):
        """One answer, one pose, one transform: that of the exposure's true motion."""
        graph, stamp = self.graph, self.stamp(index)
        motion = motion_at(index) if motion is None else motion
        answer = self.answer(index)
        self.assertEqual(answer.state, PatientMotion.OK, answer.reason)
        self.assertEqual(answer.reason, '')
        graph.wait_for(lambda: stamp in graph.poses and stamp in graph.transforms, 'pose of exposure %d' % index)
        pose, transform = graph.poses[stamp][0], graph.transforms[stamp][0]
        self.assertEqual((pose.header.frame_id, answer.header.frame_id), ('treatment_room', 'treatment_room'))
        self.assertEqual((transform.header.frame_id, transform.child_frame_id), ('treatment_room', 'patient'))
        expected = (graph.translation + motion) / 1000.0
        position, moved = pose.pose.pose.position, transform.transform.translation
        np.testing.assert_allclose([position.x, position.y, position.z], expected, rtol=0, atol=TOLERANCE)
        np.testing.assert_allclose([moved.x, moved.y, moved.z], expected, rtol=0, atol=TOLERANCE)
        np.testing.assert_allclose([answer.translation.x, answer.translation.y, answer.translation.z],
                                   motion / 1000.0, rtol=0, atol=TOLERANCE)
        for q in (pose.pose.pose.orientation, transform.transform.rotation):
            self.assertAlmostEqual(abs(np.dot([q.x, q.y, q.z, q.w], graph.quaternion)), 1.0, places=12)
        covariance = np.reshape(pose.pose.covariance, (6, 6))
        np.testing.assert_allclose(covariance, covariance.T)
        self.assertGreater(np.linalg.eigvalsh(covariance)[0], 0.0)
        # A track of half a pixel is worth about 0.15 mm at the target; tissue may make 1 mm.
        variance = np.diag(np.reshape(answer.covariance, (3, 3))) - 1e-6
        self.assertTrue(np.all((variance > 0.5e-4 ** 2) & (variance < 1e-6)), variance)
        self.assertLess(answer.disagreement, 1e-3)
        self.assertEqual((answer.views, answer.degrees_of_freedom), (2, 1))
        self.assertGreater(answer.cpu_time.to_sec(), 0.002)
        self.assertGreater(answer.wall_time.to_sec(), 0.002)

    def expect_no_pose(self, index, last_index):
        """Whatever is published for an exposure is out once a later one's pose has arrived on the same connection."""
        self.expect_pose(last_index)
        self.assertNotIn(self.stamp(index), self.graph.poses)
        self.assertNotIn(self.stamp(index), self.graph.transforms)

    def tearDown(self):
        for received in (self.graph.motions, self.graph.poses, self.graph.transforms):
            self.assertFalse([s for s, messages in received.items() if len(messages) > 1], 'stamps used twice')
        for message in [m for messages in self.graph.motions.values() for m in messages]:
            numbers = [message.translation.x, message.translation.y, message.translation.z, message.disagreement,
                       message.chi_square, *message.covariance]
            self.assertTrue(np.all(np.isfinite(numbers)), numbers)

    def test_without_geometry_nothing_is_estimated(self):
        state, reason = self.states[0]
        self.assertEqual(state, PatientMotion.WAITING)
        self.assertIn('detector_a/camera_info', reason)
        first = self.warm_up
        self.assertNotIn(first, self.graph.poses)
        self.assertNotIn(first, self.graph.transforms)

    def test_every_exposure_has_its_pose(self):
        for index in range(40):
            self.publish(self.regions(index))
            if index >= 10:  # half of the node's queue_size
                self.answer(index - 10)
        for index in range(40):
            self.expect_pose(index)

    def test_views_that_do_not_track(self):
        self.expose(self.regions(0), 0)
        cases = [(TrackedRegion.LOST, PatientMotion.LOST, 'lost'),
                 (TrackedRegion.UNTRAINED, PatientMotion.WAITING, 'untrained'),
                 (TrackedRegion.TRAINING, PatientMotion.WAITING, 'training'),
                 (77, PatientMotion.LOST, 'state 77')]
        for index, (track_state, state, word) in enumerate(cases, 1):
            regions = self.regions(index)
            regions[1].state = track_state
            answer = self.expose(regions, index)
            self.assertEqual(answer.state, state)
            self.assertIn('detector_b', answer.reason)
            self.assertIn(word, answer.reason)
        last = len(cases) + 1
        self.expose(self.regions(last), last)
        for index in range(1, last):
            self.expect_no_pose(index, last)

    def test_views_that_disagree(self):
        self.expose(self.regions(0), 0)
        regions = self.regions(1)
        regions[0].displacement_x += 3.0
        answer = self.expose(regions, 1)
        self.assertEqual(answer.state, PatientMotion.INCONSISTENT)
        self.assertGreater(answer.disagreement, 1.0)
        self.assertGreater(answer.chi_square, 10.8)
        self.expose(self.regions(2), 2)
        self.expect_no_pose(1, 2)

    def test_views_that_differ_a_little(self):
        """What tissue may do is let pass and told: 0.7 px between the views, in three exposures."""
        for index in range(3):
            self.assertFalse(self.expose(self.regions(index), index).views_differ)
        for index in range(3, 6):
            regions = self.regions(index)
            regions[0].displacement_x += 0.7
            answer = self.expose(regions, index)
            self.assertEqual(answer.state, PatientMotion.OK, answer.reason)
        self.assertTrue(answer.views_differ)
        status = self.graph.diagnosis(lambda s: 'differ' in s.message, 'views that differ')
        self.assertEqual(status.level, DiagnosticStatus.WARN)
        for index in range(6, 9):
            answer = self.expose(self.regions(index), index)
        self.assertFalse(answer.views_differ)

    def test_rotation(self):
        """Euclidean tracks of a rotation about detector a's ray: what both views see of it, and what none sees."""
        graph = self.graph
        self.expose(self.regions(0), 0)
        first, second = [(graph.target - d.source) / np.linalg.norm(graph.target - d.source) for d in graph.detectors]
        angle = np.radians(2.0)
        turn = rotation_about(first, angle)
        shift = np.array([2.0, -1.0, 1.5])
        regions = self.regions(1)
        for region, detector in zip(regions, graph.detectors):
            roi = region.region
            centre = np.array([roi.x_offset + (roi.width - 1) / 2, roi.y_offset + (roi.height - 1) / 2])
            displacement, linear = detector.warp(
                centre, graph.target, lambda point: turn.dot(point - graph.target) + graph.target + shift)
            u, _, v = np.linalg.svd(linear)
            region.model, region.linear = TrackedRegion.EUCLIDEAN, u.dot(v).ravel()
            region.displacement_x, region.displacement_y = displacement
            tangent = np.array([0, 0, -u.dot(v)[1, 0], -u.dot(v)[0, 0], u.dot(v)[0, 0], -u.dot(v)[1, 0]])
            covariance = np.reshape(region.covariance, (6, 6)) + 1e-6 * np.outer(tangent, tangent)
            region.covariance = covariance.ravel()
        answer = self.expose(regions, 1)
        self.assertEqual(answer.state, PatientMotion.OK, answer.reason)
        self.assertEqual(answer.degrees_of_freedom, 3)
        stamp = self.stamp(1)
        graph.wait_for(lambda: stamp in graph.poses, 'pose')
        pose = graph.poses[stamp][0].pose
        q = pose.pose.orientation
        rotation = rotation_from_xyzw([q.x, q.y, q.z, q.w]).dot(rotation_from_xyzw(graph.quaternion).T)
        # The prior of 2 degrees takes a hundredth of it at the tracks' 0.2 degrees; twice for two views 70 degrees apart.
        error = rotation.dot(turn.T)
        vector = np.array([error[2, 1] - error[1, 2], error[0, 2] - error[2, 0], error[1, 0] - error[0, 1]]) / 2
        self.assertLess(np.linalg.norm(vector), 0.03 * angle)
        np.testing.assert_allclose([answer.translation.x, answer.translation.y, answer.translation.z], shift / 1000.0,
                                   rtol=0, atol=2e-5)
        covariance = np.reshape(pose.covariance, (6, 6))[3:, 3:]
        unseen = np.cross(first, second) / np.linalg.norm(np.cross(first, second))
        self.assertAlmostEqual(np.sqrt(unseen.dot(covariance).dot(unseen)), 0.0349, places=3)
        # What the tracks measure of it, and what a millimetre of tissue (tissue_sigma) feigns: a degree.
        self.assertLess(np.sqrt(first.dot(covariance).dot(first)), np.hypot(0.2 * 0.0349, np.radians(1.0)))

    def test_model_that_is_none(self):
        self.expose(self.regions(0), 0)
        regions = self.regions(1)
        regions[0].model = 5
        answer = self.expose(regions, 1)
        self.assertEqual(answer.state, PatientMotion.LOST)
        self.assertIn('model 5', answer.reason)

    def test_numbers_that_are_none(self):
        self.expose(self.regions(0), 0)
        regions = self.regions(1)
        regions[1].displacement_y = float('nan')
        answer = self.expose(regions, 1)
        self.assertEqual(answer.state, PatientMotion.LOST)
        self.assertIn('detector_b: displacement', answer.reason)
        regions = self.regions(2)
        regions[0].covariance = [float('nan')] * 36
        answer = self.expose(regions, 2)
        self.assertEqual(answer.state, PatientMotion.LOST)
        self.assertIn('detector_a: covariance', answer.reason)
        # Times that add up to more than a duration holds.
        regions = self.regions(3)
        for region in regions:
            region.cpu_time = rospy.Duration(2 ** 31 - 1)
        self.expose(regions, 3)
        for index in (1, 2):
            self.expect_no_pose(index, 3)

    def start_without(self, region_state, fault, state, words):
        for index in range(3):
            regions = self.regions(index)
            for region in regions:
                region.state, region.fault = region_state, fault
            answer = self.expose(regions, index)
            self.assertEqual(answer.state, state)
            self.assertIn(words, answer.reason)
        return self.expose(self.regions(5, reference=3), 5)

    def test_blind_first_exposures_put_the_initial_pose_in_doubt(self):
        self.expect_doubt(self.start_without(TrackedRegion.BLIND, 'the image shows nothing', PatientMotion.LOST,
                                             'is blind: the image shows nothing'))

    def test_refused_templates_put_the_initial_pose_in_doubt(self):
        self.expect_doubt(self.start_without(TrackedRegion.UNTRAINED, 'region: has too little contrast',
                                             PatientMotion.WAITING, 'is untrained: region: has too little contrast'))

    def test_waiting_for_a_region_is_no_doubt(self):
        answer = self.start_without(TrackedRegion.UNTRAINED, '', PatientMotion.WAITING, 'is untrained')
        self.assertEqual(answer.state, PatientMotion.OK, answer.reason)
        for axis in (0, 4, 8):
            self.assertLess(answer.covariance[axis], 0.003 ** 2)

    def expect_doubt(self, answer):
        self.assertEqual(answer.state, PatientMotion.OK, answer.reason)
        # Seen first after 0.3 s, in which it may have moved by 15 mm/s along any axis.
        for axis in (0, 4, 8):
            self.assertGreater(answer.covariance[axis], 0.0045 ** 2)
            self.assertLess(answer.covariance[axis], 0.0055 ** 2)

    def test_templates_trained_later(self):
        for index in range(5):
            self.expose(self.regions(index), index)
        # Both on an exposure whose pose was measured, then one of them on yet another.
        self.expose(self.regions(5, reference=3), 5)
        mixed = [self.regions(6, reference=3)[0], self.regions(6, reference=5)[1]]
        self.expose(mixed, 6)
        unknown = self.regions(7)
        unknown[1].reference_stamp += rospy.Duration(0, 1)
        answer = self.expose(unknown, 7)
        self.assertEqual(answer.state, PatientMotion.NO_REFERENCE)
        self.assertIn('detector_b', answer.reason)
        self.expose(self.regions(8, reference=6), 8)
        for index in (0, 1, 2, 3, 4, 5, 6, 8):
            self.expect_pose(index)
        self.expect_no_pose(7, 8)

    def test_duplicates_and_late_exposures(self):
        before = self.graph.diagnosis(lambda s: True, 'drops')
        for index in (0, 1, 2):
            self.publish(self.regions(index))
        for index in (0, 1, 2):
            self.expect_pose(index)
        for index in (2, 1.5, 1, 3):
            self.publish(self.regions(index))
        self.expect_pose(3)
        self.expect_no_pose(1.5, 3)
        self.assertNotIn(self.stamp(1.5), self.graph.motions)

        def dropped(key):
            return lambda status: int(value(status, key)) - int(value(before, key))
        self.graph.diagnosis(lambda s: dropped('duplicates dropped')(s) == 2 and
                             dropped('late messages dropped')(s) == 4, 'drops')

    def test_old_exposures_once_more(self):
        """In all views and more than a second late: nothing starts over, and no stamp is on tf twice."""
        for index in range(40):
            self.expose(self.regions(index), index)
        before = self.graph.diagnosis(lambda s: True, 'late messages')
        for index in range(40, 60):
            # Templates of the first run's reference tell whether the node has forgotten it.
            self.expose(self.regions(index, reference=3), index)
            for old in (2, 3, 4, index - 30):
                self.publish(self.regions(old))
            rospy.sleep(0.1)
        for index in range(60):
            self.expect_pose(index)
        self.graph.diagnosis(lambda s: int(value(s, 'late messages dropped')) -
                             int(value(before, 'late messages dropped')) == 160, 'late messages')

    def test_exposures_of_the_future(self):
        """Refused and counted, without a pose; what is stamped right goes on."""
        key = 'exposures refused, stamped in the future'
        before = self.graph.diagnosis(lambda s: True, key)
        self.expose(self.regions(0), 0)
        futures = [rospy.Time.now().to_nsec() + ahead * NANOSECONDS for ahead in (1, 3600)]
        for index, stamp in enumerate(futures, 1):
            regions = self.regions(index)
            for region in regions:
                region.header.stamp = rospy.Time(0, stamp)
            self.publish(regions)
            self.graph.wait_for(lambda s=stamp: s in self.graph.motions, 'answer')
            answer = self.graph.motions[stamp][0]
            self.assertEqual(answer.state, PatientMotion.BAD_STAMP)
            self.assertIn('in the future', answer.reason)
            status = self.graph.diagnosis(lambda s: 'BAD_STAMP' in s.message, 'bad stamp')
            self.assertEqual(status.level, DiagnosticStatus.ERROR)
            self.expose(self.regions(index), index)
            self.expect_pose(index)
        for stamp in futures:
            self.assertNotIn(stamp, self.graph.poses)
            self.assertNotIn(stamp, self.graph.transforms)
        self.graph.diagnosis(lambda s: int(value(s, key)) - int(value(before, key)) == 2, key)

    def test_one_detector_silent(self):
        before = self.graph.diagnosis(lambda s: True, 'drops')
        self.expose(self.regions(0), 0)
        silent = []
        with self.graph.changed:
            self.graph.diagnostics.clear()
        deadline = rospy.get_time() + TIMEOUT
        while not silent and rospy.get_time() < deadline:
            index = index + 1 if 'index' in locals() else 1
            self.graph.regions[0].publish(self.regions(index)[0])
            rospy.sleep(0.1)
            with self.graph.changed:
                silent = [s for s in self.graph.diagnostics if 'detector_b is silent' in s.message]
        self.assertTrue(silent, 'no diagnosis of a silent detector')
        self.assertGreaterEqual(silent[0].level, DiagnosticStatus.WARN)
        last = index + 1
        self.expose(self.regions(last), last)
        for missing in range(1, last):
            self.expect_no_pose(missing, last)
            self.assertNotIn(self.stamp(missing), self.graph.motions)
        key = 'exposures dropped, a view missing'
        self.graph.diagnosis(lambda s: int(value(s, key)) - int(value(before, key)) == last - 1, 'drops')

    def test_camera_info_that_changes(self):
        """No pose with a geometry that may not be the detector's, and poses again when the first one is back."""
        self.expose(self.regions(0), 0)
        damages = [('K[0]', 'K', [0.0] * 9), ('K[2]', 'K', None), ('width', 'width', 100)]
        for index, (name, field, damaged) in enumerate(damages, 1):
            info = self.graph.detectors[1].camera_info()
            if damaged is None:
                damaged = list(info.K)
                damaged[2] = float('nan')
            setattr(info, field, damaged)
            self.graph.infos[1].publish(info)
            status = self.graph.diagnosis(lambda s, n=name: n in s.message, name)
            self.assertEqual(status.level, DiagnosticStatus.ERROR)
            self.assertIn('detector_b', status.message)
            answer = self.expose(self.regions(index), index)
            self.assertEqual(answer.state, PatientMotion.WAITING)
            self.assertIn('detector_b', answer.reason)
            self.assertIn(name, answer.reason)
        self.graph.infos[1].publish(self.graph.detectors[1].camera_info())
        self.graph.diagnosis(lambda s: s.level != DiagnosticStatus.ERROR, 'recovery')
        last = len(damages) + 1
        self.expose(self.regions(last), last)
        for index in range(1, last):
            self.expect_no_pose(index, last)

    def test_detector_that_moves_on_tf(self):
        graph = self.graph
        self.expose(self.regions(0), 0)
        moved = [d.transform() for d in graph.detectors]
        moved[1].transform.translation.y += 1e-3
        index = 0
        for transforms, state in ((moved, PatientMotion.WAITING),
                                  ([d.transform() for d in graph.detectors], PatientMotion.OK)):
            graph.tf_static.publish(TFMessage(transforms))
            deadline = rospy.get_time() + TIMEOUT
            while True:
                index += 1
                answer = self.expose(self.regions(index), index)
                if answer.state == PatientMotion.OK:
                    self.expect_pose(index)
                if answer.state == state:
                    break
                self.assertLess(rospy.get_time(), deadline, answer)
                rospy.sleep(0.02)
            if state == PatientMotion.WAITING:
                self.assertIn('detector_b_optical_frame has moved', answer.reason)
                waiting = index
        self.expect_no_pose(waiting, index)


if __name__ == '__main__':
    rospy.init_node('motion_estimation_test')
    rostest.rosrun('xray_tracking_motion_estimation', 'motion_estimation', MotionEstimationTest)
