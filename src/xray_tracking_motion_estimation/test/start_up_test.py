#!/usr/bin/python3
"""Trackers that learn while nodes still start: a statement about the initial pose is one about their first templates."""

import os
import sys

import numpy as np
import rospy
import rostest
from tf2_msgs.msg import TFMessage
from xray_tracking_msgs.msg import BeamGate, PatientMotion

sys.path.insert(0, os.path.dirname(os.path.abspath(__file__)))
from estimation_graph import NANOSECONDS, EstimationTestCase, Graph  # noqa: E402

APART = float(sys.argv[1])  # s, between the two views' first templates


class StartUpTest(EstimationTestCase):
    @classmethod
    def setUpClass(cls):
        """Templates of exposures that nobody has heard of but the trackers."""
        graph = cls.graph = Graph()
        learnt = rospy.Time.now().to_nsec() - NANOSECONDS
        cls.references = [learnt, learnt + int(APART * NANOSECONDS)]
        graph.connect()
        graph.tf_static.publish(TFMessage([d.transform() for d in graph.detectors]))

    def test_what_was_stated_holds(self):
        graph, reasons, covariance = self.graph, [], None
        for _ in range(60):
            for detector, publisher in zip(graph.detectors, graph.infos):
                publisher.publish(detector.camera_info())
            stamp = rospy.Time.now().to_nsec()
            for detector, publisher, reference in zip(graph.detectors, graph.regions, self.references):
                publisher.publish(graph.region(detector, stamp, np.zeros(3), reference, np.zeros(3)))
            graph.wait_for(lambda s=stamp: s in graph.motions, 'answer')
            answer = graph.motions[stamp][0]
            if answer.state == PatientMotion.OK:
                covariance = np.array(answer.covariance)
                with graph.changed:
                    reasons.append(graph.gates[-1].reason)
            rospy.sleep(0.05)
        self.assertNotIn(BeamGate.UNVERIFIED, reasons[3:])
        # 15 mm/s of target_speed, and a millimetre of tissue.
        self.assertGreater(1e6 * covariance[0], (15.0 * APART) ** 2)
        self.assertEqual(graph.gates[-1].open, APART < 0.05, graph.gates[-1].text)


if __name__ == '__main__':
    rospy.init_node('start_up_test')
    rostest.rosrun('xray_tracking_motion_estimation', 'start_up', StartUpTest)
