"""Exposures in closed form, and who sends them to a tracker and judges its answers."""

import math
import queue
import threading
import unittest

import numpy
import rospy
from diagnostic_msgs.msg import DiagnosticArray
from sensor_msgs.msg import Image, RegionOfInterest
from xray_tracking_msgs.msg import TrackedRegion

WIDTH, HEIGHT = 240, 200
REGION = RegionOfInterest(x_offset=70, y_offset=55, width=100, height=90)
# Busy machines: nothing is waited for that long unless it fails.
PATIENCE = 60.0
# No tracker can be better than 0.05 px with 600 points and 1 % noise an image (Cramer-Rao bound); five times that.
TOLERANCE = 0.25


def exposure(dx=0.0, dy=0.0, encoding="mono16", width=WIDTH, height=HEIGHT, seed=0, cover=None):
    """Detector counts behind a sum of Gaussians that has moved by (dx, dy) pixels, with 1 % noise.
    cover: rows and columns (slices) that something lies over."""
    random = numpy.random.RandomState(3)
    x = numpy.arange(width)[None, :] - dx
    y = numpy.arange(height)[:, None] - dy
    attenuation = 0.01 * numpy.random.RandomState(seed).standard_normal((height, width))
    for _ in range(250):
        cx, cy, sigma, amplitude = random.uniform([0, 0, 2.5, -0.3], [width, height, 7, 0.3])
        attenuation = attenuation + amplitude * (numpy.exp(-((x - cx) ** 2) / (2 * sigma ** 2)) *
                                                 numpy.exp(-((y - cy) ** 2) / (2 * sigma ** 2)))
    if cover:
        attenuation[cover] += 1.5
    counts = numpy.exp(-attenuation) * {"mono16": 20000, "mono8": 90, "rgb8": 90}[encoding]
    pixels = counts.round().astype("<u2" if encoding == "mono16" else "u1")
    if encoding == "rgb8":
        pixels = numpy.repeat(pixels, 3, axis=1)
    image = Image(height=height, width=width, encoding=encoding, is_bigendian=0, step=pixels.nbytes // height)
    image.header.frame_id = "some_optical_frame"
    image.data = pixels.tobytes()
    return image


def black(seed):
    """X-rays are off: the detector's own noise."""
    image = exposure()
    counts = numpy.random.RandomState(seed).normal(20.0, 3.0, (HEIGHT, WIDTH))
    image.data = counts.clip(0.0).round().astype("<u2").tobytes()
    return image


def turned():
    """An exposure without the region: upside down."""
    image = exposure()
    image.data = numpy.frombuffer(image.data, "<u2")[::-1].tobytes()
    return image


def equals(a, b):
    return (a.x_offset, a.y_offset, a.width, a.height) == (b.x_offset, b.y_offset, b.width, b.height)


class Detector:
    """Sends exposures to one tracker and collects its answers; ready once both ends are connected."""

    sent = 0

    def __init__(self, name):
        self.name = name
        self.answers = queue.Queue()
        self.subscriber = rospy.Subscriber(name + "/tracked_region", TrackedRegion, self.answers.put, queue_size=100)
        self.publisher = rospy.Publisher(name + "/image_raw", Image, queue_size=100)
        deadline = rospy.get_time() + PATIENCE
        while self.publisher.get_num_connections() == 0 or self.subscriber.get_num_connections() == 0:
            if rospy.get_time() > deadline:
                raise RuntimeError("no tracker in " + name)
            rospy.sleep(0.01)

    def send(self, stamp, image, repeat=False):
        """@param repeat: as it is; else with last bits of its pixels changed, as a detector's noise would"""
        image.header.stamp = rospy.Time.from_sec(stamp)
        if not repeat:
            Detector.sent += 1
            pixels = numpy.frombuffer(image.data, numpy.uint8).copy()
            bits = numpy.random.RandomState(Detector.sent).randint(0, 2, pixels[::4].size, numpy.uint8)
            pixels[::4] = pixels[::4] & 0xFE | bits
            image.data = pixels.tobytes()
        self.publisher.publish(image)

    def answer(self):
        return self.answers.get(timeout=PATIENCE)

    def close(self):
        self.publisher.unregister()
        self.subscriber.unregister()


class TrackerTestCase(unittest.TestCase):
    next_stamp = 1e6

    @classmethod
    def setUpClass(cls):
        cls.diagnoses = []
        cls.changed = threading.Condition()
        cls.diagnostics = rospy.Subscriber("/diagnostics", DiagnosticArray, cls.keep, queue_size=100)
        cls.truth = [(5.5 * math.sin(0.7 * k), 0.9 * k - 3.3 * (k % 4)) for k in range(20)]

    @classmethod
    def keep(cls, message):
        with cls.changed:
            cls.diagnoses.extend(message.status)
            cls.changed.notify_all()

    def expect_diagnosis(self, detector, *parts):
        """Waits for a diagnosis from now on of the detector's tracker that holds all parts."""
        with self.changed:
            self.diagnoses.clear()
            found = self.changed.wait_for(
                lambda: any(detector + "/" in status.name and all(part in status.message for part in parts)
                            for status in self.diagnoses), PATIENCE)
            self.assertTrue(found, "no diagnosis of %s with %s" % (detector, parts))

    def expect_value(self, detector, key, value):
        """Waits for a diagnosis from now on of the detector's tracker in which the key has this value."""
        with self.changed:
            self.diagnoses.clear()
            seen = lambda: [item.value for status in self.diagnoses if detector + "/" in status.name
                            for item in status.values if item.key == key]
            self.assertTrue(self.changed.wait_for(lambda: value in seen(), PATIENCE),
                            "%s of %s: %s, expected %s" % (key, detector, seen(), value))

    def connect(self, name):
        detector = Detector(name)
        self.addCleanup(detector.close)
        return detector

    def stamp(self):
        TrackerTestCase.next_stamp += 0.125
        return self.next_stamp

    def judge(self, answer, stamp, reference, displacement, tolerance=TOLERANCE, correlation=0.9, quality=0.8,
              state=TrackedRegion.TRACKING):
        self.assertEqual(answer.header.stamp, rospy.Time.from_sec(stamp))
        self.assertEqual(answer.header.frame_id, "some_optical_frame")
        self.assertEqual(answer.state, state)
        self.assertEqual(answer.reference_stamp, rospy.Time.from_sec(reference))
        self.assertTrue(equals(answer.region, REGION))
        self.assertAlmostEqual(answer.displacement_x, displacement[0], delta=tolerance)
        self.assertAlmostEqual(answer.displacement_y, displacement[1], delta=tolerance)
        self.assertGreater(answer.correlation, correlation)
        self.assertGreater(answer.quality, quality)
        self.assertGreaterEqual(answer.iterations, 1)
        self.assertEqual((answer.model, answer.linear), (TrackedRegion.TRANSLATION, (1.0, 0.0, 0.0, 1.0)))
        xx, xy, yx, yy = (answer.covariance[i] for i in (0, 1, 6, 7))
        self.assertFalse(any(answer.covariance[12:]))
        self.assertEqual(xy, yx)
        self.assertGreater(xx * yy - xy * yx, 0.0)
        self.assertLess(math.sqrt(xx + yy), tolerance)
        self.assertGreater(answer.cpu_time.to_sec(), 0.0)
        self.assertGreater(answer.wall_time.to_sec(), 0.0)

    def assert_untrained(self, answer, stamp):
        self.assertEqual(answer.header.stamp, rospy.Time.from_sec(stamp))
        self.assertEqual(answer.state, TrackedRegion.UNTRAINED)
        self.assertEqual((answer.displacement_x, answer.displacement_y), (0.0, 0.0))

    def restart(self, detector):
        """Jumps back in time, so that the tracker trains anew. @return the reference stamp"""
        TrackerTestCase.next_stamp -= 500.0
        reference = self.stamp()
        detector.send(reference, exposure())
        answer = detector.answer()
        self.judge(answer, reference, reference, (0.0, 0.0))
        self.assertEqual((answer.displacement_x, answer.displacement_y), (0.0, 0.0))
        return reference

    def call(self, service, *arguments):
        """A service call in the background. @return a queue that its response will be in"""
        responses = queue.Queue()
        threading.Thread(target=lambda: responses.put(service(*arguments)), daemon=True).start()
        return responses

    def call_among_exposures(self, detector, make, service, *arguments):
        """Sends exposures until the call is answered. @return the response, the exposures' answers"""
        responses = self.call(service, *arguments)
        answers = []
        while responses.empty():
            detector.send(self.stamp(), make())
            answers.append(detector.answer())
            rospy.sleep(0.05)
        return responses.get(), answers
