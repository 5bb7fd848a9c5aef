#!/usr/bin/python3
"""A detector pair as it should not be: exposures at a rate, in real time, some of them dropped, delayed or sent twice.
What the node makes of every single one is judged, and that it keeps its size."""

import heapq
import os
import random
import sys
import time
import xmlrpc.client

import numpy as np
import rosgraph
import rospy
import rostest
from xray_tracking_msgs.msg import BeamGate, PatientMotion

sys.path.insert(0, os.path.dirname(os.path.abspath(__file__)))
from estimation_graph import LiveTestCase  # noqa: E402

INTERVAL = 1.0 / 30.0  # s
DROPPED = 0.03
TWICE = 0.05
DELAYED = 0.05
SILENCE_EVERY = 300  # exposures, after which nothing comes for half a second


def breathing(seconds):
    """Within the gate's tolerance of 3 mm."""
    return np.array([2.0, 0.5, 1.0]) * np.sin(2 * np.pi * seconds / 4.0) ** 2


class StressTest(LiveTestCase):
    def resident(self):
        """Of the node's process [kB]."""
        uri = rosgraph.Master(rospy.get_name()).lookupNode('/motion_estimation')
        pid = xmlrpc.client.ServerProxy(uri).getPid(rospy.get_name())[2]
        with open('/proc/%d/status' % pid, encoding='utf-8') as file:
            return next(int(line.split()[1]) for line in file if line.startswith('VmRSS'))

    def test_stream(self):
        exposures = rospy.get_param('~exposures')
        graph = self.graph
        chance = random.Random(1)
        # What is under way to a view: (when it arrives, number, view, message); bad luck by a fixed seed.
        queue, number, sent_views, sizes = [], 0, {}, []
        start = time.time()
        next_index = 0
        while next_index < exposures or queue:
            now = time.time() - start
            while next_index < exposures and next_index * INTERVAL <= now:
                if next_index % SILENCE_EVERY >= 15:
                    stamp = rospy.Time.now().to_nsec()
                    for view, detector in enumerate(graph.detectors):
                        if chance.random() < DROPPED:
                            continue
                        message = graph.region(detector, stamp, breathing(now), self.reference, np.zeros(3))
                        delay = chance.uniform(0.0, 0.3) if chance.random() < DELAYED else 0.0
                        sent_views.setdefault(stamp, set()).add(view)
                        for _ in range(2 if chance.random() < TWICE else 1):
                            heapq.heappush(queue, (now + delay, number, view, message))
                            number += 1
                if next_index % 300 == 150:
                    sizes.append(self.resident())
                next_index += 1
            while queue and queue[0][0] <= now:
                _, _, view, message = heapq.heappop(queue)
                graph.regions[view].publish(message)
            time.sleep(0.002)
        rospy.sleep(1.0)

        with graph.changed:
            motions, poses, transforms = dict(graph.motions), dict(graph.poses), dict(graph.transforms)
            gates = list(graph.gates)
        whole = {stamp for stamp, views in sent_views.items() if len(views) == len(graph.detectors)}
        answered = set(motions) & set(sent_views)
        self.assertLessEqual(answered, whole)
        # What is delayed beyond the exposures that follow is dropped, nothing else.
        self.assertGreater(len(answered), 0.85 * len(whole))
        for stamp in answered:
            self.assertEqual(motions[stamp][0].state, PatientMotion.OK)
        for received in (motions, poses, transforms):
            self.assertFalse([s for s, messages in received.items() if len(messages) > 1], 'stamps used twice')
        self.assertEqual(set(transforms), set(poses))
        self.assertEqual(answered, set(poses) & set(sent_views))

        opened = [gate for gate in gates if gate.open]
        self.assertGreater(len(opened), 0.3 * len(gates))
        for gate in opened:
            self.assertLess(gate.age.to_sec(), gate.max_age.to_sec() + 1e-3)
            self.assertLess((gate.header.stamp - gate.exposure).to_sec(), gate.max_age.to_sec() + 0.02)
            self.assertIn(gate.exposure.to_nsec(), poses)
        self.assertTrue(any(gate.reason == BeamGate.STALE for gate in gates))
        print('%d exposures, %d whole, %d answered; gate open %.1f %% of the time; resident kB %s' % (
            exposures, len(whole), len(answered), 100.0 * len(opened) / len(gates), sizes[::max(1, len(sizes) // 10)]))
        # From when all buffers have been used; allocators and logs may breathe.
        if len(sizes) > 4:
            self.assertLess(sizes[-1] - sizes[len(sizes) // 2], 1000)


if __name__ == '__main__':
    rospy.init_node('stress_test')
    rostest.rosrun('xray_tracking_motion_estimation', 'stress', StressTest)
