#!/usr/bin/python3
"""What the node makes of the exposures that it is asked about; and what it says if it cannot."""
import os
import signal
import subprocess
import sys
import tempfile
import threading

import numpy as np
import roslib.packages
import rosnode
import rospy
import rostest
from diagnostic_msgs.msg import DiagnosticArray
from std_msgs.msg import String

sys.path.insert(0, os.path.dirname(os.path.abspath(__file__)))
from registration_test_case import (DETECTORS, EXPOSURES, RegistrationTestCase, Sender, TIMEOUT,  # noqa: E402
                                    not_a_volume, read_volume, shifted, small_volume, write_dicom_ct,
                                    write_structure_set, write_volume)
from xray_tracking_msgs.msg import RefinedPose, RefinementRequest, RefinementResult  # noqa: E402
from xray_tracking_msgs.srv import LoadVolume, RefinePose  # noqa: E402

# Largest distance of the target box's corners; how near a registration comes, is judged by the library's tests.
LIMIT_MM = 0.5


def alive(node):
    try:
        return rosnode.rosnode_ping(node, max_count=1)
    except rosnode.ROSNodeIOException:
        return False


class Answers:
    """refined_pose of a namespace, in order of arrival."""

    def __init__(self, namespace):
        self.messages = []
        self.subscriber = rospy.Subscriber(f"/{namespace}/refined_pose", RefinedPose, self.messages.append,
                                           queue_size=100)
        RegistrationTestCase.wait_for(lambda: self.subscriber.get_num_connections() > 0, f"{namespace}/refined_pose")

    def wait(self, count):
        RegistrationTestCase.wait_for(lambda: len(self.messages) >= count, f"{count} answers")
        return self.messages


class SequencesTest(RegistrationTestCase):
    def check_refined(self, message, stamp, exposure):
        self.assertEqual(message.header.stamp, stamp)
        self.assertEqual(message.header.frame_id, "treatment_room")
        self.assertEqual(message.result.status, RefinementResult.SUCCESS, message.result.reason)
        self.assertLess(self.error_mm(message.result.pose.pose, exposure.truth), LIMIT_MM)
        self.assertGreater(message.cpu_time.to_sec(), 0.0)
        self.assertGreater(message.wall_time.to_sec(), 0.0)

    def check_failed(self, message, stamp, status, *words):
        self.assertEqual(message.header.stamp, stamp)
        self.assertEqual(message.result.status, status, message.result.reason)
        for word in words:
            self.assertIn(word, message.result.reason)

    def test_publishes_what_it_is_asked_about(self):
        """Each exposure once, in order; also if the request comes first, and if a bag is played again."""
        # So that a pose that is simply handed on is told from one that is found.
        self.assertGreater(self.error_mm(self.exposures[-1].truth, self.exposures[0].truth), 2.0)
        answers = Answers("sequence")
        sender = Sender("sequence")
        refine = rospy.ServiceProxy("/sequence/registration/refine_pose", RefinePose)
        for start in (100, 150, 100):
            del answers.messages[:]
            stamps = [rospy.Time(start, 100000000 * k) for k in range(EXPOSURES)]
            for k, (stamp, exposure) in enumerate(zip(stamps, self.exposures)):
                request = RefinementRequest(seed=shifted(exposure.truth, 0.001, 0.001, -0.001), stamp=stamp)
                if k == 2:
                    later = threading.Timer(0.1, sender.send, (exposure, stamp))
                    later.start()
                    result = refine(request).result
                    later.join()
                elif k == 3:
                    sender.send(exposure, stamp, DETECTORS[:1])
                    result = refine(request).result
                    self.check_failed(answers.wait(k + 1)[k], stamp, RefinementResult.NO_EXPOSURE, "detector_b/image_raw")
                    self.assertEqual(answers.messages.pop().result, result)
                    # One that was not found may come yet.
                    sender.send(exposure, stamp, DETECTORS[1:])
                    result = refine(request).result
                else:
                    sender.send(exposure, stamp)
                    if k == 0:
                        # Asked about at once, an exposure of before the bag was played again would be taken.
                        rospy.sleep(0.3)
                    if k == 4:
                        request.seed.position.x = float("nan")
                    result = refine(request).result
                    if k == 1:
                        self.assertEqual(refine(request).result.status, RefinementResult.SUCCESS)
                self.assertEqual(answers.wait(k + 1)[k].result, result)
            for k, message in enumerate(answers.messages):
                if k == 4:
                    self.check_failed(message, stamps[k], RefinementResult.INVALID, "nan")
                else:
                    self.check_refined(message, stamps[k], self.exposures[k])
            # The latest has been published. Images that somebody brings along are no exposure of the detectors.
            latest = RefinementRequest(seed=self.exposures[-1].truth)
            self.assertEqual(refine(latest).result.status, RefinementResult.SUCCESS)
            latest.images = [self.exposures[-1].images[name] for name in DETECTORS]
            latest.camera_infos = [self.exposures[-1].camera_infos[name] for name in DETECTORS]
            self.assertEqual(refine(latest).result.status, RefinementResult.SUCCESS)
            self.assertEqual(len(answers.messages), EXPOSURES)

    def test_forgets_nothing_because_of_the_future(self):
        sender = Sender("sequence")
        refine = rospy.ServiceProxy("/sequence/registration/refine_pose", RefinePose)
        now = rospy.Time.now().secs
        exposure = self.exposures[0]
        for stamp in (now, 4294967295, now + 1):
            sender.send(exposure, rospy.Time(stamp))
        request = RefinementRequest(seed=exposure.truth)
        for stamp in (now, now + 1):
            request.stamp = rospy.Time(stamp)
            self.assertEqual(refine(request).result.status, RefinementResult.SUCCESS)
        request.stamp = rospy.Time(4294967295)
        result = refine(request).result
        self.assertEqual(result.status, RefinementResult.NO_EXPOSURE)
        self.assertIn("no exposure at 4294967295", result.reason)

    def test_no_volume(self):
        refine = rospy.ServiceProxy("/no_volume/registration/refine_pose", RefinePose)
        load = rospy.ServiceProxy("/no_volume/registration/load_volume", LoadVolume)
        answers = Answers("no_volume")
        sender = Sender("no_volume")
        exposure = self.exposures[0]
        sender.send(exposure, rospy.Time(100))
        request = RefinementRequest(seed=exposure.truth, stamp=rospy.Time(100))
        refine(request)
        self.check_failed(answers.wait(1)[0], rospy.Time(100), RefinementResult.NO_VOLUME, "ct is absent")
        with tempfile.TemporaryDirectory() as folder:
            self.assertFalse(load(not_a_volume(folder)).success)
            result = refine(request).result
            self.assertEqual(result.status, RefinementResult.NO_VOLUME)
            self.assertIn("not_a_volume.nrrd", result.reason)
            answer = load(small_volume(folder))
            self.assertTrue(answer.success, answer.message)
        # What was answered without a volume is not what is wrong with this one.
        texts = []
        subscriber = rospy.Subscriber("/diagnostics", DiagnosticArray, lambda message: texts.extend(
            status.message for status in message.status if status.name.startswith("no_volume/")))
        self.wait_for(lambda: texts, "a diagnosis")
        subscriber.unregister()
        self.assertEqual(texts[0], "ready")
        # It is another patient's, whom the images do not show.
        self.assertEqual(refine(request).result.status, RefinementResult.UNRELIABLE)

    def test_bad_parameter(self):
        for where, what in (("bad_parameter", "guessing"), ("bad_search", "search/max_translation is 0.11"),
                            ("bad_search_rotation", "search/max_rotation is 0")):
            refine = rospy.ServiceProxy(f"/{where}/registration/refine_pose", RefinePose)
            refine.wait_for_service(TIMEOUT)
            self.wait_for(lambda: what in refine(RefinementRequest()).result.reason, f"the reason: {what}")
        answer = rospy.ServiceProxy("/bad_parameter/registration/load_volume", LoadVolume)("/nowhere")
        self.assertFalse(answer.success)
        self.assertIn("guessing", answer.message)

    def test_successor_loads_what_was_asked_for(self):
        """A node that has died is followed by one with the same CT, or by one that says that it does not know which."""
        node = roslib.packages.find_node("xray_tracking_registration", "registration_node")[0]
        refine = rospy.ServiceProxy("/mortal/registration/refine_pose", RefinePose)
        load = rospy.ServiceProxy("/mortal/registration/load_volume", LoadVolume)
        volumes = []
        rospy.Subscriber("/mortal/registration/volume", String, lambda message: volumes.append(message.data))

        def why_not():
            return refine(RefinementRequest()).result.reason

        with tempfile.TemporaryDirectory() as folder:
            ct = small_volume(folder)
            kept = os.path.join(folder, "kept")
            rospy.set_param("/mortal/registration", {"setup_file": rospy.get_param("/setup_file"), "source": "ct",
                                                     "data_folder": folder, "keep_for_restart": True})

            def start():
                process = subprocess.Popen([node, "__ns:=/mortal"], env={**os.environ, "ROS_HOME": kept})
                refine.wait_for_service(TIMEOUT)
                return process

            def end(process):
                process.kill()
                process.wait()
                # roscpp does not see within a call that who answers has died.
                self.wait_for(lambda: not alive("/mortal/registration"), "the master's knowing that it is gone")

            process = start()
            try:
                self.wait_for(lambda: "ct is absent" in why_not(), "the setup's CT: none")
                end(process)
                # Nobody has asked for another one yet.
                process = start()
                self.wait_for(lambda: "ct is absent" in why_not(), "the setup's CT again: none")
                self.assertEqual(load(os.path.basename(ct)).message, "loaded")
                self.wait_for(lambda: volumes == [ct], "the CT")
                end(process)
                process = start()
                self.wait_for(lambda: volumes == [ct, ct], "the same CT")
                end(process)
                files = [os.path.join(at, name) for at, _, names in os.walk(kept) for name in names]
                self.assertEqual(len(files), 1)
                os.truncate(files[0], 3)
                process = start()
                self.wait_for(lambda: "which CT it was told to load is not known" in why_not(), "what is wrong")
                end(process)
                # Another launch: maybe another patient.
                rospy.delete_param("/mortal/registration/restart_token")
                process = start()
                self.wait_for(lambda: "ct is absent" in why_not(), "the setup's CT of a new launch: none")
                self.assertEqual(volumes, [ct, ct])
                # Where it cannot be kept who asks is told.
                os.rmdir(os.path.dirname(files[0]))
                with open(os.path.dirname(files[0]), "w", encoding="utf-8"):
                    pass
                answer = load(ct)
                self.assertTrue(answer.success)
                self.assertIn("not kept for when the node dies", answer.message)
            finally:
                process.kill()
                process.wait()

    def test_mask_from_a_label_map(self):
        with tempfile.TemporaryDirectory() as folder:
            ct = small_volume(folder)
            parameters = {"from": "labels", "label": 4, "label_map": os.path.join(folder, "labels.nrrd"),
                          "file": os.path.join(folder, "mask.nrrd"), "inner_mm": 2.0, "outer_mm": 6.0}
            rospy.set_param("/labels/registration", {"setup_file": rospy.get_param("/setup_file"), "source": "ct",
                                                     "data_folder": folder, "mask": parameters})
            node = roslib.packages.find_node("xray_tracking_registration", "registration_node")[0]
            process = subprocess.Popen([node, "__ns:=/labels"])
            try:
                load = rospy.ServiceProxy("/labels/registration/load_volume", LoadVolume)
                load.wait_for_service(TIMEOUT)
                labels = np.zeros((40, 40, 40), np.int16)
                labels[10:14, 20:22, 15:25] = 4
                for wrong, words in ((labels[:30], "label map of 40 x 40 x 30 voxels"), (labels // 2, "label 4")):
                    write_volume(parameters["label_map"], wrong)
                    self.wait_for(lambda: words in load(ct).message, words)
                write_volume(parameters["label_map"], labels)
                answer = load(ct)
                self.assertTrue(answer.success, answer.message)
                weights = read_volume(parameters["file"])
                self.assertEqual(np.count_nonzero(weights == 1000), np.count_nonzero(labels))
                # One voxel of 4 mm around it is half way between 2 and 6 mm, what is farther away is the rest's.
                self.assertEqual(weights.shape, (4 + 4, 2 + 4, 10 + 4))
                self.assertEqual(weights[4, 3, 1], 500)
            finally:
                process.send_signal(signal.SIGINT)
                self.assertEqual(process.wait(20.0), 0)

    def test_mask_from_the_structure(self):
        """The target of the setup, a box of 16 x 8 x 40 mm on ten slices of a DICOM CT."""
        with tempfile.TemporaryDirectory() as folder:
            ct = os.path.join(folder, "ct")
            values = read_volume(small_volume(folder))
            write_dicom_ct(ct, values, "1.2.3.9")
            write_dicom_ct(os.path.join(folder, "other"), values, "1.2.3.10")
            contours = [[(-8, -4, z), (8, -4, z), (8, 4, z), (-8, 4, z)] for z in range(-18, 19, 4)]
            write_structure_set(os.path.join(folder, "rs.dcm"), "bone", contours, "1.2.3.9")
            detectors = os.path.join(os.path.dirname(rospy.get_param("/setup_file")), "geometry", "cyberknife.yaml")
            setup = os.path.join(folder, "setup.yaml")
            with open(setup, "w") as file:
                file.write(f"ct: ct\ntarget: {{rtstruct: rs.dcm, roi: bone}}\ndetectors: {detectors}\n"
                           "initial_pose: {translation_mm: [0, 0, 0], rotation_xyzw: [0, 0, 0, 1]}\n")
            mask = {"from": "roi", "file": os.path.join(folder, "mask.nrrd"), "inner_mm": 2.0, "outer_mm": 6.0}
            node = roslib.packages.find_node("xray_tracking_registration", "registration_node")[0]
            for name, setup_file in (("untargeted", rospy.get_param("/setup_file")), ("roi", setup)):
                rospy.set_param(f"/{name}/registration", {"setup_file": setup_file, "source": "ct", "data_folder": folder,
                                                          "mask": mask})
                process = subprocess.Popen([node, f"__ns:=/{name}"])
                try:
                    load = rospy.ServiceProxy(f"/{name}/registration/load_volume", LoadVolume)
                    load.wait_for_service(TIMEOUT)
                    if name == "untargeted":
                        self.wait_for(lambda: "mask/from is roi" in load(ct).message, "no target")
                        continue
                    self.wait_for(lambda: load(ct).success, "the CT")
                    weights = read_volume(mask["file"])
                    # Voxels' centres lie at 2, 6, 10 ... mm to either side; z, y, x as in test_mask_from_a_label_map.
                    self.assertEqual(np.count_nonzero(weights == 1000), 10 * 2 * 4)
                    self.assertEqual(weights.shape, (10 + 4, 2 + 4, 4 + 4))
                    message = load(os.path.join(folder, "other")).message
                    self.assertIn("1.2.3.9", message)
                    self.assertIn("1.2.3.10", message)
                finally:
                    process.send_signal(signal.SIGINT)
                    self.assertEqual(process.wait(20.0), 0)

    def test_shutdown_in_the_middle(self):
        rospy.set_param("/stopping/registration/setup_file", rospy.get_param("/setup_file"))
        node = roslib.packages.find_node("xray_tracking_registration", "registration_node")[0]
        process = subprocess.Popen([node, "__ns:=/stopping"])
        sender = Sender("stopping")
        sender.send(self.exposures[0], rospy.Time(100))
        refine = rospy.ServiceProxy("/stopping/registration/refine_pose", RefinePose)
        noise = RefinementRequest(seed=self.exposures[0].truth)
        for name in DETECTORS:
            image = self.exposures[0].images[name]
            values = np.random.default_rng(1).integers(3000, 50000, image.width * image.height, dtype=np.uint16)
            noise.images.append(type(image)(image.header, image.height, image.width, "mono16", 0, image.step,
                                            values.tobytes()))
            noise.camera_infos.append(self.exposures[0].camera_infos[name])
        asked, end = threading.Event(), threading.Event()

        def ask():
            while not end.is_set():
                try:
                    refine(noise)
                    asked.set()
                except rospy.ServiceException:
                    return

        threads = [threading.Thread(target=ask) for _ in range(2)]
        for thread in threads:
            thread.start()
        self.assertTrue(asked.wait(TIMEOUT))
        process.send_signal(signal.SIGINT)
        try:
            self.assertEqual(process.wait(20.0), 0)
        finally:
            process.kill()
            end.set()
        for thread in threads:
            thread.join(TIMEOUT)
            self.assertFalse(thread.is_alive())


if __name__ == "__main__":
    rospy.init_node("sequences_test")
    rostest.rosrun("xray_tracking_registration", "sequences", SequencesTest)
