#!/usr/bin/python3
"""What the tests of the node share: tracks projected by numpy from known motions, and what the node makes of them."""

import threading
import time
import unittest

import numpy as np
import rospy
import yaml
from diagnostic_msgs.msg import DiagnosticArray
from geometry_msgs.msg import PoseWithCovarianceStamped, Quaternion, TransformStamped, Vector3
from sensor_msgs.msg import CameraInfo, RegionOfInterest
from tf2_msgs.msg import TFMessage
from std_srvs.srv import Trigger
from xray_tracking_msgs.msg import BeamGate, PatientMotion, TrackedRegion

TIMEOUT = 30.0  # s, generous: the answer to an exposure takes less than a millisecond of work
TOLERANCE = 1e-7  # m
NANOSECONDS = 1000000000


def rotation_from_xyzw(q):
    x, y, z, w = q
    return np.array([[1 - 2 * (y * y + z * z), 2 * (x * y - z * w), 2 * (x * z + y * w)],
                     [2 * (x * y + z * w), 1 - 2 * (x * x + z * z), 2 * (y * z - x * w)],
                     [2 * (x * z - y * w), 2 * (y * z + x * w), 1 - 2 * (x * x + y * y)]])


def rotation_about(axis, angle):
    """Rodrigues' formula; the axis is a unit vector."""
    x, y, z = axis
    k = np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]])
    return np.eye(3) + np.sin(angle) * k + (1 - np.cos(angle)) * k.dot(k)


def xyzw_from_rotation(r):
    """The eigenvector of Bar-Itzhack's matrix: needs no case distinction."""
    k = np.array([[r[0, 0] - r[1, 1] - r[2, 2], r[1, 0] + r[0, 1], r[2, 0] + r[0, 2], r[2, 1] - r[1, 2]],
                  [r[1, 0] + r[0, 1], r[1, 1] - r[0, 0] - r[2, 2], r[2, 1] + r[1, 2], r[0, 2] - r[2, 0]],
                  [r[2, 0] + r[0, 2], r[2, 1] + r[1, 2], r[2, 2] - r[0, 0] - r[1, 1], r[1, 0] - r[0, 1]],
                  [r[2, 1] - r[1, 2], r[0, 2] - r[2, 0], r[1, 0] - r[0, 1], np.trace(r)]])
    return np.linalg.eigh(k)[1][:, -1]


class Detector:
    """A detector as docs/frames.md has it; projects by intersecting ray and plane, in mm."""

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

    def lift(self, pixel, target):
        """The point on the pixel's ray in the plane through `target` that faces the source."""
        on_panel = self.pitch * pixel
        ray = self.origin + on_panel[0] * self.x + on_panel[1] * self.y - self.source
        normal = target - self.source
        return self.source + ray * normal.dot(normal) / normal.dot(ray)

    def warp(self, centre, target, motion):
        """What becomes of a flat region that faces the source when its points are moved by motion(point): the
        displacement of its centre [px] and the linear part, by central differences."""
        def seen(pixel):
            return self.project(motion(self.lift(pixel, target)))
        step = 0.05  # px: rounding and third derivatives both below 1e-8
        linear = np.column_stack([(seen(centre + step * h) - seen(centre - step * h)) / (2 * step)
                                  for h in np.eye(2)])
        return seen(centre) - centre, linear

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
        self.gates, self.predictions = [], []
        self.subscribers = [rospy.Subscriber('patient_motion', PatientMotion, self.motion_cb),
                            rospy.Subscriber('patient_pose', PoseWithCovarianceStamped, self.pose_cb),
                            rospy.Subscriber('predicted_pose', PoseWithCovarianceStamped, self.prediction_cb),
                            rospy.Subscriber('beam_gate', BeamGate, self.gate_cb, queue_size=1000),
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

    def prediction_cb(self, message):
        with self.changed:
            self.predictions.append(message)
            self.changed.notify_all()

    def gate_cb(self, message):
        with self.changed:
            self.gates.append(message)
            self.changed.notify_all()

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

    def wait_for_wall(self, condition, what):
        """As wait_for(), for what no message tells."""
        deadline = time.monotonic() + TIMEOUT
        while not condition():
            if time.monotonic() > deadline:
                raise AssertionError('no ' + what)
            time.sleep(0.01)

    def connect(self):
        ends = self.subscribers + [self.tf_static] + self.infos + self.regions
        deadline = rospy.get_time() + TIMEOUT
        while not all(end.get_num_connections() > 0 for end in ends):
            if rospy.is_shutdown() or rospy.get_time() > deadline:
                raise AssertionError('not connected: %s' % [e.name for e in ends if e.get_num_connections() == 0])
            rospy.sleep(0.05)

    def region(self, detector, stamp, motion, reference_stamp, reference_motion):
        target = self.target + reference_motion
        width, height = 151, 121
        corner = np.round(detector.project(target) - [(width - 1) / 2, (height - 1) / 2]).astype(int)
        centre = corner + [(width - 1) / 2, (height - 1) / 2]
        displacement = detector.project(detector.lift(centre, target) + motion - reference_motion) - centre
        message = TrackedRegion(state=TrackedRegion.TRACKING, reference_stamp=rospy.Time(0, reference_stamp))
        message.header.stamp = rospy.Time(0, stamp)
        message.header.frame_id = detector.frame()
        message.region = RegionOfInterest(x_offset=corner[0], y_offset=corner[1], width=width, height=height)
        message.displacement_x, message.displacement_y = displacement
        message.model, message.linear = TrackedRegion.TRANSLATION, [1, 0, 0, 1]
        covariance = np.zeros((6, 6))
        covariance[:2, :2] = [[0.01, 0.002], [0.002, 0.02]]
        message.covariance = covariance.ravel()
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


class EstimationTestCase(unittest.TestCase):
    """A graph whose node has its geometry; exposures of exact tracks."""

    warm_up = 900000 * NANOSECONDS  # stamp of the first exposure
    template_age = 0  # of the first templates then [ns]

    @classmethod
    def setUpClass(cls):
        graph = cls.graph = Graph()
        graph.connect()
        # Tracks without geometry first, then geometry until it has arrived.
        start = cls.warm_up
        cls.states = []
        for index in range(int(TIMEOUT / 0.1)):
            stamp = start + index * NANOSECONDS
            for detector, publisher in zip(graph.detectors, graph.regions):
                publisher.publish(graph.region(detector, stamp, np.zeros(3), start - cls.template_age, np.zeros(3)))
            graph.wait_for(lambda s=stamp: s in graph.motions, 'answer to the exposure at %d' % stamp)
            cls.states.append((graph.motions[stamp][0].state, graph.motions[stamp][0].reason))
            if cls.states[-1][0] == PatientMotion.OK:
                return
            graph.tf_static.publish(TFMessage([d.transform() for d in graph.detectors]))
            for detector, publisher in zip(graph.detectors, graph.infos):
                publisher.publish(detector.camera_info())
            rospy.sleep(0.1)
        raise AssertionError('no estimate: ' + cls.states[-1][1])

    def begin_anew(self, at_initial_pose=True):
        """Exposures before self.start, all earlier than what was answered, until the node takes them for a new run.
        Then it is told that the patient is at the initial pose, or not."""
        for index in range(int(TIMEOUT / 0.1)):
            stamp = self.start + int((0.1 * index - 2 * TIMEOUT) * NANOSECONDS)
            for detector, publisher in zip(self.graph.detectors, self.graph.regions):
                region = self.graph.region(detector, stamp, np.zeros(3), stamp, np.zeros(3))
                region.state = TrackedRegion.UNTRAINED
                publisher.publish(region)
            rospy.sleep(0.1)
            if stamp in self.graph.motions:
                break
        else:
            raise AssertionError('no new run')
        if at_initial_pose:
            restart = rospy.ServiceProxy('motion_estimation/restart', Trigger)
            restart.wait_for_service(TIMEOUT)
            self.assertTrue(restart().success)

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


class LiveTestCase(EstimationTestCase):
    """Exposures that are stamped when they are made; the templates' reference is an earlier one, without motion."""

    @classmethod
    def setUpClass(cls):
        # Earlier than all that follows: time that goes back would keep the gate closed.
        cls.warm_up = rospy.Time.now().to_nsec() - 1000 * NANOSECONDS
        cls.reference = cls.warm_up - cls.template_age
        super().setUpClass()

    @classmethod
    def send(cls, stamp, motion, alter=lambda regions: None):
        """alter(regions) may damage the tracks before they go."""
        regions = [cls.graph.region(d, stamp, motion, cls.reference, np.zeros(3)) for d in cls.graph.detectors]
        alter(regions)
        for region, publisher in zip(regions, cls.graph.regions):
            publisher.publish(region)

    def live(self, motion, alter=lambda regions: None):
        """Makes an exposure. Returns its answer and what the gate said of it first."""
        graph, stamp = self.graph, rospy.Time.now().to_nsec()
        self.send(stamp, motion, alter)
        graph.wait_for(lambda: stamp in graph.motions and self.gates_of(stamp), 'answer to the exposure at %d' % stamp)
        return graph.motions[stamp][0], self.gates_of(stamp)[0]

    def gates_of(self, stamp):
        # From the end: there are fifty a second.
        return [gate for gate in self.graph.gates[-2000:] if gate.exposure.to_nsec() == stamp]
