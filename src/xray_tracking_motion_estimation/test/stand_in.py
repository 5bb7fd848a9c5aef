#!/usr/bin/python3
"""What the tests of the node have in the registration's place."""

import threading

import numpy as np
import rospy
from geometry_msgs.msg import Point, Quaternion
from xray_tracking_msgs.msg import RefinementResult
from xray_tracking_msgs.srv import RefinePose, RefinePoseResponse

from estimation_graph import TIMEOUT, rotation_from_xyzw, xyzw_from_rotation


class StandIn:
    """The service: shifts the target by `shift` [m] and turns it by `turn`; answers while `hold` is set."""

    def __init__(self, graph):
        rotation = rotation_from_xyzw(graph.quaternion)
        self.target = rotation.T.dot(graph.target - graph.translation) / 1000.0
        self.requests = []
        self.hold = threading.Event()
        self.hold.set()
        self.alter = lambda result: None
        self.shift, self.turn = np.zeros(3), np.eye(3)
        self.service = None

    def start(self):
        self.service = rospy.Service('refine_pose', RefinePose, self.refine)

    def refine(self, message):
        request = message.request
        self.requests.append(request)
        self.hold.wait(TIMEOUT)
        result = RefinementResult(status=RefinementResult.SUCCESS, reason='converged', similarity_before=0.5,
                                  similarity_after=0.8)
        q, t = request.seed.orientation, request.seed.position
        rotation = rotation_from_xyzw([q.x, q.y, q.z, q.w])
        target = rotation.dot(self.target) + [t.x, t.y, t.z]
        turned = self.turn.dot(rotation)
        result.pose.pose.position = Point(*(target + self.shift - turned.dot(self.target)))
        result.pose.pose.orientation = Quaternion(*xyzw_from_rotation(turned))
        result.pose.covariance = np.diag([1e-8] * 3 + [1e-6] * 3).ravel()
        self.alter(result)
        return RefinePoseResponse(result)
