#!/usr/bin/python3
"""One detector falls silent: no pose while it is, the rest of the graph lives, and poses come back with it."""
import os
import sys
import time

import rosnode
import rospy
import rostest
from sensor_msgs.msg import Image

sys.path.insert(0, os.path.dirname(os.path.abspath(__file__)))
from graph_test_case import GraphTestCase  # noqa: E402


class SilentDetectorTest(GraphTestCase):
    def test_no_pose_while_a_detector_is_silent(self):
        relayed = rospy.Publisher("detector_b/image_raw", Image, queue_size=10)
        self.relay = True
        rospy.Subscriber("held_back/image_raw", Image, lambda image: self.relay and relayed.publish(image),
                         queue_size=10)
        self.wait_for_graph()
        self.wait_for(lambda: relayed.get_num_connections() > 0, 60.0, "the tracker of detector_b")
        self.start_simulator()
        self.wait_for(lambda: len(self.poses) >= 5, 60.0, "poses while both detectors work")

        self.relay = False
        answered = len(self.regions["detector_a"])
        time.sleep(0.5)  # what was under way when the relay closed
        poses = len(self.poses)
        self.wait_for(lambda: len(self.regions["detector_a"]) >= answered + 12, 60.0, "detector_a goes on")
        self.assertEqual(len(self.poses), poses, "a pose without the second view")
        self.assertEqual(len(self.tf), poses)
        for node in ("/xray_nodelets", "/motion_estimation", "/treatment_room_publisher"):
            self.assertTrue(rosnode.rosnode_ping(node, max_count=1, verbose=False), f"{node} is dead")

        self.relay = True
        self.wait_for(lambda: len(self.poses) >= poses + 5, 60.0, "poses after the detector's return")


if __name__ == "__main__":
    rospy.init_node("silent_detector_test")
    rostest.rosrun("xray_tracking_bringup", "silent_detector", SilentDetectorTest)
