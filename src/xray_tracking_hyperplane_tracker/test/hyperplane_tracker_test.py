#!/usr/bin/python3
"""The tracker's topics and service, every exposure judged. Exposures are made here, in closed form."""

import math
import queue
import threading
import unittest

import numpy
import rospy
import rostest
from diagnostic_msgs.msg import DiagnosticArray
from sensor_msgs.msg import Image, RegionOfInterest
from xray_tracking_msgs.msg import TrackedRegion
from xray_tracking_msgs.srv import TrainRegion, TrainRegionResponse

WIDTH, HEIGHT = 240, 200
REGION = RegionOfInterest(x_offset=70, y_offset=55, width=100, height=90)
# Busy machines: nothing is waited for that long unless it fails.
PATIENCE = 60.0
# No tracker can be better than 0.05 px with 600 points and 1 % noise an image (Cramer-Rao bound); five times that.
TOLERANCE = 0.25


def exposure(dx=0.0, dy=0.0, encoding="mono16", width=WIDTH, height=HEIGHT, seed=0):
    """Detector counts behind a sum of Gaussians that has moved by (dx, dy) pixels, with 1 % noise."""
    random = numpy.random.RandomState(3)
    x = numpy.arange(width)[None, :] - dx
    y = numpy.arange(height)[:, None] - dy
    attenuation = 0.01 * numpy.random.RandomState(seed).standard_normal((height, width))
    for _ in range(250):
        cx, cy, sigma, amplitude = random.uniform([0, 0, 2.5, -0.3], [width, height, 7, 0.3])
        attenuation = attenuation + amplitude * (numpy.exp(-((x - cx) ** 2) / (2 * sigma ** 2)) *
                                                 numpy.exp(-((y - cy) ** 2) / (2 * sigma ** 2)))
    counts = numpy.exp(-attenuation) * {"mono16": 20000, "mono8": 90, "rgb8": 90}[encoding]
    pixels = counts.round().astype("<u2" if encoding == "mono16" else "u1")
    if encoding == "rgb8":
        pixels = numpy.repeat(pixels, 3, axis=1)
    image = Image(height=height, width=width, encoding=encoding, is_bigendian=0, step=pixels.nbytes // height)
    image.header.frame_id = "some_optical_frame"
    image.data = pixels.tobytes()
    return image


def equals(a, b):
    return (a.x_offset, a.y_offset, a.width, a.height) == (b.x_offset, b.y_offset, b.width, b.height)


class Detector:
    """Sends exposures to one tracker and collects its answers; ready once both ends are connected."""

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

    def send(self, stamp, image):
        image.header.stamp = rospy.Time.from_sec(stamp)
        self.publisher.publish(image)

    def answer(self):
        return self.answers.get(timeout=PATIENCE)

    def close(self):
        self.publisher.unregister()
        self.subscriber.unregister()


class HyperplaneTrackerTest(unittest.TestCase):
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

    def connect(self, name):
        detector = Detector(name)
        self.addCleanup(detector.close)
        return detector

    def stamp(self):
        HyperplaneTrackerTest.next_stamp += 0.125
        return self.next_stamp

    def judge(self, answer, stamp, reference, displacement):
        self.assertEqual(answer.header.stamp, rospy.Time.from_sec(stamp))
        self.assertEqual(answer.header.frame_id, "some_optical_frame")
        self.assertEqual(answer.state, TrackedRegion.TRACKING)
        self.assertEqual(answer.reference_stamp, rospy.Time.from_sec(reference))
        self.assertTrue(equals(answer.region, REGION))
        self.assertAlmostEqual(answer.displacement_x, displacement[0], delta=TOLERANCE)
        self.assertAlmostEqual(answer.displacement_y, displacement[1], delta=TOLERANCE)
        self.assertGreater(answer.correlation, 0.9)
        self.assertGreaterEqual(answer.iterations, 4)
        xx, xy, yx, yy = (answer.covariance[i] for i in (0, 1, 6, 7))
        self.assertEqual(xy, yx)
        self.assertGreater(xx * yy - xy * yx, 0.0)
        self.assertLess(math.sqrt(xx + yy), TOLERANCE)
        self.assertGreater(answer.cpu_time.to_sec(), 0.0)
        self.assertGreater(answer.wall_time.to_sec(), 0.0)

    def assert_untrained(self, answer, stamp):
        self.assertEqual(answer.header.stamp, rospy.Time.from_sec(stamp))
        self.assertEqual(answer.state, TrackedRegion.UNTRAINED)
        self.assertEqual((answer.displacement_x, answer.displacement_y), (0.0, 0.0))

    def restart(self, detector):
        """Jumps back in time, so that the tracker trains anew. @return the reference stamp"""
        HyperplaneTrackerTest.next_stamp -= 500.0
        reference = self.stamp()
        detector.send(reference, exposure())
        answer = detector.answer()
        self.judge(answer, reference, reference, (0.0, 0.0))
        self.assertEqual((answer.displacement_x, answer.displacement_y), (0.0, 0.0))
        return reference

    def test_answers_every_exposure_of_a_burst_in_order(self):
        detector = self.connect("parameter_region")
        self.restart(detector)
        HyperplaneTrackerTest.next_stamp -= 500.0
        stamps = [self.stamp() for _ in self.truth]
        # The first one makes it train; the others arrive meanwhile. No more than its queue holds.
        for k, (stamp, (dx, dy)) in enumerate(zip(stamps, self.truth)):
            detector.send(stamp, exposure(dx, dy, seed=k) if k > 0 else exposure())
        self.judge(detector.answer(), stamps[0], stamps[0], (0.0, 0.0))
        for stamp, truth in list(zip(stamps, self.truth))[1:]:
            self.judge(detector.answer(), stamp, stamps[0], truth)

    def test_lives_through_changes_of_size_and_encoding(self):
        detector = self.connect("parameter_region")
        reference = self.restart(detector)
        truncated = exposure()
        truncated.data = truncated.data[:1000]
        for image, parts in ((exposure(width=180), ["180 x 200", "240 x 200"]),
                             (exposure(encoding="mono8"), ["mono8", "mono16"]),
                             (exposure(encoding="rgb8"), ["rgb8", "mono16"]),
                             (truncated, [])):
            stamp = self.stamp()
            detector.send(stamp, image)
            answer = detector.answer()
            self.assertEqual(answer.header.stamp, rospy.Time.from_sec(stamp))
            self.assertEqual(answer.state, TrackedRegion.LOST)
            if parts:
                self.expect_diagnosis("parameter_region", *parts)
            stamp = self.stamp()
            detector.send(stamp, exposure(2.5, -1.25, seed=2))
            self.judge(detector.answer(), stamp, reference, (2.5, -1.25))

    def test_is_lost_without_target_and_finds_it_again(self):
        detector = self.connect("parameter_region")
        reference = self.restart(detector)
        black = exposure()
        black.data = bytes(len(black.data))
        for _ in range(3):
            stamp = self.stamp()
            detector.send(stamp, black)
            answer = detector.answer()
            self.assertEqual(answer.state, TrackedRegion.LOST)
            self.assertTrue(equals(answer.region, REGION))
            self.assertEqual((answer.displacement_x, answer.displacement_y), (0.0, 0.0))
            self.assertTrue(math.isfinite(answer.correlation))
        stamp = self.stamp()
        detector.send(stamp, exposure(4.0, 3.0))
        self.judge(detector.answer(), stamp, reference, (4.0, 3.0))

    def test_drops_exposures_that_are_not_newer(self):
        detector = self.connect("parameter_region")
        reference = self.restart(detector)
        stamp = self.stamp()
        detector.send(stamp, exposure(1.0, 2.0))
        detector.send(stamp, exposure(9.0, 9.0))
        detector.send(stamp - 0.0625, exposure(9.0, 9.0))
        after = self.stamp()
        detector.send(after, exposure(3.0, 0.5))
        self.judge(detector.answer(), stamp, reference, (1.0, 2.0))
        self.judge(detector.answer(), after, reference, (3.0, 0.5))

    def test_says_when_exposures_stop(self):
        detector = self.connect("parameter_region")
        self.restart(detector)
        self.expect_diagnosis("parameter_region", "no exposure on /parameter_region/image_raw for")

    def test_shows_the_region_to_who_looks(self):
        detector = self.connect("parameter_region")
        pictures = queue.Queue()
        viewer = rospy.Subscriber("parameter_region/tracked_region_image", Image, pictures.put, queue_size=10)
        self.addCleanup(viewer.unregister)
        deadline = rospy.get_time() + PATIENCE
        while viewer.get_num_connections() == 0 and rospy.get_time() < deadline:
            rospy.sleep(0.01)
        self.restart(detector)
        # The tracker may learn of its viewer later than the viewer of the tracker.
        while pictures.empty() and rospy.get_time() < deadline:
            detector.send(self.stamp(), exposure())
            detector.answer()
        picture = pictures.get(timeout=PATIENCE)
        self.assertEqual((picture.width, picture.height, picture.encoding), (WIDTH, HEIGHT, "bgr8"))
        self.assertEqual(picture.header.frame_id, "some_optical_frame")
        pixels = numpy.frombuffer(picture.data, numpy.uint8).reshape(HEIGHT, WIDTH, 3)
        self.assertTrue((pixels[100, 70] == (80, 200, 80)).all(), "no green outline at %s" % pixels[100, 70])
        self.assertEqual(len(set(pixels[20, 20])), 1, "grey outside the outline")

    def call(self, region):
        """A call of train_region in the background. @return a function that waits for its response"""
        service = rospy.ServiceProxy("service_region/train_region", TrainRegion)
        responses = queue.Queue()
        threading.Thread(target=lambda: responses.put(service(region)), daemon=True).start()
        return responses

    def train_by_service(self, detector, region, make=exposure):
        """Sends exposures until the call is answered. @return the response, the exposures' answers by stamp"""
        responses = self.call(region)
        answers = []
        while responses.empty():
            detector.send(self.stamp(), make())
            answers.append(detector.answer())
            rospy.sleep(0.05)
        return responses.get(), answers

    def test_service_trains_and_refuses(self):
        rospy.wait_for_service("service_region/train_region", PATIENCE)
        detector = self.connect("service_region")
        stamp = self.stamp()
        detector.send(stamp, exposure())
        self.assert_untrained(detector.answer(), stamp)

        # A silent detector; meanwhile a second call.
        first = self.call(REGION)
        rospy.sleep(1.0)
        self.assertEqual(self.call(REGION).get(timeout=PATIENCE).status, TrainRegionResponse.BUSY)
        response = first.get(timeout=PATIENCE)
        self.assertEqual(response.status, TrainRegionResponse.NO_IMAGE)
        self.assertIn("exposure", response.message)

        outside = RegionOfInterest(x_offset=200, y_offset=55, width=100, height=90)
        response, _ = self.train_by_service(detector, outside)
        self.assertEqual(response.status, TrainRegionResponse.INVALID_REGION)
        self.assertIn("100 x 90 at (200, 55)", response.message)

        def flat():
            image = exposure()
            image.data = numpy.full(WIDTH * HEIGHT, 5000, "<u2").tobytes()
            return image
        response, answers = self.train_by_service(detector, REGION, flat)
        self.assertEqual(response.status, TrainRegionResponse.INVALID_REGION)
        self.assertIn("too little contrast", response.message)
        self.assertTrue(all(answer.state == TrackedRegion.UNTRAINED for answer in answers))

        response, answers = self.train_by_service(detector, REGION)
        self.assertEqual(response.status, TrainRegionResponse.OK, response.message)
        trained = [answer for answer in answers if answer.state == TrackedRegion.TRACKING]
        self.assertGreaterEqual(len(trained), 1)
        reference = trained[0].reference_stamp.to_sec()
        self.assertEqual(trained[0].header.stamp.to_sec(), reference)
        for k, truth in enumerate(self.truth):
            stamp = self.stamp()
            detector.send(stamp, exposure(*truth, seed=k))
            self.judge(detector.answer(), stamp, reference, truth)

        # A refused region leaves the template in use.
        response, answers = self.train_by_service(detector, outside)
        self.assertEqual(response.status, TrainRegionResponse.INVALID_REGION)
        self.assertTrue(all(answer.state == TrackedRegion.TRACKING for answer in answers))
        self.assertEqual(answers[-1].reference_stamp.to_sec(), reference)

    def test_faulty_settings_leave_exposures_untrained(self):
        for name, parts in (("outside_region", ["100 x 90 at (200, 55)", "240 x 200"]),
                            ("bad_parameter", ["points", "many"]),
                            ("missing_setup", ["/nowhere/setup.yaml"])):
            detector = self.connect(name)
            for _ in range(3):
                stamp = self.stamp()
                detector.send(stamp, exposure())
                self.assert_untrained(detector.answer(), stamp)
            self.expect_diagnosis(name, *parts)

    def test_region_of_the_setup_file(self):
        detector = self.connect("detector_b")
        self.expect_diagnosis("detector_b", "no exposure on /detector_b/image_raw yet")
        reference = self.stamp()
        detector.send(reference, exposure(width=512, height=512))
        answer = detector.answer()
        self.assertEqual(answer.state, TrackedRegion.TRACKING)
        # The target is C4, in the isocentre, hence in the middle of the detector.
        region = answer.region
        self.assertTrue(region.x_offset < 256 < region.x_offset + region.width)
        self.assertTrue(region.y_offset < 256 < region.y_offset + region.height)
        for k, (dx, dy) in enumerate(self.truth[:5]):
            stamp = self.stamp()
            detector.send(stamp, exposure(dx, dy, width=512, height=512, seed=k))
            answer = detector.answer()
            self.assertEqual((answer.state, answer.reference_stamp), (TrackedRegion.TRACKING,
                                                                      rospy.Time.from_sec(reference)))
            self.assertAlmostEqual(answer.displacement_x, dx, delta=TOLERANCE)
            self.assertAlmostEqual(answer.displacement_y, dy, delta=TOLERANCE)


if __name__ == "__main__":
    rospy.init_node("hyperplane_tracker_test")
    rostest.rosrun("xray_tracking_hyperplane_tracker", "hyperplane_tracker_test", HyperplaneTrackerTest)
