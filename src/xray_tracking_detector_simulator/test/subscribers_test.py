#!/usr/bin/python3
"""Without wait_for_start the first exposure comes once every detector's image has a subscriber, and not before."""
import sys
import time
import unittest

import rospy
import rostest
from diagnostic_msgs.msg import DiagnosticArray
from sensor_msgs.msg import Image

TIMEOUT = 60.0


class SubscribersTest(unittest.TestCase):
    def wait_for(self, condition, what):
        deadline = time.monotonic() + TIMEOUT
        while not condition():
            self.assertLess(time.monotonic(), deadline, "no " + what)
            time.sleep(0.01)

    def test_starts_with_the_last_subscriber(self):
        states = []
        rospy.Subscriber("/diagnostics", DiagnosticArray, lambda m: states.append(m.status[0].message))
        images = {"detector_a": [], "detector_b": []}
        first = rospy.Subscriber("detector_a/image_raw", Image, images["detector_a"].append)
        self.wait_for(lambda: first.get_num_connections() > 0, "publisher")
        # Two reports after the connection: the second one is of a state that knew of it.
        seen = len(states)
        self.wait_for(lambda: len(states) >= seen + 2 and states[-1] == "waiting for the start", "waiting")
        self.assertEqual(images["detector_a"], [])

        rospy.Subscriber("detector_b/image_raw", Image, images["detector_b"].append)
        self.wait_for(lambda: states[-1] == "done" and all(len(m) >= 3 for m in images.values()), "exposures")
        stamps = [[image.header.stamp for image in messages] for messages in images.values()]
        self.assertEqual(len(stamps[0]), 3)
        self.assertEqual(stamps[0], stamps[1])


if __name__ == "__main__":
    rospy.init_node("subscribers_test")
    rostest.rosrun("xray_tracking_detector_simulator", "subscribers_test", SubscribersTest, sys.argv)
