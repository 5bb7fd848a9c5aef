#!/usr/bin/python3
"""What the simulator cannot work with is named, and its node lives on."""
import sys
import time
import unittest

import rospy
import rostest
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus
from std_srvs.srv import Trigger

# Namespace of the node: what its answer must name.
CASES = {
    "missing_ct": ["no_such_ct.nrrd"],
    "setup_without_ct": ["ct", "setup.yaml"],
    "missing_setup": ["no_such_setup.yaml"],
    "bad_option": ["image/blur_sigma_px", "-3"],
    "bad_type": ["rate", "number"],
    "bad_motion": ["no_such_poses.csv"],
}


class BadInputTest(unittest.TestCase):
    def test_reason_is_given_and_node_lives(self):
        errors = {}

        def on_diagnostics(message):
            for status in message.status:
                if status.level == DiagnosticStatus.ERROR:
                    errors[status.name] = status.message

        rospy.Subscriber("/diagnostics", DiagnosticArray, on_diagnostics)
        for namespace, words in CASES.items():
            start = rospy.ServiceProxy("/%s/simulator/start" % namespace, Trigger)
            start.wait_for_service(60.0)
            answer = start()
            deadline = time.monotonic() + 60.0
            while answer.message.startswith("not ready") and time.monotonic() < deadline:
                time.sleep(0.05)
                answer = start()
            # Again: the first failure has not ended the node.
            for reply in (answer, start()):
                self.assertFalse(reply.success, namespace)
                for word in words:
                    self.assertIn(word, reply.message, namespace)

        deadline = time.monotonic() + 60.0
        while len(errors) < len(CASES) and time.monotonic() < deadline:
            time.sleep(0.05)
        for namespace, words in CASES.items():
            text = [message for name, message in errors.items() if name.startswith(namespace + "/simulator")]
            self.assertEqual(len(text), 1, "diagnostics of %s: %s" % (namespace, errors))
            self.assertIn(words[0], text[0])
        images = [topic for topic, _ in rospy.get_published_topics() if topic.endswith("image_raw")]
        self.assertEqual(images, [])


if __name__ == "__main__":
    rospy.init_node("bad_input_test")
    rostest.rosrun("xray_tracking_detector_simulator", "bad_input_test", BadInputTest, sys.argv)
