#!/usr/bin/python3
"""Runs the supervisor as a process of its own, plays the graph around it, and judges exit status and output."""

import os
import subprocess
import tempfile
import time
import unittest

import roslib.packages
import rospy
import rostest
from geometry_msgs.msg import PoseWithCovarianceStamped
from sensor_msgs.msg import CameraInfo
from std_msgs.msg import Header
from std_srvs.srv import SetBool, SetBoolResponse, Trigger, TriggerResponse
from xray_tracking_msgs.msg import PatientMotion, RefinedPose, TrackedRegion

WAIT_S = 60.0


def executable(name):
    return roslib.packages.find_node("xray_tracking_tools", name)[0]


class Graph:
    """Publishers and the start service of one run, in a namespace of its own."""

    def __init__(self, namespace, service=Trigger, refusals=0):
        self.ns = "/" + namespace
        self.requests = []
        self.refusals = refusals
        self.motion = self.publisher("patient_motion", PatientMotion)
        self.pose = self.publisher("patient_pose", PoseWithCovarianceStamped)
        self.info = {d: self.publisher(d + "/camera_info", CameraInfo) for d in ("detector_a", "detector_b")}
        self.region = {d: self.publisher(d + "/tracked_region", TrackedRegion) for d in ("detector_a", "detector_b")}
        self.service = service and rospy.Service(self.ns + "/start", service, self.start)

    def publisher(self, topic, message_type):
        return rospy.Publisher(self.ns + "/" + topic, message_type, queue_size=100)

    def start(self, request):
        self.requests.append(request)
        success = len(self.requests) > self.refusals
        response = TriggerResponse if isinstance(request, Trigger._request_class) else SetBoolResponse
        return response(success=success, message="" if success else "still loading the CT")

    def supervise(self, env=None, **parameters):
        for name, value in parameters.items():
            rospy.set_param(self.ns + "/run_supervisor/" + name, value)
        return subprocess.Popen([executable("run_supervisor"), "__ns:=" + self.ns], stdout=subprocess.PIPE,
                                stderr=subprocess.STDOUT, universal_newlines=True, env=env)

    def expose(self, k, silent=(), state=PatientMotion.OK):
        stamp = rospy.Time(10 + k)
        for detector in set(self.info) - set(silent):
            self.info[detector].publish(CameraInfo(header=header(stamp)))
            self.region[detector].publish(TrackedRegion(header=header(stamp), state=TrackedRegion.TRACKING,
                                                        correlation=0.975))
        if not silent:
            motion = PatientMotion(header=header(stamp), state=state)
            motion.translation.x, motion.translation.y = 0.003, 0.004
            self.motion.publish(motion)


def header(stamp):
    return Header(stamp=stamp)


class RunSupervisorTest(unittest.TestCase):
    def wait_for(self, condition, what):
        deadline = time.time() + WAIT_S
        while not condition():
            self.assertLess(time.time(), deadline, "no " + what)
            time.sleep(0.02)

    def end_of(self, process):
        output, _ = process.communicate(timeout=WAIT_S)
        return process.returncode, output

    def test_success(self):
        graph = Graph("success", refusals=2)
        process = graph.supervise(exposures=5)
        self.wait_for(lambda: len(graph.requests) == 3, "third call of start")
        for k in range(4):
            graph.expose(k)
        graph.expose(3)  # a repeated stamp is no new exposure
        time.sleep(2.0)
        self.assertIsNone(process.poll(), "ended before the last exposure")
        graph.expose(4)
        status, output = self.end_of(process)
        self.assertEqual(status, 0, output)
        self.assertIn("exposure 1 / 5: OK, tracked, displacement 5.00 mm", output)
        self.assertIn("exposure 5 / 5: OK", output)
        self.assertIn("all 5 exposures were answered", output)

    def test_a_clock_that_is_set_neither_ends_a_run_nor_makes_it_endless(self):
        library = os.path.join(os.path.dirname(executable("run_supervisor")), "xray_tracking_tools_set_clock_test")
        for hours in (1, -1):
            with self.subTest(hours=hours), tempfile.TemporaryDirectory() as folder:
                set_by = os.path.join(folder, "seconds")
                env = dict(os.environ, SET_CLOCK_BY=set_by,
                           LD_PRELOAD=os.environ.get("LD_PRELOAD", "") + " " + library)
                graph = Graph("set_forward" if hours > 0 else "set_back")
                process = graph.supervise(env, exposures=1, stall_timeout=WAIT_S if hours > 0 else 5.0)
                self.wait_for(lambda: graph.requests, "call of start")
                time.sleep(1.0)
                with open(set_by, "w") as file:
                    file.write(str(3600 * hours))
                if hours > 0:
                    time.sleep(2.0)
                    self.assertIsNone(process.poll(), "ended before the exposure")
                    graph.expose(0)
                try:
                    status, output = self.end_of(process)
                finally:
                    process.kill()
                self.assertIn("all 1 exposures" if hours > 0 else "no new patient_motion for 5.0 s", output)
                self.assertEqual(status, 0 if hours > 0 else 1, output)

    def test_an_exposure_that_is_not_registered_is_told_as_such(self):
        graph = Graph("unregistered")
        process = graph.supervise(exposures=1)
        self.wait_for(lambda: len(graph.requests) == 1, "call of start")
        graph.expose(0, state=PatientMotion.UNREGISTERED)
        status, output = self.end_of(process)
        self.assertEqual(status, 0, output)
        self.assertIn("exposure 1 / 1: UNREGISTERED", output)

    def test_start_waits_for_the_subscriber(self):
        graph = Graph("waiting")
        # As roslaunch does, a name at a time: the parameter server nests what has slashes.
        rospy.set_param(graph.ns + "/run_supervisor/required_subscribers/detector_a/tracked_region", ["late_listener"])
        rospy.set_param(graph.ns + "/run_supervisor/required_subscribers/patient_pose", ["late_listener"])
        process = graph.supervise(exposures=1)
        time.sleep(3.0)
        self.assertEqual(len(graph.requests), 0, "started although nobody listened")
        listener = subprocess.Popen([executable("treatment_room_publisher"), "__ns:=" + graph.ns,
                                     "__name:=late_listener", "_setup_file:=" + rospy.get_param("/setup_file")])
        try:
            self.wait_for(lambda: len(graph.requests) == 1, "call of start")
            self.assertEqual(graph.pose.get_num_connections(), 1)
            self.assertEqual(graph.region["detector_a"].get_num_connections(), 2)  # and the supervisor
            graph.expose(0)
            status, output = self.end_of(process)
            self.assertEqual(status, 0, output)
        finally:
            listener.terminate()
            listener.wait()

    def test_playback(self):
        graph = Graph("playback", service=SetBool)
        process = graph.supervise(exposures=1, start_mode="playback")
        self.wait_for(lambda: len(graph.requests) == 1, "call of pause_playback")
        self.assertFalse(graph.requests[0].data)
        graph.expose(0)
        status, output = self.end_of(process)
        self.assertEqual(status, 0, output)

    def test_stall_names_the_silent_detector(self):
        graph = Graph("stall")
        process = graph.supervise(exposures=6, stall_timeout=3.0)
        self.wait_for(lambda: len(graph.requests) == 1, "call of start")
        for k in range(6):
            graph.expose(k, silent=("detector_b",) if k >= 2 else ())
        status, output = self.end_of(process)
        self.assertEqual(status, 1, output)
        self.assertIn("stalled: 2 of 6 exposures were answered", output)
        self.assertIn("detector_a: 6 exposures, 6 tracked regions\n", output)
        self.assertIn("detector_b: 2 exposures (detector_b/camera_info fell silent), 2 tracked regions", output)

    def test_stall_before_the_start_names_what_is_missing(self):
        # Nobody publishes for this one at all.
        rospy.set_param("/alone/run_supervisor", {"exposures": 6, "stall_timeout": 1.0})
        alone = subprocess.run([executable("run_supervisor"), "__ns:=/alone"], stdout=subprocess.PIPE, timeout=WAIT_S,
                               universal_newlines=True, check=False)
        self.assertEqual(alone.returncode, 1, alone.stdout)
        self.assertIn("/alone/detector_b/camera_info has no publisher", alone.stdout)

        graph = Graph("no_service", service=None)
        status, output = self.end_of(graph.supervise(exposures=6, stall_timeout=2.0))
        self.assertEqual(status, 1, output)
        self.assertIn("never started: service /no_service/start is not there", output)

        graph = Graph("no_listener")
        status, output = self.end_of(graph.supervise(
            exposures=6, stall_timeout=2.0,
            required_subscribers={"patient_pose": ["nobody"], "nothing": ["nobody"]}))
        self.assertEqual(status, 1, output)
        self.assertIn("/no_listener/nothing has no publisher", output)
        self.assertIn("/no_listener/patient_pose from /run_supervisor_test does not reach /no_listener/nobody", output)
        self.assertEqual(len(graph.requests), 0)

    def test_a_misspelt_parameter_is_named(self):
        graph = Graph("misspelt")
        rospy.set_param(graph.ns + "/run_supervisor/required_subscribers/patient_pose", ["nobody"])
        status, output = self.end_of(graph.supervise(exposures=6, stall_timeout=1.0, stal_timeout=300.0))
        self.assertEqual(status, 1, output)
        self.assertIn("parameter /misspelt/run_supervisor/stal_timeout is set, but there is none of this name", output)
        self.assertEqual(output.count("there is none of this name"), 1, output)

    def test_bad_parameters(self):
        cases = [({}, "~exposures is 0"), ({"exposures": -3}, "~exposures is -3"),
                 ({"exposures": 3, "start_mode": "both"}, "~start_mode is 'both'"),
                 ({"exposures": 3, "stall_timeout": 0.0}, "~stall_timeout is 0"),
                 ({"exposures": 3, "detectors": []}, "~detectors is empty"),
                 # Of the wrong type; a text that reads like a number is none.
                 ({"exposures": "3"}, "run_supervisor/exposures is 3, expected a whole number"),
                 ({"exposures": 3, "stall_timeout": "long"}, "stall_timeout is long, expected a number"),
                 ({"exposures": 3, "start_mode": 1}, "start_mode is 1, expected a text"),
                 ({"exposures": 3, "start_service": 7}, "start_service is 7, expected a text"),
                 ({"exposures": 3, "detectors": "detector_a"}, "detectors is detector_a, expected a list of texts"),
                 ({"exposures": 3, "detectors": ["a", 5]}, "expected a list of texts"),
                 ({"exposures": 3, "required_subscribers": ["a"]}, "~required_subscribers is not a map"),
                 ({"exposures": 3, "required_detector_subscribers": ["a"]},
                  "~required_detector_subscribers is not a map"),
                 ({"exposures": 3, "required_subscribers": {"a": 5}}, "~required_subscribers/a is not a list")]
        for i, (parameters, message) in enumerate(cases):
            status, output = self.end_of(Graph("bad_%d" % i, service=None).supervise(**parameters))
            self.assertEqual(status, 1, output)
            self.assertIn(message, output)


if __name__ == "__main__":
    rospy.init_node("run_supervisor_test")
    rostest.rosrun("xray_tracking_tools", "run_supervisor", RunSupervisorTest)
