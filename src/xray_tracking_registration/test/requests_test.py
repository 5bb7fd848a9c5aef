#!/usr/bin/python3
"""Requests good and bad, by service and by action: each gets a status and a text, and the next one works."""
import copy
import os
import sys
import tempfile
import threading
import time

import actionlib
import numpy as np
import rospy
import rostest
from actionlib import CommState
from actionlib_msgs.msg import GoalStatus
from diagnostic_msgs.msg import DiagnosticArray
from sensor_msgs.msg import RegionOfInterest
from std_msgs.msg import String

sys.path.insert(0, os.path.dirname(os.path.abspath(__file__)))
from registration_test_case import (DETECTORS, RegistrationTestCase, Sender, TIMEOUT, not_a_volume,  # noqa: E402
                                    shifted)
from xray_tracking_msgs.msg import (RefinePoseAction, RefinePoseActionFeedback, RefinePoseGoal,  # noqa: E402
                                    RefinementRequest, RefinementResult)
from xray_tracking_msgs.srv import LoadVolume, RefinePose, RenderViews  # noqa: E402

STAMP = rospy.Time(100)
HALF_STAMP = rospy.Time(101)  # of an exposure that lacks a view
NODE = "/requests/registration"


class RequestsTest(RegistrationTestCase):
    @classmethod
    def setUpClass(cls):
        super().setUpClass()
        cls.exposure = cls.exposures[-1]
        cls.service = rospy.ServiceProxy(f"{NODE}/refine_pose", RefinePose)
        cls.load = rospy.ServiceProxy(f"{NODE}/load_volume", LoadVolume)
        cls.service.wait_for_service(TIMEOUT)
        early = cls.service(RefinementRequest(stamp=STAMP)).result
        if early.status != RefinementResult.NO_EXPOSURE:  # which is what a node says that has its volume already
            assert early.status == RefinementResult.NO_VOLUME and "still being loaded" in early.reason, early
        cls.sender = Sender("requests")
        cls.sender.send(cls.exposure, STAMP)
        cls.sender.send(cls.exposure, HALF_STAMP, DETECTORS[:1])
        cls.wait_for(lambda: "detector_b" in cls.service(RefinementRequest(stamp=HALF_STAMP)).result.reason,
                     "the exposures are kept")
        cls.wait_for(lambda: cls.service(cls.good()).result.status != RefinementResult.NO_EXPOSURE, "a whole exposure")

    @classmethod
    def good(cls, **fields):
        """A request about the kept exposure, from 2.3 mm off."""
        return RefinementRequest(**{"seed": shifted(cls.exposure.truth, 0.0015, -0.001, 0.0015), "stamp": STAMP,
                                    **fields})

    @classmethod
    def with_images(cls, **fields):
        return cls.good(images=[copy.deepcopy(cls.exposure.images[n]) for n in DETECTORS],
                        camera_infos=[copy.deepcopy(cls.exposure.camera_infos[n]) for n in DETECTORS], **fields)

    def endless(self):
        """A request that tries for as long as it can: patches in the place of the patient."""
        request = self.with_images()
        random = np.random.default_rng(1)
        for image in request.images:
            patches = random.integers(3000, 50000, (image.height // 16, image.width // 16))
            image.data = np.kron(patches, np.ones((16, 16))).astype(np.uint16).tobytes()
        return request

    def check_good(self, result):
        self.assertEqual(result.status, RefinementResult.SUCCESS, result.reason)
        # Much nearer than the seed; how near, is judged by the library's tests.
        self.assertLess(self.error_mm(result.pose.pose, self.exposure.truth), 0.5)
        self.assertGreater(result.similarity_after, result.similarity_before)
        self.assertGreater(result.iterations, 0)
        self.assertEqual(len(result.views), len(DETECTORS))
        for view in result.views:
            self.assertGreater(view.similarity, 0.6)
            self.assertLess(view.pull, 0.002)
        covariance = np.reshape(result.pose.covariance, (6, 6))
        self.assertGreater(np.linalg.eigvalsh(covariance).min(), 0.0)
        self.assertLess(np.sqrt(covariance.trace()), 0.1)
        self.assertGreater(result.time.to_sec(), 0.0)

    def check_bad(self, request, status, *words):
        """The status and the words, no NaN; and the next request works."""
        result = self.service(request).result
        self.assertEqual(result.status, status, result.reason)
        for word in words:
            self.assertIn(word, result.reason)
        self.assertTrue(result.reason)
        pose = result.pose.pose
        numbers = [result.similarity_before, result.similarity_after, pose.position.x, pose.position.y,
                   pose.position.z, pose.orientation.x, pose.orientation.w, *result.pose.covariance]
        self.assertTrue(np.isfinite(numbers).all(), numbers)
        self.check_good(self.service(self.good()).result)

    def test_good(self):
        self.check_good(self.service(self.good()).result)
        self.check_good(self.service(self.good(stamp=rospy.Time())).result)
        self.check_good(self.service(self.with_images(stamp=rospy.Time(7))).result)
        region = RegionOfInterest(x_offset=150, y_offset=150, width=200, height=200)
        self.check_good(self.service(self.good(regions=[region, RegionOfInterest()], max_translation=0.01,
                                               max_rotation=0.1, time_budget=20.0)).result)

    def test_wrong_stamp(self):
        self.check_bad(self.good(stamp=rospy.Time(55)), RefinementResult.NO_EXPOSURE, "55.0")

    def test_view_missing(self):
        self.check_bad(self.good(stamp=HALF_STAMP), RefinementResult.NO_EXPOSURE, "101.0", "detector_b/image_raw")
        request = self.with_images()
        del request.images[1]
        self.check_bad(request, RefinementResult.INVALID, "number of images is 1", "2 detectors")
        request = self.with_images()
        request.camera_infos = []
        self.check_bad(request, RefinementResult.INVALID, "number of camera_infos is 0")

    def test_without(self):
        """Detectors that are not to be compared: two have to be left, and the phantom's setup has two."""
        self.check_bad(self.good(without=["detector_b"]), RefinementResult.INVALID, "detectors to compare is 1")
        self.check_bad(self.good(without=["detector_x"]), RefinementResult.INVALID, "detector_x", "detector_b")
        # What is missing is named, and not what is left out.
        stamp = rospy.Time(104)
        self.exposure.camera_infos["detector_b"].header.stamp = stamp
        self.sender.infos["detector_b"].publish(self.exposure.camera_infos["detector_b"])
        request = self.good(stamp=stamp, without=["detector_a"])
        self.wait_for(lambda: "lacks a view" in self.service(request).result.reason, "camera_info")
        self.check_bad(request, RefinementResult.NO_EXPOSURE, "104.0", "lacks a view: detector_b/image_raw")

    def test_tf_late_and_changed(self):
        """A camera's frame that tf does not know yet counts once it does; moved, it counts from the next exposure on."""
        moved = copy.deepcopy(self.exposure)
        for name in DETECTORS:
            moved.camera_infos[name].header.frame_id = f"{name}_late"
        self.sender.send(moved, rospy.Time(102))
        result = None

        def ask(stamp, x=0.0):
            nonlocal result
            result = self.service(self.good(stamp=stamp, seed=shifted(self.exposure.truth, x + 0.0015, -0.001, 0.0015))
                                  ).result
            return result

        self.wait_for(lambda: ask(rospy.Time(102)).status != RefinementResult.NO_EXPOSURE, "the exposure")
        self.assertEqual(result.status, RefinementResult.INVALID, result.reason)
        self.assertIn("_late", result.reason)
        self.send_frames("late")
        self.wait_for(lambda: ask(rospy.Time(102)).status != RefinementResult.INVALID, "late tf")
        self.check_good(result)
        # Both detectors, so the pose moves as they do. tf comes in another thread than exposures.
        self.send_frames("late", 0.02)
        time.sleep(0.5)
        self.sender.send(moved, rospy.Time(103))
        self.wait_for(lambda: ask(rospy.Time(103), 0.02).status != RefinementResult.NO_EXPOSURE, "the exposure")
        self.assertEqual(result.status, RefinementResult.SUCCESS, result.reason)
        self.assertLess(self.error_mm(result.pose.pose, shifted(self.exposure.truth, 0.02, 0.0, 0.0)), 0.5)

    def test_bad_seed(self):
        self.check_bad(self.good(seed=shifted(self.exposure.truth, float("nan"), 0, 0)), RefinementResult.INVALID,
                       "seed", "nan")
        seed = shifted(self.exposure.truth, 0, 0, 0)
        seed.orientation.w = 0.1
        self.check_bad(self.good(seed=seed), RefinementResult.INVALID, "seed")
        self.check_bad(self.good(seed=shifted(self.exposure.truth, 0.5, 0, 0)), RefinementResult.INVALID)
        self.check_bad(self.good(seed=shifted(self.exposure.truth, 1e200, 0, 0)), RefinementResult.INVALID)
        # Both see the target, but not there.
        self.check_bad(self.good(seed=shifted(self.exposure.truth, 0, 0.04, 0.0)), RefinementResult.UNRELIABLE)

    def test_bad_images(self):
        request = self.with_images()
        request.images[1].height //= 2
        request.images[1].data = request.images[1].data[:len(request.images[1].data) // 2]
        self.check_bad(request, RefinementResult.INVALID, "detector_b", "512 x 256", "512 x 512")
        request = self.with_images()
        request.images[0].data = request.images[0].data[:1000]
        self.check_bad(request, RefinementResult.INVALID)
        request = self.with_images()
        request.images[0].encoding = "rgb8"
        self.check_bad(request, RefinementResult.INVALID, "detector_a", "rgb8", "mono16")
        request = self.with_images()
        for image in request.images:
            image.data = np.full(image.width * image.height, 20000, np.uint16).tobytes()
        self.check_bad(request, RefinementResult.INVALID)
        request = self.with_images()
        request.camera_infos[0].header.frame_id = "nowhere"
        self.check_bad(request, RefinementResult.INVALID, "nowhere")
        request = self.with_images()
        request.camera_infos[0].K = [0.0] * 9
        self.check_bad(request, RefinementResult.INVALID, "detector_a")

    def test_bad_limits(self):
        self.check_bad(self.good(time_budget=float("nan")), RefinementResult.INVALID, "time_budget", "nan")
        self.check_bad(self.good(max_translation=-1.0), RefinementResult.INVALID, "max_translation", "-1")
        self.check_bad(self.good(max_rotation=9.0), RefinementResult.INVALID, "max_rotation", "9")
        self.check_bad(self.good(regions=[RegionOfInterest(width=50, height=50)]), RefinementResult.INVALID,
                       "number of regions is 1")
        outside = RegionOfInterest(x_offset=9000, y_offset=9000, width=50, height=50)
        self.check_bad(self.good(regions=[outside, outside]), RefinementResult.INVALID)
        self.check_bad(self.good(time_budget=1e-5), RefinementResult.TIMED_OUT, "budget")

    def test_wide(self):
        seed = shifted(self.exposure.truth, 0.02, -0.015, 0.01)
        result = self.service(self.good(search="wide", seed=seed)).result
        self.assertEqual(result.status, RefinementResult.SUCCESS, result.reason)
        self.assertLess(self.error_mm(result.pose.pose, self.exposure.truth), 0.5)
        self.assertTrue(result.rivals)
        for rival in result.rivals:
            self.assertGreater(rival.distance, 0.005)
            self.assertLess(rival.similarity, result.similarity_after)
            self.assertGreater(self.error_mm(rival.pose, self.exposure.truth), 5.0)
        # Not within the bounds that the request names.
        self.check_bad(self.good(search="wide", seed=seed, max_translation=0.015), RefinementResult.UNRELIABLE)
        self.check_bad(self.good(search="everywhere"), RefinementResult.INVALID, "search", "everywhere", "wide")
        self.check_bad(self.good(search="wide", max_translation=0.2), RefinementResult.INVALID, "200", "100 mm")
        region = RegionOfInterest(x_offset=150, y_offset=150, width=200, height=200)
        self.check_bad(self.good(search="wide", regions=[region, region]), RefinementResult.INVALID, "region")

    def test_volumes(self):
        with tempfile.TemporaryDirectory() as folder:
            os.symlink("/etc/hostname", os.path.join(folder, "link.nrrd"))
            for path, word in ((not_a_volume(folder), "not_a_volume.nrrd"), ("/nowhere", "/nowhere"), ("", "path"),
                               ("/etc/hostname", "out of the data folder"),
                               (os.path.join(folder, "../../etc/hostname"), "out of the data folder"),
                               (os.path.join(folder, "link.nrrd"), "out of the data folder"),
                               (os.path.join(folder, "nothing.nrrd"), "no such file")):
                answer = self.load(path)
                self.assertFalse(answer.success)
                self.assertIn(word, answer.message)
                self.check_good(self.service(self.good()).result)
        # What is in use is still the phantom.
        self.assertEqual(rospy.wait_for_message(f"{NODE}/volume", String, TIMEOUT).data, "")

    def test_render(self):
        """The CT at the true pose looks like the exposure, and less so 5 mm aside; what is wrong is named."""
        render = rospy.ServiceProxy(f"{NODE}/render", RenderViews)
        infos = [self.exposure.camera_infos[name] for name in DETECTORS]

        def attenuations(pose):
            answer = render(pose, infos, 128)
            self.assertTrue(answer.success, answer.message)
            self.assertEqual(len(answer.views), len(DETECTORS))
            return answer.views

        def likeness(view, image):
            rendered = np.frombuffer(view.line_integrals.data, np.float32).reshape(view.line_integrals.height, -1)
            self.assertEqual(view.line_integrals.encoding, "32FC1")
            self.assertEqual(max(rendered.shape), 128)
            step = int(view.step)
            self.assertEqual((view.first_x, view.first_y), (0.5 * (step - 1),) * 2)
            counts = np.frombuffer(image.data, np.uint16).reshape(image.height, image.width).astype(float)
            bins = counts.reshape(image.height // step, step, -1, step).mean((1, 3))
            logs = -np.log(np.maximum(bins - 100.0, 1.0))
            # What is fine: neighbours' differences, along rows.
            return np.corrcoef(np.diff(rendered[20:-20, 20:-20]).ravel(), np.diff(logs[20:-20, 20:-20]).ravel())[0, 1]

        views = attenuations(self.exposure.truth)
        aside = attenuations(shifted(self.exposure.truth, 0.005, 0.0, 0.0))
        for name, view, other in zip(DETECTORS, views, aside):
            image = self.exposure.images[name]
            self.assertGreater(likeness(view, image), 0.7)
            self.assertGreater(likeness(view, image), likeness(other, image) + 0.1)

        wrong = copy.deepcopy(self.exposure.truth)
        wrong.position.x = float("nan")
        far = copy.deepcopy(infos)
        far[0].header.frame_id = "nowhere"
        broken = copy.deepcopy(infos)
        broken[1].K = [float("nan")] * 9
        for pose, camera_infos, size, word in ((wrong, infos, 128, "position"), (self.exposure.truth, [], 128, "number"),
                                               (self.exposure.truth, far, 128, "nowhere"),
                                               (self.exposure.truth, broken, 128, "nan"),
                                               (self.exposure.truth, infos, 0, "max_size is 0"),
                                               (self.exposure.truth, infos, 5000, "max_size is 5000")):
            answer = render(pose, camera_infos, size)
            self.assertFalse(answer.success)
            self.assertIn(word, answer.message)
            self.assertFalse(answer.views)
        attenuations(self.exposure.truth)

    def test_busy(self):
        results = []

        def ask():
            results.append(self.service(self.endless()).result)

        for _ in range(20):
            del results[:]
            threads = [threading.Thread(target=ask) for _ in range(3)]
            for thread in threads:
                thread.start()
            for thread in threads:
                thread.join()
            statuses = [result.status for result in results]
            self.assertEqual(len(statuses), 3)
            self.assertTrue(any(status != RefinementResult.BUSY for status in statuses), "somebody gets through")
            if RefinementResult.BUSY in statuses:
                break
        busy = next(result for result in results if result.status == RefinementResult.BUSY)
        self.assertIn("another request", busy.reason)
        self.check_good(self.service(self.good()).result)

    def client(self):
        client = actionlib.ActionClient(f"{NODE}/refine_pose", RefinePoseAction)
        self.assertTrue(client.wait_for_server(rospy.Duration(TIMEOUT)))
        return client

    def test_action(self):
        client = self.client()
        # Not the client's, which lets fall what comes after the result on a connection of its own.
        feedback = []
        subscriber = rospy.Subscriber(f"{NODE}/refine_pose/feedback", RefinePoseActionFeedback,
                                      lambda message: feedback.append(message.feedback))
        self.wait_for(lambda: subscriber.get_num_connections() > 0, "the feedback's connection")
        goal = client.send_goal(RefinePoseGoal(self.good()))
        self.wait_for(lambda: goal.get_comm_state() == CommState.DONE, "the action's end")
        self.assertEqual(goal.get_terminal_state(), GoalStatus.SUCCEEDED)
        self.check_good(goal.get_result().result)
        self.wait_for(lambda: feedback, "feedback")
        self.assertLess(self.error_mm(feedback[0].pose, self.exposure.truth), 10.0)
        goal = client.send_goal(RefinePoseGoal(self.good(stamp=rospy.Time(55))))
        self.wait_for(lambda: goal.get_comm_state() == CommState.DONE, "the action's end")
        self.assertEqual(goal.get_terminal_state(), GoalStatus.ABORTED)
        self.assertEqual(goal.get_result().result.status, RefinementResult.NO_EXPOSURE)

    def test_cancel(self):
        client = self.client()
        latencies = []
        for _ in range(20):
            begun, ended = threading.Event(), threading.Event()

            def transition(handle, ended=ended):
                if handle.get_comm_state() == CommState.DONE:
                    ended.set()

            goal = client.send_goal(RefinePoseGoal(self.endless()), transition_cb=transition,
                                    feedback_cb=lambda *_, begun=begun: begun.set())
            self.assertTrue(begun.wait(TIMEOUT))
            cancelled = time.monotonic()
            goal.cancel()
            self.assertTrue(ended.wait(TIMEOUT))
            if goal.get_terminal_state() == GoalStatus.PREEMPTED:
                latencies.append(time.monotonic() - cancelled)
                result = goal.get_result().result
                self.assertEqual(result.status, RefinementResult.CANCELLED)
                self.assertEqual(result.reason, "cancelled")
            self.check_good(self.service(self.good()).result)
            if len(latencies) == 5:
                break
        print(f"cancel to result: {[round(1000 * t) for t in latencies]} ms")
        self.assertTrue(latencies, "none could be cancelled before its end")
        # 50 ms on a machine that has time for it; the median, as this test and others may hold it up.
        self.assertLess(np.median(latencies), 0.1)

    def test_diagnostics(self):
        texts = {}
        subscriber = rospy.Subscriber("/diagnostics", DiagnosticArray, lambda message: texts.update(
            {status.name: status.message for status in message.status}))
        self.check_good(self.service(self.good()).result)
        self.wait_for(lambda: any(name.startswith(NODE[1:]) and text == "ready" for name, text in texts.items()),
                      f"diagnostics: {texts}")
        subscriber.unregister()


if __name__ == "__main__":
    rospy.init_node("requests_test")
    rostest.rosrun("xray_tracking_registration", "requests", RequestsTest)
