#!/usr/bin/python3
"""Nodes with parameters that they cannot work with say so in diagnostics, again and again, and stay alive."""

import subprocess
import threading
import unittest

import roslib.packages
import rospy
import rostest
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus
from xray_tracking_msgs.msg import BeamGate

TIMEOUT = 60.0  # s
EXPECTED = {  # node: what the message has to name
    'no_setup_file': ['/no_setup_file/setup_file', 'is not set'],
    'missing_setup_file': ['/nowhere/setup.yaml'],
    'unknown_method': ['method', 'guessing', 'tracking_and_registration'],
    'unknown_estimation': ['estimation_method', 'guessing', 'least_squares'],
    'no_deadline': ['pose/deadline', '-1', '0 to 10 s'],
    'never_asked': ['refinement/mode', 'never', 'registration'],
    'wrong_type': ['/wrong_type/floor_sigma', 'half a pixel', 'a number'],
    'out_of_range': ['significance', '2', '(0, 1)'],
    'one_detector': ['the length of detectors', 'is 1', '2 to 16'],
    'too_many_detectors': ['the length of detectors', 'is 17', '2 to 16'],
    'no_topic_name': ['detector a'],
    'no_time': ['gate/max_unverified_time', 'is 0', 'a number > 0 s'],
    'no_exposure': ['gate/max_unverified_exposures', '0.5', '>= 1'],
    'no_silence': ['gate/operator_silence', 'is 0', 'a number > 0 s'],
    'no_statement': ['/no_statement/gate/initial_pose_verified', 'perhaps', 'true or false'],
    'nodelet_missing_setup_file': ['/nowhere/setup.yaml'],
}


class BadParametersTest(unittest.TestCase):
    def test_every_node_reports_and_lives(self):
        changed = threading.Condition()
        reports = {name: [] for name in EXPECTED}

        def diagnostics_cb(message):
            with changed:
                for status in message.status:
                    name = status.name.split(':')[0]
                    # Updaters say first that they start up.
                    if name in reports and status.name.endswith(': motion') and status.level != DiagnosticStatus.OK:
                        reports[name].append(status)
                changed.notify_all()

        gates = []
        gate_subscriber = rospy.Subscriber('beam_gate', BeamGate, gates.append)
        subscriber = rospy.Subscriber('/diagnostics', DiagnosticArray, diagnostics_cb)
        # Three reports of each: alive well after the failure.
        with changed:
            complete = changed.wait_for(lambda: all(len(r) >= 3 for r in reports.values()), TIMEOUT)
        subscriber.unregister()
        gate_subscriber.unregister()
        self.assertTrue(complete, {name: len(r) for name, r in reports.items()})
        for name, words in EXPECTED.items():
            for status in reports[name]:
                self.assertEqual(status.level, DiagnosticStatus.ERROR)
                for word in words:
                    self.assertIn(word, status.message)
        self.assertTrue(gates)
        self.assertEqual({gate.reason for gate in gates}, {BeamGate.NO_EXPOSURE})

    def test_a_misspelt_parameter_is_named(self):
        rospy.set_param('/misspelt/flor_sigma', 0.7)
        node = roslib.packages.find_node('xray_tracking_motion_estimation', 'motion_estimation_node')[0]
        process = subprocess.Popen([node, '__name:=misspelt'], stderr=subprocess.PIPE, text=True)
        # The test's time limit bounds this.
        line = next(line for line in process.stderr if 'WARN' in line or 'FATAL' in line)
        process.terminate()
        process.communicate()
        self.assertIn('/misspelt/flor_sigma', line)


if __name__ == '__main__':
    rospy.init_node('bad_parameters_test')
    rostest.rosrun('xray_tracking_motion_estimation', 'bad_parameters', BadParametersTest)
