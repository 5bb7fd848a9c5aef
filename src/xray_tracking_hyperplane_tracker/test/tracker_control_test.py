#!/usr/bin/python3
"""What a person does to a tracker, and what it does in trouble: services, live settings, loss, overload."""

import subprocess

import roslib.packages
import rospy
import rostest
from dynamic_reconfigure.client import Client
from sensor_msgs.msg import RegionOfInterest
from std_srvs.srv import Trigger
from tracker_test_case import PATIENCE, REGION, TOLERANCE, TrackerTestCase, equals, exposure, turned
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
        # A region that is lost takes many times as long: it is looked for in the whole image.
        images = 14 * [turned()] + [exposure(3.0, -2.0, seed=1)]
        stamps = [self.stamp() for _ in images]
        for stamp, image in zip(stamps, images):
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

    def judge_switch(self, answers, old):
        """Of exposures in a row: all tracked, up to the one that a new template is learnt on by the old one.
        @param old its reference stamp. @return the new reference stamp"""
        self.assertTrue(all(answer.state == TrackedRegion.TRACKING for answer in answers),
                        [(answer.state, answer.fault) for answer in answers])
        references = [answer.reference_stamp.to_sec() for answer in answers]
        self.assertEqual(references[0], old)
        new = references.index(references[-1])
        self.assertEqual(references, [old] * new + [references[-1]] * (len(answers) - new))
        self.assertEqual(references[-1], answers[new - 1].header.stamp.to_sec())
        return references[-1]

    def test_templates_change_without_a_missing_answer(self):
        detector = self.connect("parameter_region")
        old = self.restart(detector)
        train = rospy.ServiceProxy("parameter_region/train_region", TrainRegion)
        other = RegionOfInterest(x_offset=90, y_offset=60, width=80, height=80)
        still = lambda: exposure(5.0, 5.0)
        # From where the region is, then of another one, then all anew.
        for call, region in (((train, REGION), REGION), ((train, other), other),
                             ((rospy.ServiceProxy("parameter_region/reset", Trigger),), REGION)):
            self.show(detector, still())
            response, answers = self.call_among_exposures(detector, still, *call)
            self.assertTrue(response.success if hasattr(response, "success") else
                            response.status == TrainRegionResponse.OK, response)
            stamp, answer = self.show(detector, exposure(7.0, 4.0, seed=1))
            answers.append(answer)
            old = self.judge_switch(answers, old)
            self.assertIn("%.3f" % old, response.message)
            self.assertTrue(equals(answer.region, region))
            self.assertAlmostEqual(answer.displacement_x, 2.0, delta=TOLERANCE)
            self.assertAlmostEqual(answer.displacement_y, -1.0, delta=TOLERANCE)

        # What is refused changes nothing.
        outside = RegionOfInterest(x_offset=200, y_offset=55, width=100, height=90)
        response, answers = self.call_among_exposures(detector, still, train, outside)
        self.assertEqual(response.status, TrainRegionResponse.INVALID_REGION)
        self.assertIn("100 x 90 at (200, 55)", response.message)
        answers.append(self.show(detector, still())[1])
        self.assertEqual([(answer.state, answer.reference_stamp.to_sec()) for answer in answers],
                         [(TrackedRegion.TRACKING, old)] * len(answers))

    def test_learns_after_the_answer(self):
        detector = self.connect("slow_training")
        old = self.restart(detector)
        responses = self.call(rospy.ServiceProxy("slow_training/train_region", TrainRegion), REGION)
        answers = []
        while responses.empty():
            answers.append(self.show(detector, exposure(1.0, 1.0, seed=len(answers)))[1])
            rospy.sleep(0.05)
        self.assertEqual(responses.get().status, TrainRegionResponse.OK)
        answers.append(self.show(detector, exposure(1.0, 1.0, seed=99))[1])
        new = self.judge_switch(answers, old)
        # The answer of the exposure that was learnt on took no longer than others; the next one's had to wait.
        learnt_on = next(k for k, answer in enumerate(answers) if answer.header.stamp.to_sec() == new)
        training = answers[learnt_on + 1].wall_time.to_sec()
        self.assertGreater(training, 5.0 * answers[learnt_on].wall_time.to_sec())

    def test_reset_forgets_a_region_from_the_service(self):
        detector = self.connect("service_region")
        train = rospy.ServiceProxy("service_region/train_region", TrainRegion)
        response, _ = self.call_among_exposures(detector, exposure, train, REGION)
        self.assertEqual(response.status, TrainRegionResponse.OK, response.message)
        _, answer = self.show(detector, exposure(1.0, 1.0, seed=1))
        self.assertEqual(answer.state, TrackedRegion.TRACKING)
        reset = rospy.ServiceProxy("service_region/reset", Trigger)
        response, answers = self.call_among_exposures(detector, lambda: exposure(1.0, 1.0, seed=2), reset)
        self.assertTrue(response.success, response.message)
        self.assertIn("no region", response.message)
        self.assertEqual(answers[0].state, TrackedRegion.TRACKING)
        stamp, answer = self.show(detector, exposure(1.0, 1.0, seed=3))
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
        for name, parts in (("unknown_model", ["model is magic", "euclidean"]),
                            ("contradiction", ["found_correlation is 0.8", "0.9"])):
            detector = self.connect(name)
            stamp, answer = self.show(detector, exposure())
            self.assert_untrained(answer, stamp)
            self.expect_diagnosis(name, *parts)
            for service in ("reset", "retrain"):
                outcome, _ = self.call_among_exposures(detector, exposure,
                                                       rospy.ServiceProxy(name + "/" + service, Trigger))
                self.assertFalse(outcome.success)
                self.assertIn(parts[0], outcome.message)

    def test_a_manager_names_what_is_no_detector(self):
        manager = roslib.packages.find_node("xray_tracking_hyperplane_tracker", "tracker_manager_node")[0]
        for names, words in (([], "usage"), (["detector_a", "detector-b"], "'detector-b'"), ([""], "''"),
                             (["/room/detector_a"], "'/room/detector_a'"), (["c"] * 2, "each detector named once")):
            process = subprocess.run([manager, "__name:=a_manager", *names], stderr=subprocess.PIPE, text=True,
                                     timeout=PATIENCE, check=False)
            self.assertEqual(process.returncode, 1, process.stderr)
            self.assertIn(words, process.stderr)


if __name__ == "__main__":
    rospy.init_node("tracker_control_test")
    rostest.rosrun("xray_tracking_hyperplane_tracker", "tracker_control_test", TrackerControlTest)
