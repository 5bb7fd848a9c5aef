#!/usr/bin/python3
"""Feeds the node with tracks projected by numpy from known motions and judges every exposure's answer."""

import threading
import unittest

import numpy as np
import rospy
import rostest
import yaml
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus
from geometry_msgs.msg import PoseWithCovarianceStamped, Quaternion, TransformStamped, Vector3
from sensor_msgs.msg import CameraInfo
from tf2_msgs.msg import TFMessage
from xray_tracking_msgs.msg import PatientMotion, TrackedRegion

TIMEOUT = 30.0  # s, generous: the answer to an exposure takes less than a millisecond of work
TOLERANCE = 1e-7  # m
NANOSECONDS = 1000000000


def rotation_from_xyzw(q):
    x, y, z, w = q
    return np.array([[1 - 2 * (y * y + z * z), 2 * (x * y - z * w), 2 * (x * z + y * w)],
                     [2 * (x * y + z * w), 1 - 2 * (x * x + z * z), 2 * (y * z - x * w)],
                     [2 * (x * z - y * w), 2 * (y * z + x * w), 1 - 2 * (x * x + y * y)]])


def xyzw_from_rotation(r):
    """The eigenvector of Bar-Itzhack's matrix: needs no case distinction."""
    k = np.array([[r[0, 0] - r[1, 1] - r[2, 2], r[1, 0] + r[0, 1], r[2, 0] + r[0, 2], r[2, 1] - r[1, 2]],
                  [r[1, 0] + r[0, 1], r[1, 1] - r[0, 0] - r[2, 2], r[2, 1] + r[1, 2], r[0, 2] - r[2, 0]],
                  [r[2, 0] + r[0, 2], r[2, 1] + r[1, 2], r[2, 2] - r[0, 0] - r[1, 1], r[1, 0] - r[0, 1]],
                  [r[2, 1] - r[1, 2], r[0, 2] - r[2, 0], r[1, 0] - r[0, 1], np.trace(r)]])
    return np.linalg.eigh(k)[1][:, -1]


class Detector:
    """A detector as formats.md has it; projects by intersecting ray and plane, in mm."""

    def __init__(self, entry):
        self.name = entry['name']
        self.size = entry['image_size']
        self.pitch = np.array(entry['pixel_pitch_mm'])
        self.source = np.array(entry['source_mm'])
        self.origin = np.array(entry['origin_mm'])
        self.x = np.array(entry['x_direction'])
        self.y = np.array(entry['y_direction'])
        self.z = np.cross(self.x, self.y)

    def project(self, point):
        along = self.z.dot(self.origin - self.source) / self.z.dot(point - self.source)
        on_panel = self.source + along * (point - self.source) - self.origin
        return np.array([on_panel.dot(self.x), on_panel.dot(self.y)]) / self.pitch

    def frame(self):
        return self.name + '_optical_frame'

    def camera_info(self):
        distance = self.z.dot(self.origin - self.source)
        fx, fy = distance / self.pitch
        cx, cy = self.project(self.source + self.z)
        info = CameraInfo(width=self.size[0], height=self.size[1], distortion_model='plumb_bob', D=[0.0] * 5)
        info.header.frame_id = self.frame()
        info.K = [fx, 0, cx, 0, fy, cy, 0, 0, 1]
        info.R = [1, 0, 0, 0, 1, 0, 0, 0, 1]
        info.P = [fx, 0, cx, 0, 0, fy, cy, 0, 0, 0, 1, 0]
        return info

    def transform(self):
        message = TransformStamped()
        message.header.frame_id = 'treatment_room'
        message.child_frame_id = self.frame()
        message.transform.translation = Vector3(*(self.source / 1000.0))
        message.transform.rotation = Quaternion(*xyzw_from_rotation(np.column_stack((self.x, self.y, self.z))))
        return message


class Graph:
    """Publishers and subscribers; everything received by stamp [ns]."""

    def __init__(self):
        with open(rospy.get_param('~setup_file'), encoding='utf-8') as file:
            setup = yaml.safe_load(file)
        self.detectors = [Detector(entry) for entry in setup['detectors']]
        self.translation = np.array(setup['initial_pose']['translation_mm'])
        self.quaternion = np.array(setup['initial_pose']['rotation_xyzw'])
        box = setup['target_box_mm']
        self.target = rotation_from_xyzw(self.quaternion).dot(np.add(box['min'], box['max']) / 2) + self.translation

        self.changed = threading.Condition()
        self.motions, self.poses, self.transforms, self.diagnostics = {}, {}, {}, []
        self.subscribers = [rospy.Subscriber('patient_motion', PatientMotion, self.motion_cb),
                            rospy.Subscriber('patient_pose', PoseWithCovarianceStamped, self.pose_cb),
                            rospy.Subscriber('/tf', TFMessage, self.tf_cb),
                            rospy.Subscriber('/diagnostics', DiagnosticArray, self.diagnostics_cb)]
        self.tf_static = rospy.Publisher('/tf_static', TFMessage, queue_size=1, latch=True)
        self.infos = [rospy.Publisher(d.name + '/camera_info', CameraInfo, queue_size=10) for d in self.detectors]
        self.regions = [rospy.Publisher(d.name + '/tracked_region', TrackedRegion, queue_size=100)
                        for d in self.detectors]

    def motion_cb(self, message):
        self.store(self.motions, message.header, message)

    def pose_cb(self, message):
        self.store(self.poses, message.header, message)

    def tf_cb(self, message):
        for transform in message.transforms:
            self.store(self.transforms, transform.header, transform)

    def store(self, where, header, message):
        with self.changed:
            where.setdefault(header.stamp.to_nsec(), []).append(message)
            self.changed.notify_all()

    def diagnostics_cb(self, message):
        with self.changed:
            self.diagnostics += [status for status in message.status if status.name.endswith(': motion')]
            self.changed.notify_all()

    def wait_for(self, condition, what):
        with self.changed:
            if not self.changed.wait_for(condition, TIMEOUT):
                raise AssertionError('no ' + what)

    def connect(self):
        ends = self.subscribers + [self.tf_static] + self.infos + self.regions
        deadline = rospy.get_time() + TIMEOUT
        while not all(end.get_num_connections() > 0 for end in ends):
            if rospy.is_shutdown() or rospy.get_time() > deadline:
                raise AssertionError('not connected: %s' % [e.name for e in ends if e.get_num_connections() == 0])
            rospy.sleep(0.05)

    def region(self, detector, stamp, motion, reference_stamp, reference_motion):
        displacement = detector.project(self.target + motion) - detector.project(self.target + reference_motion)
        message = TrackedRegion(state=TrackedRegion.TRACKING, reference_stamp=rospy.Time(0, reference_stamp))
        message.header.stamp = rospy.Time(0, stamp)
        message.header.frame_id = detector.frame()
        message.displacement_x, message.displacement_y = displacement
        covariance = np.zeros((6, 6))
        covariance[:2, :2] = [[0.01, 0.002], [0.002, 0.02]]
        message.covariance = covariance.ravel().tolist()
        message.cpu_time = rospy.Duration(0.001)
        message.wall_time = rospy.Duration(0.002)
        return message

    def diagnosis(self, condition, what):
        """The first status after now that fulfils the condition."""
        with self.changed:
            self.diagnostics.clear()
        self.wait_for(lambda: any(condition(s) for s in self.diagnostics), 'diagnosis of ' + what)
        with self.changed:
            return next(s for s in self.diagnostics if condition(s))


def value(status, key):
    return next(v.value for v in status.values if v.key == key)


def motion_at(index):
    """Up to 10 mm in every axis, another place at every exposure."""
    return np.array([10 * np.sin(0.3 * index), 8 * np.sin(0.21 * index), -9 * np.sin(0.17 * index)])


class MotionEstimationTest(unittest.TestCase):
    runs = 0

    @classmethod
    def setUpClass(cls):
        graph = cls.graph = Graph()
        graph.connect()
        # Tracks without geometry first, then geometry until it has arrived.
        start = 900000 * NANOSECONDS
        cls.states = []
        for index in range(int(TIMEOUT / 0.1)):
            stamp = start + index * NANOSECONDS
            for detector, publisher in zip(graph.detectors, graph.regions):
                publisher.publish(graph.region(detector, stamp, np.zeros(3), start, np.zeros(3)))
            graph.wait_for(lambda s=stamp: s in graph.motions, 'answer to the exposure at %d' % stamp)
            cls.states.append((graph.motions[stamp][0].state, graph.motions[stamp][0].reason))
            if cls.states[-1][0] == PatientMotion.OK:
                return
            graph.tf_static.publish(TFMessage([d.transform() for d in graph.detectors]))
            for detector, publisher in zip(graph.detectors, graph.infos):
                publisher.publish(detector.camera_info())
            rospy.sleep(0.1)
        raise AssertionError('no estimate: ' + cls.states[-1][1])

    def setUp(self):
        # Every test is a run that begins earlier than the one before: a backward jump of time.
        MotionEstimationTest.runs += 1
        self.start = (800000 - 1000 * MotionEstimationTest.runs) * NANOSECONDS

    def stamp(self, index):
        return self.start + int(index * 0.1 * NANOSECONDS)

    def regions(self, index, reference=0, motion=None):
        """Exact tracks of an exposure, relative to the one with index `reference`."""
        motion = motion_at(index) if motion is None else motion
        return [self.graph.region(d, self.stamp(index), motion, self.stamp(reference), motion_at(reference))
                for d in self.graph.detectors]

    def publish(self, regions):
        for region, publisher in zip(regions, self.graph.regions):
            publisher.publish(region)

    def answer(self, index):
        stamp = self.stamp(index)
        self.graph.wait_for(lambda: stamp in self.graph.motions, 'answer to exposure %d' % index)
        return self.graph.motions[stamp][0]

    def expose(self, regions, index):
        self.publish(regions)
        return self.answer(index)

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
        # A track of half a pixel is worth about 0.15 mm at the target.
        sigma = np.sqrt(np.diag(np.reshape(answer.covariance, (3, 3))))
        self.assertTrue(np.all((sigma > 0.5e-4) & (sigma < 1e-3)), sigma)
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
        first = 900000 * NANOSECONDS
        self.assertNotIn(first, self.graph.poses)
        self.assertNotIn(first, self.graph.transforms)

    def test_every_exposure_has_its_pose(self):
        for index in range(40):
            self.publish(self.regions(index))
        for index in range(40):
            self.expect_pose(index)

    def test_views_that_do_not_track(self):
        self.expose(self.regions(0), 0)
        cases = [(TrackedRegion.LOST, PatientMotion.LOST, 'lost'),
                 (TrackedRegion.UNTRAINED, PatientMotion.WAITING, 'untrained'),
                 (TrackedRegion.TRAINING, PatientMotion.WAITING, 'training'),
                 (77, PatientMotion.LOST, '77')]
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
        for index in (0, 1, 2, 2, 1.5, 1, 3):
            self.publish(self.regions(index))
        for index in (0, 1, 2, 3):
            self.expect_pose(index)
        self.expect_no_pose(1.5, 3)
        self.assertNotIn(self.stamp(1.5), self.graph.motions)

        def dropped(key):
            return lambda status: int(value(status, key)) - int(value(before, key))
        self.graph.diagnosis(lambda s: dropped('duplicates dropped')(s) == 2 and
                             dropped('late messages dropped')(s) == 4, 'drops')

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
