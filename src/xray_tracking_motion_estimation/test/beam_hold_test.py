#!/usr/bin/python3
"""People hold the beam: by the service, or by a panel that falls silent. Exposures are good all the time."""

import os
import sys
import time

import numpy as np
import rospy
import rostest
from std_msgs.msg import Header
from std_srvs.srv import SetBool
from xray_tracking_msgs.msg import BeamGate

sys.path.insert(0, os.path.dirname(os.path.abspath(__file__)))
from estimation_graph import LiveTestCase  # noqa: E402

STILL = np.zeros(3)
SILENCE = 1.0  # s, the parameter's default


class BeamHoldTest(LiveTestCase):
    @classmethod
    def setUpClass(cls):
        super().setUpClass()
        cls.hold_beam = rospy.ServiceProxy('motion_estimation/hold_beam', SetBool)
        cls.hold_beam.wait_for_service(60.0)

    def expose(self, until, heartbeat=None, timeout=60.0):
        """Good exposures until the gate is as wanted; returns what the gate said of each."""
        gates = []
        end = time.monotonic() + timeout
        while time.monotonic() < end:
            if heartbeat:
                heartbeat.publish(Header())
            gates.append(self.live(STILL)[1])
            if until(gates[-1]):
                return gates
            rospy.sleep(0.05)
        self.fail('the gate says %s' % gates[-1])

    def test_a_hold_lasts_until_it_is_released(self):
        self.expose(lambda gate: gate.open)
        answer = self.hold_beam(True)
        self.assertTrue(answer.success, answer.message)
        asked = rospy.Time.now()
        for _ in range(30):
            gate = self.live(STILL)[1]
            self.assertFalse(gate.open)
            self.assertEqual(gate.reason, BeamGate.HELD)
            self.assertIn('held by an operator; otherwise: ', gate.text)
            rospy.sleep(0.05)
        # Nothing open was sent after the answer, the watchdog's included.
        with self.graph.changed:
            self.assertFalse([g for g in self.graph.gates if g.open and g.header.stamp > asked])
        answer = self.hold_beam(False)
        self.assertTrue(answer.success, answer.message)
        self.expose(lambda gate: gate.open)

    def test_z_a_panel_that_is_lost_holds_the_beam(self):
        """The last of the tests: from here on a panel is missed."""
        panel = rospy.Publisher('operator_present', Header, queue_size=1)
        self.graph.wait_for(lambda: panel.get_num_connections() > 0, 'connection of the panel')
        # Longer than the silence, so that a panel heard once only would be missed already.
        start = time.monotonic()
        gates = self.expose(lambda gate: time.monotonic() > start + 2 * SILENCE and gate.open, panel)
        self.assertNotIn(BeamGate.HELD, [gate.reason for gate in gates])
        lost = time.monotonic()
        gates = self.expose(lambda gate: gate.reason == BeamGate.HELD)
        elapsed = time.monotonic() - lost
        # 0.3 s of a busy machine; earlier by the exposure before it.
        self.assertGreater(elapsed, SILENCE - 0.2)
        self.assertLess(elapsed, SILENCE + 0.3)
        self.assertIn("the operator's panel was silent", gates[-1].text)
        answer = self.hold_beam(False)
        self.assertFalse(answer.success)
        self.assertIn('still silent', answer.message)
        # A panel that comes back releases nothing by itself.
        start = time.monotonic()
        gates = self.expose(lambda gate: time.monotonic() > start + 2 * SILENCE, panel)
        self.assertEqual({gate.reason for gate in gates}, {BeamGate.HELD})
        answer = self.hold_beam(False)
        self.assertTrue(answer.success, answer.message)
        self.expose(lambda gate: gate.open, panel)


if __name__ == '__main__':
    rospy.init_node('beam_hold_test')
    rostest.rosrun('xray_tracking_motion_estimation', 'beam_hold', BeamHoldTest)
