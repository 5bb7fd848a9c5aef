"""What the tests of the whole graph share."""
import os
import threading
import time
import unittest
import xmlrpc.client

import numpy as np
import rosgraph
import rospkg
import rospy
from diagnostic_msgs.msg import DiagnosticArray
import yaml
from geometry_msgs.msg import PoseStamped, PoseWithCovarianceStamped
from std_srvs.srv import Trigger
from tf2_msgs.msg import TFMessage
from xray_tracking_msgs.msg import BeamGate, PatientMotion, TrackedRegion

DETECTORS = ("detector_a", "detector_b")


def matrix(position, orientation):
    """4 x 4 matrix [m] of a message's position and unit quaternion."""
    x, y, z, w = orientation.x, orientation.y, orientation.z, orientation.w
    result = np.eye(4)
    result[:3, :3] = [
        [1 - 2 * (y * y + z * z), 2 * (x * y - z * w), 2 * (x * z + y * w)],
        [2 * (x * y + z * w), 1 - 2 * (x * x + z * z), 2 * (y * z - x * w)],
        [2 * (x * z - y * w), 2 * (y * z + x * w), 1 - 2 * (x * x + y * y)],
    ]
    result[:3, 3] = position.x, position.y, position.z
    return result


def target_registration_error_mm(estimate, gold, box_mm):
    """Eq. (9) over a grid of the box's points."""
    axes = [np.linspace(low, high, 5) / 1000.0 for low, high in zip(*box_mm)]
    points = np.stack(np.meshgrid(*axes, [1.0], indexing="ij"), -1).reshape(-1, 4).T
    return 1000.0 * np.sqrt(np.mean(np.sum(((estimate - gold) @ points)[:3] ** 2, axis=0)))


class GraphTestCase(unittest.TestCase):
    """Collects what the graph says, by stamp."""
    detectors = DETECTORS
    kills = False  # nodes; one that dies by itself is a failure although it comes back

    @classmethod
    def setUpClass(cls):
        cls.processes = {}  # node -> number, once the graph was there
        cls.lock = threading.Lock()
        cls.poses, cls.gold, cls.tf, cls.motions = {}, {}, {}, {}
        cls.regions = {name: {} for name in cls.detectors}
        cls.tf_count = 0
        cls.gates = []
        cls.diagnosis = {}  # motion_estimation's latest
        cls.subscribers = [
            rospy.Subscriber("patient_pose", PoseWithCovarianceStamped, cls._pose, queue_size=1000),
            rospy.Subscriber("patient_ground_truth", PoseStamped, cls._gold, queue_size=1000),
            rospy.Subscriber("patient_motion", PatientMotion, cls._motion, queue_size=1000),
            rospy.Subscriber("beam_gate", BeamGate, cls.gates.append, queue_size=1000),
            rospy.Subscriber("/tf", TFMessage, cls._tf, queue_size=1000),
            rospy.Subscriber("/diagnostics", DiagnosticArray, cls._diagnostics, queue_size=1000),
        ] + [
            rospy.Subscriber(f"{name}/tracked_region", TrackedRegion, cls._region, callback_args=name, queue_size=1000)
            for name in cls.detectors
        ]

    def tearDown(self):
        if not self.kills:
            self.assertEqual({name: self.process_of(name) for name in self.processes}, self.processes)

    @classmethod
    def _pose(cls, message):
        with cls.lock:
            cls.poses[message.header.stamp] = matrix(message.pose.pose.position, message.pose.pose.orientation)

    @classmethod
    def _gold(cls, message):
        with cls.lock:
            cls.gold[message.header.stamp] = matrix(message.pose.position, message.pose.orientation)

    @classmethod
    def _motion(cls, message):
        with cls.lock:
            cls.motions[message.header.stamp] = message

    @classmethod
    def _region(cls, message, name):
        with cls.lock:
            cls.regions[name][message.header.stamp] = message

    @classmethod
    def _tf(cls, message):
        with cls.lock:
            for transform in message.transforms:
                if transform.child_frame_id == "patient":
                    cls.tf_count += 1
                    cls.tf[transform.header.stamp] = matrix(transform.transform.translation,
                                                            transform.transform.rotation)

    @classmethod
    def _diagnostics(cls, message):
        with cls.lock:
            for status in message.status:
                if "motion_estimation" in status.name:
                    cls.diagnosis = {entry.key: entry.value for entry in status.values}

    def refinements(self, outcome):
        """How many were `accepted`, `refused` or `without an answer`."""
        return int(self.diagnosis.get(f"refinements {outcome}", 0))

    def verified(self):
        """Stamps of the exposures whose poses the gate took for verified."""
        return {gate.exposure for gate in list(self.gates) if gate.verified} & set(self.motions)

    def assert_never_verified(self, words):
        self.assertEqual(self.verified(), set())
        self.assertFalse(any(gate.open for gate in self.gates))
        texts = [gate.text for gate in self.gates if gate.reason == BeamGate.UNVERIFIED]
        self.assertTrue(texts)
        self.assertIn(words, texts[-1])

    def wait_for(self, condition, timeout, what):
        """Waits in wall time, so also while a bag's clock stands."""
        end = time.monotonic() + timeout
        while time.monotonic() < end:
            with self.lock:
                if condition():
                    return
            time.sleep(0.05)
        self.fail(f"not within {timeout} s: {what}")

    def wait_for_subscribers(self, topics):
        """topics: topic -> names of the nodes that must have subscribed to it and be connected to all who publish it.
        Being registered is not enough: connections take a moment, and what is sent meanwhile is lost."""
        master = rosgraph.Master(rospy.get_name())

        def reached(publisher):
            """(topic, node) of what a publisher is connected to."""
            try:
                _, _, entries = xmlrpc.client.ServerProxy(master.lookupNode(publisher)).getBusInfo(rospy.get_name())
            except (rosgraph.MasterException, OSError):
                return set()
            return {(topic, node) for _, node, direction, _, topic, *_ in entries if direction == "o"}

        def ready():
            publishers, subscribers, _ = (dict(entries) for entries in master.getSystemState())
            senders = {name for topic in topics for name in publishers.get(topic, [])}
            connections = {name: reached(name) for name in senders}
            return all(node in subscribers.get(topic, []) and
                       all((topic, node) in connections[name] for name in publishers.get(topic, []))
                       for topic, nodes in topics.items() for node in nodes)

        self.wait_for(ready, 60.0, f"subscribers of {topics}")

    def wait_for_graph(self):
        me = rospy.get_name()
        # Names of the namespace that this test and the graph are in.
        name = rospy.resolve_name
        estimation = name("motion_estimation")
        topics = {name("patient_pose"): [me], name("patient_motion"): [me], name("patient_ground_truth"): [me],
                  "/tf": [me], "/tf_static": [estimation]}
        for detector in self.detectors:
            topics[name(f"{detector}/image_raw")] = [name("xray_nodelets")]
            topics[name(f"{detector}/camera_info")] = [estimation]
            topics[name(f"{detector}/tracked_region")] = [estimation, me]
        self.wait_for_subscribers(topics)
        self.processes.update((node, self.process_of(node)) for node in map(name, (
            "motion_estimation", "xray_nodelets", "treatment_room_publisher")))

    def wait_for_listeners(self, node, topics):
        """Until messages of `node` reach, over a connection that stands, whom they must; topics as above."""
        master = rosgraph.Master(rospy.get_name())
        wanted = {(topic, listener) for topic, listeners in topics.items() for listener in listeners}

        def ready():
            try:
                server = xmlrpc.client.ServerProxy(master.lookupNode(node))
                entries = server.getBusInfo(rospy.get_name())[2]
            except (rosgraph.MasterException, OSError):
                return False
            return wanted <= {(entry[4], entry[1]) for entry in entries if entry[2] == "o"}

        self.wait_for(ready, 60.0, f"{node} reaches {topics}")

    @staticmethod
    def process_of(node):
        """Its number."""
        server = xmlrpc.client.ServerProxy(rosgraph.Master(rospy.get_name()).lookupNode(node))
        return server.getPid(rospy.get_name())[2]

    def start_simulator(self):
        start = rospy.ServiceProxy("detector_simulator/start", Trigger)
        start.wait_for_service(60.0)
        self.wait_for(lambda: start().success, 60.0, "start of the simulator")

    def phantom_errors_mm(self, exposures):
        """Has the simulator make so many exposures of the phantom. @return their TRE"""
        setup_path = os.path.join(rospkg.RosPack().get_path("xray_tracking_core"), "config", "phantom_neck.yaml")
        with open(setup_path, encoding="utf-8") as file:
            box = yaml.safe_load(file)["target_box_mm"]
        self.wait_for_graph()
        self.start_simulator()
        self.wait_for(lambda: min(len(self.motions), len(self.poses), len(self.tf)) >= exposures, 90.0,
                      "all exposures answered")
        self.assertEqual(len(self.gold), exposures)
        return self.errors_mm((box["min"], box["max"]))

    def errors_mm(self, box_mm):
        """TRE of every exposure, in order of time; fails if an exposure has no pose."""
        with self.lock:
            missing = sorted(set(self.gold) - set(self.poses))
            self.assertEqual(missing, [], [self.motions[s].reason for s in missing if s in self.motions])
            return np.array([target_registration_error_mm(self.poses[stamp], self.gold[stamp], box_mm)
                             for stamp in sorted(self.gold)])
