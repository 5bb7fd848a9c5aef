#!/usr/bin/python3
"""Thirty bad exposures a second fill no log: each cause is said about once a second, and the whole graph stays readable."""
import collections
import itertools
import unittest

import numpy as np
import rospy
import rostest
from rosgraph_msgs.msg import Log
from sensor_msgs.msg import CameraInfo, Image

DETECTORS = ("detector_a", "detector_b")
RATE = 30.0  # Hz
SECONDS = 1.0
SIZE = 512


def texture():
    """Something that a template can be learnt of."""
    rough = np.random.default_rng(7).normal(size=(SIZE, SIZE))
    smooth = np.real(np.fft.ifft2(np.fft.fft2(rough) * np.exp(-np.add.outer(np.fft.fftfreq(SIZE) ** 2,
                                                                            np.fft.fftfreq(SIZE) ** 2) * 600.0)))
    return np.clip(20000 + 6000 * smooth / smooth.std(), 1000, 60000)


class LogRateTest(unittest.TestCase):
    def setUp(self):
        self.images = [rospy.Publisher(f"{name}/image_raw", Image, queue_size=10) for name in DETECTORS]
        self.infos = [rospy.Publisher(f"{name}/camera_info", CameraInfo, queue_size=10) for name in DETECTORS]
        self.said = []
        rospy.Subscriber("/rosout", Log, self.said.append, queue_size=1000)
        deadline = rospy.Time.now() + rospy.Duration(60)
        while any(image.get_num_connections() < 2 for image in self.images):  # tracker and registration
            self.assertLess(rospy.Time.now(), deadline, "nobody listens")
            rospy.sleep(0.2)
        self.values = texture()
        self.noise = np.random.default_rng(3)

    def send(self, n, alter):
        """One exposure, which alter(n, image, camera_info) has made bad."""
        values = self.values + self.noise.normal(0.0, 100.0, (SIZE, SIZE))
        for detector in range(len(DETECTORS)):
            image = Image(height=SIZE, width=SIZE, encoding="mono16", step=2 * SIZE,
                          data=values.astype("<u2").tobytes())
            image.header.stamp = self.stamp
            info = CameraInfo(header=image.header, height=SIZE, width=SIZE)
            alter(n, image, info)
            info.header = image.header
            self.infos[detector].publish(info)
            self.images[detector].publish(image)

    def test_every_cause_once_a_second(self):
        def encoding(n, image, info):
            image.encoding = f"rgb{n}"

        def data(n, image, info):
            image.data = image.data[:1000 + n]

        def size(n, image, info):
            image.height -= n

        def future(n, image, info):
            image.header.stamp = rospy.Time.now() + rospy.Duration(100 + n)

        def back(n, image, info):
            image.header.stamp -= rospy.Duration(10 * (n % 2))

        def black(n, image, info):
            image.data = bytes(len(image.data))

        def black_every_other(n, image, info):
            image.data = bytes(len(image.data)) if n % 2 else image.data

        def camera_info(n, image, info):
            info.K[0] = info.P[0] = float("nan") if n % 2 else n
            info.width += n

        for alter in (encoding, data, size, camera_info, black, black_every_other, future, back):
            rospy.sleep(0.3)
            del self.said[:]
            rate = rospy.Rate(RATE)
            for n in range(int(SECONDS * RATE)):
                self.stamp = rospy.Time.now()
                self.send(n, alter)
                rate.sleep()
            rospy.sleep(0.5)
            counts = collections.Counter()
            examples = {}
            for line in list(self.said):
                detector = next((name for name in DETECTORS if name in line.msg), "")
                cause = (line.name, line.file, line.line, detector)
                # What a view or the patient's motion has come to be is said of each such state.
                if line.level < Log.WARN or "patient's motion" in line.msg or "beam gate" in line.msg:
                    cause += tuple(itertools.takewhile(lambda word: word != "from", line.msg.split()[:5]))
                counts[cause] += 1
                examples.setdefault(cause, []).append(line.msg)
            for cause, count in counts.items():
                self.assertLessEqual(count, SECONDS + 2, f"{alter.__name__}: {cause}\n" + "\n".join(examples[cause][:8]))
            self.assertLessEqual(sum(counts.values()), 40, f"{alter.__name__}: {examples}")
            if alter is not black_every_other:
                warned = any(line.level >= Log.WARN for line in self.said)
                self.assertTrue(warned, f"{alter.__name__}: not a word")


if __name__ == "__main__":
    rospy.init_node("log_rate_test")
    rostest.rosrun("xray_tracking_bringup", "log_rate", LogRateTest)
