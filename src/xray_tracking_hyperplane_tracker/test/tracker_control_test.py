#!/usr/bin/python3
"""What a person does to a tracker, and what it does in trouble: services, live settings, methods, loss, overload."""

import rospy
import rostest
from dynamic_reconfigure.client import Client
from std_srvs.srv import Trigger
from tracker_test_case import PATIENCE, REGION, TOLERANCE, TrackerTestCase, exposure, turned
from xray_tracking_msgs.msg import TrackedRegion
from xray_tracking_msgs.srv import TrainRegion, TrainRegionResponse

# A fifth of the region.
COVER = (slice(60, 96), slice(75, 125))


class TrackerControlTest(TrackerTestCase):
    def show(self, detector, image):
        """@return the exposure's stamp and answer"""
        stamp = self.stamp()
        detector.send(stamp, image)
        return stamp, detector.answer()

    def test_goes_on_with_the_newest_when_it_is_too_slow(self):
        detector = self.connect("too_slow")
        reference, _ = self.show(detector, exposure())
        image = exposure(3.0, -2.0, seed=1)
        stamps = [self.stamp() for _ in range(15)]
        for stamp in stamps:
            detector.send(stamp, image)
        answers = [detector.answer()]
        while answers[-1].header.stamp != rospy.Time.from_sec(stamps[-1]):
            answers.append(detector.answer())
        self.judge(answers[-1], stamps[-1], reference, (3.0, -2.0), quality=0.7)
        answered = [answer.header.stamp.to_sec() for answer in answers]
        self.assertEqual(answered, sorted(answered))
        self.assertLess(len(answered), len(stamps))
        self.expect_value("too_slow", "exposures dropped, too slow", str(len(stamps) - len(answered)))
        self.expect_value("too_slow", "exposures answered", str(1 + len(answered)))

    def test_diagnostics_tell_of_a_training_while_it_lasts(self):
        detector = self.connect("slow_training")
        self.expect_value("slow_training", "state", "untrained")
        reference = self.stamp()
        detector.send(reference, exposure())
        self.expect_value("slow_training", "state", "training")
        self.assertTrue(detector.answers.empty())
        self.judge(detector.answer(), reference, reference, (0.0, 0.0))
        self.expect_value("slow_training", "state", "tracking")

    def test_other_methods_track_as_well(self):
        for name, model in (("by_nmi", TrackedRegion.TRANSLATION),
                            ("by_gradient_correlation", TrackedRegion.EUCLIDEAN)):
            detector = self.connect(name)
            reference, answer = self.show(detector, exposure())
            self.assertEqual(answer.state, TrackedRegion.TRACKING)
            for k, truth in enumerate(self.truth[:8]):
                _, answer = self.show(detector, exposure(*truth, seed=k + 1))
                self.assertEqual((answer.state, answer.model), (TrackedRegion.TRACKING, model))
                self.assertEqual(answer.reference_stamp, rospy.Time.from_sec(reference))
                self.assertAlmostEqual(answer.displacement_x, truth[0], delta=TOLERANCE)
                self.assertAlmostEqual(answer.displacement_y, truth[1], delta=TOLERANCE)
                self.assertAlmostEqual(answer.linear[0], 1.0, delta=1e-3)
            response = rospy.ServiceProxy(name + "/retrain", Trigger)
            outcome, _ = self.call_among_exposures(detector, exposure, response)
            self.assertFalse(outcome.success)
            self.assertIn("does not learn", outcome.message)

    def test_finds_the_region_again_anywhere_but_nothing_else(self):
        detector = self.connect("parameter_region")
        reference = self.restart(detector)
        for _ in range(8):
            _, answer = self.show(detector, turned())
            self.assertEqual(answer.state, TrackedRegion.LOST)
        # Far from where it was last, by more than what is looked at there; up to a fifth of it is outside the image.
        for truth in ((-60.0, 45.0), (58.0, -40.0)):
            _, answer = self.show(detector, turned())
            self.assertEqual(answer.state, TrackedRegion.LOST)
            for k in range(5):
                stamp, answer = self.show(detector, exposure(*truth, seed=k))
                if answer.state == TrackedRegion.TRACKING:
                    break
            self.judge(answer, stamp, reference, truth)

    def test_settings_change_live_and_contradictions_are_refused(self):
        detector = self.connect("parameter_region")
        client = Client("parameter_region/tracker", timeout=PATIENCE)
        self.addCleanup(client.close)
        reference = self.restart(detector)
        stamp, answer = self.show(detector, exposure(2.0, 1.0, cover=COVER))
        self.judge(answer, stamp, reference, (2.0, 1.0), quality=0.6)
        self.assertLess(answer.quality, 0.84)

        self.assertAlmostEqual(client.update_configuration({"good_quality": 0.85})["good_quality"], 0.85)
        stamp, answer = self.show(detector, exposure(2.0, 1.0, cover=COVER))
        self.judge(answer, stamp, reference, (2.0, 1.0), quality=0.6, state=TrackedRegion.DEGRADED)
        self.expect_diagnosis("parameter_region", "degraded")
        stamp, answer = self.show(detector, exposure(1.0, 1.5, seed=1))
        self.judge(answer, stamp, reference, (1.0, 1.5))

        for refused in ({"found_correlation": 0.2}, {"min_quality": 0.9}, {"min_correlation": float("nan")}):
            config = client.update_configuration(refused)
            for key, value in (("found_correlation", 0.75), ("min_quality", 0.5), ("min_correlation", 0.65),
                               ("good_quality", 0.85)):
                self.assertAlmostEqual(config[key], value)
        config = client.update_configuration({"min_correlation": 0.9999, "found_correlation": 1.0})
        _, answer = self.show(detector, exposure(1.0, 1.0, cover=COVER))
        self.assertEqual(answer.state, TrackedRegion.LOST)
        client.update_configuration({"min_correlation": 0.65, "found_correlation": 0.75, "good_quality": 0.6})
        stamp, answer = self.show(detector, exposure(1.0, 1.0, seed=3))
        self.judge(answer, stamp, reference, (1.0, 1.0))

    def test_reset_makes_the_next_exposure_the_first(self):
        detector = self.connect("parameter_region")
        self.restart(detector)
        reset = rospy.ServiceProxy("parameter_region/reset", Trigger)
        self.assertTrue(reset().success)
        reference, answer = self.show(detector, exposure(5.0, 5.0))
        self.judge(answer, reference, reference, (0.0, 0.0))
        stamp, answer = self.show(detector, exposure(7.0, 4.0, seed=1))
        self.judge(answer, stamp, reference, (2.0, -1.0))

        # A region from the service is forgotten, too.
        detector = self.connect("service_region")
        train = rospy.ServiceProxy("service_region/train_region", TrainRegion)
        response, _ = self.call_among_exposures(detector, exposure, train, REGION)
        self.assertEqual(response.status, TrainRegionResponse.OK, response.message)
        _, answer = self.show(detector, exposure(1.0, 1.0, seed=1))
        self.assertEqual(answer.state, TrackedRegion.TRACKING)
        self.assertTrue(rospy.ServiceProxy("service_region/reset", Trigger)().success)
        stamp, answer = self.show(detector, exposure(1.0, 1.0, seed=2))
        self.assert_untrained(answer, stamp)

    def test_retraining_keeps_the_anchor(self):
        detector = self.connect("parameter_region")
        reference = self.restart(detector)
        retrain = rospy.ServiceProxy("parameter_region/retrain", Trigger)
        for truth in ((3.0, -2.0), (-4.0, 1.5)):
            outcome, _ = self.call_among_exposures(detector, lambda: exposure(*truth, seed=5), retrain)
            self.assertTrue(outcome.success, outcome.message)
        for k, truth in enumerate(self.truth[:6]):
            stamp, answer = self.show(detector, exposure(*truth, seed=k))
            self.judge(answer, stamp, reference, truth)

        outcome, _ = self.call_among_exposures(detector, turned, retrain)
        self.assertFalse(outcome.success)
        self.assertIn("lost", outcome.message)

    def test_faulty_settings_leave_exposures_untrained(self):
        for name, parts in (("unknown_method", ["method is magic", "nmi"]),
                            ("model_of_another_method", ["model is affine", "euclidean"]),
                            ("contradiction", ["found_correlation is 0.8", "0.9"])):
            detector = self.connect(name)
            stamp, answer = self.show(detector, exposure())
            self.assert_untrained(answer, stamp)
            self.expect_diagnosis(name, *parts)
            self.assertTrue(rospy.ServiceProxy(name + "/reset", Trigger)().success)
            outcome, _ = self.call_among_exposures(detector, exposure, rospy.ServiceProxy(name + "/retrain", Trigger))
            self.assertFalse(outcome.success)
            self.assertIn(parts[0], outcome.message)


if __name__ == "__main__":
    rospy.init_node("tracker_control_test")
    rostest.rosrun("xray_tracking_hyperplane_tracker", "tracker_control_test", TrackerControlTest)
