"""Listens to what the graph says, and judges it by the truth. Shares no code with the nodes."""
import bisect
import collections
import os
import sys
import threading
import time

import numpy as np
import rospy
from geometry_msgs.msg import PoseWithCovarianceStamped
from rosgraph_msgs.msg import Log
from xray_tracking_msgs.msg import BeamGate, PatientMotion

sys.path.insert(0, os.path.join(os.path.dirname(os.path.abspath(__file__)), ".."))
from graph_test_case import matrix, target_registration_error_mm  # noqa: E402

WRONG_MM = 2.0
LOST_M, LOST_RAD = 0.01, 0.07  # twice refinement/max_correction, and refinement/max_correction_rotation
REASONS = {value: name for name, value in vars(BeamGate).items() if name.isupper() and isinstance(value, int)}
Motion = collections.namedtuple("Motion", "time state source")


class Judge:
    """Times are monotonic, of this process: when it heard of something."""

    def __init__(self, injector, box_mm):
        self.injector, self.box_mm = injector, box_mm
        self.lock = threading.Lock()
        self.gates = []      # (time, open, until, reason, text)
        self.opened = {}     # stamp [ns] of an exposure -> whether the gate was ever open while it was the latest
        self.poses = []      # (time, stamp, error [mm] or None where no exposure has the stamp, whether the gate was open)
        self.motions = {}    # stamp [ns] -> Motion
        self.fatal = []
        self.bad_numbers = []
        self.subscribers = [
            rospy.Subscriber("/beam_gate", BeamGate, self.gate, queue_size=1000, tcp_nodelay=True),
            rospy.Subscriber("/patient_pose", PoseWithCovarianceStamped, self.pose, queue_size=1000, tcp_nodelay=True),
            rospy.Subscriber("/patient_motion", PatientMotion, self.motion, queue_size=1000, tcp_nodelay=True),
            rospy.Subscriber("/rosout", Log, self.log, queue_size=1000)]

    def gate(self, message):
        now = time.monotonic()
        until = now + (message.valid_until - message.header.stamp).to_sec()
        with self.lock:
            self.gates.append((now, message.open, until, REASONS[message.reason], message.text))
            exposure = message.exposure.to_nsec()
            self.opened[exposure] = self.opened.get(exposure, False) or message.open

    def pose(self, message):
        stamp = message.header.stamp.to_nsec()
        truth = self.injector.truth.get(stamp)
        estimate = matrix(message.pose.pose.position, message.pose.pose.orientation)
        error = None if truth is None else float(target_registration_error_mm(estimate, truth, self.box_mm))
        was_open = self.is_open()
        with self.lock:
            self.poses.append((time.monotonic(), stamp, error, was_open))
            if error is not None and error != error:
                self.bad_numbers.append(f"a pose at {stamp} with numbers that are none")

    def motion(self, message):
        with self.lock:
            self.motions[message.header.stamp.to_nsec()] = Motion(time.monotonic(), message.state, message.source)

    def log(self, message):
        if message.level >= Log.FATAL:
            with self.lock:
                self.fatal.append(f"{message.name}: {message.msg}")

    def open_spans(self, since, until):
        """Times at which who acts on the gate would have had the beam on: the last message says open and is valid."""
        with self.lock:
            gates = list(self.gates)
        times = [gate[0] for gate in gates]
        spans = []
        for i in range(max(bisect.bisect_left(times, since) - 1, 0), len(gates)):
            begin, is_open, end = gates[i][:3]
            if begin > until:
                break
            if i + 1 < len(gates):
                end = min(end, gates[i + 1][0])
            begin, end = max(begin, since), min(end, until)
            if is_open and begin < end:
                spans.append((begin, end))
        return spans

    def is_open(self):
        with self.lock:
            return bool(self.gates) and self.gates[-1][1] and time.monotonic() < self.gates[-1][2]

    def last_text(self):
        with self.lock:
            return f"{self.gates[-1][3]}: {self.gates[-1][4]}" if self.gates else "nothing was heard of the gate"

    def reasons(self, since, until):
        with self.lock:
            return sorted({gate[3] for gate in self.gates if since <= gate[0] <= until} - {"NONE"})

    def registered_since(self, when):
        """Whether an exposure sent after that has a registered pose."""
        sent_at = self.injector.sent_at
        with self.lock:
            return any(motion.source == PatientMotion.REGISTERED and sent_at.get(stamp, 0.0) > when
                       for stamp, motion in reversed(list(self.motions.items())))

    def wait_until_well(self, timeout, still=0.4):
        """The gate open without a break for `still` seconds, and exposures registered again. @return when the gate was
        open, or that was seen, whichever was later; None if it does not come to it"""
        asked, opened, registered = time.monotonic(), None, None
        while time.monotonic() < asked + timeout:
            now = time.monotonic()
            opened = (opened or now) if self.is_open() else None
            registered = registered or (now if self.registered_since(asked) else None)
            if opened and registered and now - opened >= still:
                return max(opened, registered)
            time.sleep(0.01)
        return None

    def errors(self, since, until):
        """(errors of the poses of exposures for which the gate was open, errors of all poses) [mm]; a pose of no
        exposure that was made counts as infinitely wrong. What the gate says of an exposure comes right behind its pose;
        where it says nothing of it, what it said before counts."""
        with self.lock:
            poses = [(float("inf") if error is None else error, self.opened.get(stamp, was_open))
                     for when, stamp, error, was_open in self.poses if since <= when <= until]
            return [error for error, is_open in poses if is_open], [error for error, _ in poses]

    def gone_too_far(self, since, until, known=None):
        """Whether the target was ever farther from a known pose, or from where it was first in that time, than
        registrations look for it without a track (docs/safety.md): then somebody has to say where it is."""
        truth = [self.injector.truth[stamp] for stamp, when in sorted(self.injector.sent_at.items())
                 if since <= when <= until]
        known = truth[0] if known is None else known
        centre = np.append(np.mean(self.box_mm, axis=0) / 1000.0, 1.0)
        turns = [np.arccos(np.clip((np.trace(known[:3, :3].T @ now[:3, :3]) - 1) / 2, -1, 1)) for now in truth]
        ways = [np.linalg.norm((now - known) @ centre) for now in truth]
        return max(ways, default=0.0) > LOST_M or max(turns, default=0.0) > LOST_RAD

    def answers(self, since, until):
        """Exposures sent in that time, how many of them have an answer, and how many a pose."""
        stamps = [stamp for stamp, when in list(self.injector.sent_at.items()) if since <= when <= until]
        with self.lock:
            posed = {stamp for _, stamp, _, _ in self.poses}
            return len(stamps), sum(s in self.motions for s in stamps), sum(s in posed for s in stamps)
