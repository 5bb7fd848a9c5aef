#!/usr/bin/python3
"""The tracker's topics and training, every exposure judged."""

import math
import queue

import numpy
import rospy
import rostest
from sensor_msgs.msg import Image, RegionOfInterest
from tracker_test_case import (HEIGHT, PATIENCE, REGION, TOLERANCE, WIDTH, TrackerTestCase, black, equals, exposure,
                               turned)
from xray_tracking_msgs.msg import RegionResiduals, TrackedRegion
from xray_tracking_msgs.srv import TrainRegion, TrainRegionResponse


class HyperplaneTrackerTest(TrackerTestCase):
    def test_answers_every_exposure_of_a_burst_in_order(self):
        detector = self.connect("parameter_region")
        self.restart(detector)
        TrackerTestCase.next_stamp -= 500.0
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
        for _ in range(3):
            stamp = self.stamp()
            detector.send(stamp, turned())
            answer = detector.answer()
            self.assertEqual(answer.state, TrackedRegion.LOST)
            self.assertIn("the region", answer.fault)
            self.assertTrue(equals(answer.region, REGION))
            self.assertEqual((answer.displacement_x, answer.displacement_y), (0.0, 0.0))
            self.assertTrue(math.isfinite(answer.correlation))
        stamp = self.stamp()
        detector.send(stamp, exposure(4.0, 3.0))
        self.judge(detector.answer(), stamp, reference, (4.0, 3.0))

    def test_finds_a_lost_region_beside_blades_over_its_last_place(self):
        def blades(image):
            counts = numpy.frombuffer(image.data, "<u2").reshape(HEIGHT, WIDTH).copy()
            counts[:, :130] = counts[:, :130] // 200 + 5
            image.data = counts.tobytes()
            return image
        detector = self.connect("parameter_region")
        reference = self.restart(detector)
        for image, state in ((blades(exposure(seed=1)), TrackedRegion.BLIND), (exposure(seed=2), TrackedRegion.TRACKING),
                             (turned(), TrackedRegion.LOST), (blades(turned()), TrackedRegion.BLIND)):
            detector.send(self.stamp(), image)
            answer = detector.answer()
            self.assertEqual(answer.state, state)
            self.assertEqual("outside the field" in answer.fault, state == TrackedRegion.BLIND)
        stamp = self.stamp()
        detector.send(stamp, blades(exposure(67.0, 3.0, seed=3)))
        answer = detector.answer()
        self.judge(answer, stamp, reference, (67.0, 3.0))
        self.assertEqual(answer.fault, "")

    def test_tracks_a_given_region_of_a_detector_that_the_setup_lacks(self):
        detector = self.connect("unknown_detector")
        reference = self.stamp()
        detector.send(reference, exposure())
        self.judge(detector.answer(), reference, reference, (0.0, 0.0))
        stamp = self.stamp()
        detector.send(stamp, exposure(2.5, -1.25, seed=2))
        self.judge(detector.answer(), stamp, reference, (2.5, -1.25))

    def test_is_blind_where_there_is_nothing_new_to_be_seen(self):
        detector = self.connect("parameter_region")
        # No template comes from exposures that show nothing; the first one that shows something is the first.
        TrackerTestCase.next_stamp -= 500.0
        for k in range(3):
            detector.send(self.stamp(), black(k))
            answer = detector.answer()
            self.assertEqual(answer.state, TrackedRegion.BLIND)
            self.assertIn("shows nothing", answer.fault)
            self.assertTrue(answer.reference_stamp.is_zero())
        reference = self.stamp()
        detector.send(reference, exposure())
        self.judge(detector.answer(), reference, reference, (0.0, 0.0))
        stamp = self.stamp()
        seen = exposure(2.0, 1.0, seed=1)
        detector.send(stamp, seen)
        self.judge(detector.answer(), stamp, reference, (2.0, 1.0))
        # A panel that has stopped, and one that is off.
        for image, words in ((seen, "bit for bit"), (seen, "%.3f" % stamp), (black(4), "shows nothing")):
            detector.send(self.stamp(), image, repeat=True)
            answer = detector.answer()
            self.assertEqual(answer.state, TrackedRegion.BLIND)
            self.assertIn(words, answer.fault)
            self.assertEqual((answer.displacement_x, answer.displacement_y), (0.0, 0.0))
            self.assertEqual(answer.reference_stamp, rospy.Time.from_sec(reference))
        stamp = self.stamp()
        detector.send(stamp, exposure(3.0, 0.5, seed=2))
        answer = detector.answer()
        self.judge(answer, stamp, reference, (3.0, 0.5))
        self.assertEqual(answer.fault, "")

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

    def test_drops_exposures_of_the_future(self):
        """One that went through would make the next good one look like a bag that starts again."""
        detector = self.connect("parameter_region")
        reference = self.restart(detector)
        detector.send(rospy.Time.now().to_sec() + 3600.0, exposure(9.0, 9.0))
        stamp = self.stamp()
        detector.send(stamp, exposure(1.0, 2.0))
        self.judge(detector.answer(), stamp, reference, (1.0, 2.0))

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

    def test_says_where_the_region_differs_to_who_asks(self):
        """Where something lies over an eighth of the region, and little elsewhere."""
        detector = self.connect("parameter_region")
        messages = queue.Queue()
        viewer = rospy.Subscriber("parameter_region/region_residuals", RegionResiduals, messages.put, queue_size=10)
        self.addCleanup(viewer.unregister)
        deadline = rospy.get_time() + PATIENCE
        while viewer.get_num_connections() == 0 and rospy.get_time() < deadline:
            rospy.sleep(0.01)
        self.restart(detector)
        rows, columns = slice(60, 105), slice(75, 100)
        stamps, found = [], []
        while not found and rospy.get_time() < deadline:
            stamp = self.stamp()
            stamps.append(rospy.Time.from_sec(stamp))
            detector.send(stamp, exposure(cover=(rows, columns)))
            detector.answer()
            while not messages.empty():
                found += [message for message in [messages.get()] if message.header.stamp in stamps]
        self.assertTrue(found, "no residuals of the exposures")
        message = found[0]
        u, v, residual = (numpy.array(values) for values in (message.u, message.v, message.residual))
        self.assertEqual(len(u), len(v))
        self.assertEqual(len(u), len(residual))
        self.assertTrue(200 < len(u) <= 450, len(u))
        inside = (v > rows.start + 5) & (v < rows.stop - 5) & (u > columns.start + 5) & (u < columns.stop - 5)
        outside = (v < rows.start - 5) | (v > rows.stop + 5) | (u < columns.start - 5) | (u > columns.stop + 5)
        self.assertGreater(numpy.median(abs(residual[inside])), 3 * numpy.median(abs(residual[outside])))

    def test_service_trains_and_refuses(self):
        rospy.wait_for_service("service_region/train_region", PATIENCE)
        train = rospy.ServiceProxy("service_region/train_region", TrainRegion)
        detector = self.connect("service_region")
        stamp = self.stamp()
        detector.send(stamp, exposure())
        self.assert_untrained(detector.answer(), stamp)

        # A silent detector; meanwhile a second call.
        first = self.call(train, REGION)
        rospy.sleep(1.0)
        self.assertEqual(self.call(train, REGION).get(timeout=PATIENCE).status, TrainRegionResponse.BUSY)
        response = first.get(timeout=PATIENCE)
        self.assertEqual(response.status, TrainRegionResponse.NO_IMAGE)
        self.assertIn("exposure", response.message)

        outside = RegionOfInterest(x_offset=200, y_offset=55, width=100, height=90)
        response, _ = self.call_among_exposures(detector, exposure, train, outside)
        self.assertEqual(response.status, TrainRegionResponse.INVALID_REGION)
        self.assertIn("100 x 90 at (200, 55)", response.message)

        def flat():
            image = exposure()
            counts = numpy.frombuffer(image.data, "<u2").reshape(HEIGHT, WIDTH).copy()
            counts[40:160, 55:185] = 20000
            image.data = counts.tobytes()
            return image
        response, answers = self.call_among_exposures(detector, flat, train, REGION)
        self.assertEqual(response.status, TrainRegionResponse.INVALID_REGION)
        self.assertIn("too little contrast", response.message)
        self.assertTrue(all(answer.state == TrackedRegion.UNTRAINED for answer in answers))

        response, answers = self.call_among_exposures(detector, exposure, train, REGION)
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
        response, answers = self.call_among_exposures(detector, exposure, train, outside)
        self.assertEqual(response.status, TrainRegionResponse.INVALID_REGION)
        self.assertTrue(all(answer.state == TrackedRegion.TRACKING for answer in answers))
        self.assertEqual(answers[-1].reference_stamp.to_sec(), reference)

    def test_faulty_settings_leave_exposures_untrained(self):
        for name, parts in (("outside_region", ["100 x 90 at (200, 55)", "240 x 200"]),
                            ("bad_parameter", ["points", "many"]),
                            ("bad_resolution", ["resolution is 0", "mm at the target"]),
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
        # A driver that bins without saying so: half of the motion would be told.
        detector.send(self.stamp(), exposure(width=256, height=256))
        answer = detector.answer()
        self.assertEqual(answer.state, TrackedRegion.LOST)
        self.assertEqual(answer.fault, "the image is 256 x 256 px, expected the detector's image_size, 512 x 512")


if __name__ == "__main__":
    rospy.init_node("hyperplane_tracker_test")
    rostest.rosrun("xray_tracking_hyperplane_tracker", "hyperplane_tracker_test", HyperplaneTrackerTest)
