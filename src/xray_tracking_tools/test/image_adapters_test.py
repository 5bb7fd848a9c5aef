#!/usr/bin/python3
"""A compressed, distorted image becomes the image and camera_info that the projection without distortion describes."""

import queue
import struct
import subprocess
import unittest
import zlib

import numpy
import roslib.packages
import rospy
import rostest
from sensor_msgs.msg import CameraInfo, CompressedImage, Image

WIDTH, HEIGHT = 60, 40
F, CX, CY = 60.0, 29.5, 19.5
K1 = -0.2
WAIT_S = 20.0


def png(pixels):
    """Of 16 bit grey values."""
    def chunk(kind, data):
        return struct.pack(">I", len(data)) + kind + data + struct.pack(">I", zlib.crc32(kind + data))
    rows = b"".join(b"\0" + row.astype(">u2").tobytes() for row in pixels)
    header = struct.pack(">IIBBBBB", pixels.shape[1], pixels.shape[0], 16, 0, 0, 0, 0)
    return b"\x89PNG\r\n\x1a\n" + chunk(b"IHDR", header) + chunk(b"IDAT", zlib.compress(rows)) + chunk(b"IEND", b"")


def camera_info(coefficients):
    info = CameraInfo(width=WIDTH, height=HEIGHT, distortion_model="plumb_bob", D=coefficients)
    info.K = [F, 0, CX, 0, F, CY, 0, 0, 1]
    # What a calibration adds of its own: another camera than K.
    info.P = [0.9 * F, 0, CX, 0, 0, 0.9 * F, CY, 0, 0, 0, 1, 0]
    return info


class ImageAdaptersTest(unittest.TestCase):
    def setUp(self):
        self.images, self.infos = queue.Queue(), queue.Queue()
        self.subscribers = [rospy.Subscriber("detector_a/image_raw", Image, self.images.put),
                            rospy.Subscriber("detector_a/camera_info", CameraInfo, self.infos.put)]
        self.compressed = rospy.Publisher("detector_a/distorted/image_raw/compressed", CompressedImage, queue_size=10)
        self.info = rospy.Publisher("detector_a/distorted/camera_info", CameraInfo, queue_size=10)
        deadline = rospy.get_time() + WAIT_S
        while (min(self.compressed.get_num_connections(), self.info.get_num_connections(),
                   self.subscribers[0].get_num_connections(), self.subscribers[1].get_num_connections()) < 1):
            self.assertLess(rospy.get_time(), deadline, "the nodes are not connected")
            rospy.sleep(0.05)

    def expose(self, stamp, coefficients, data):
        info = camera_info(coefficients)
        info.header.stamp = rospy.Time(stamp)
        info.header.frame_id = "detector_a_optical_frame"
        self.info.publish(info)
        self.compressed.publish(CompressedImage(header=info.header, format="mono16; png compressed", data=data))

    def test_images_come_out_straight(self):
        slope = numpy.tile(1000 + 100 * numpy.arange(WIDTH), (HEIGHT, 1))
        # What is wrong is dropped, and the nodes live on.
        self.expose(1, [K1, 0, 0, 0, 0], b"no image")
        self.expose(2, [float("nan"), 0, 0, 0, 0], png(slope))
        self.expose(3, [3e4, 0, 0, 0, 0], png(slope))
        self.expose(4, [K1, 0, 0, 0, 0], png(slope[1:]))
        self.expose(5, [K1, 0, 0, 0, 0], png(slope))
        image, info = self.images.get(timeout=WAIT_S), self.infos.get(timeout=WAIT_S)
        for message in (image, info):
            self.assertEqual(message.header.stamp, rospy.Time(5))
            self.assertEqual(message.header.frame_id, "detector_a_optical_frame")
        self.assertEqual(set(info.D), {0.0})
        self.assertEqual(list(info.K), [F, 0, CX, 0, F, CY, 0, 0, 1])
        self.assertEqual(list(info.P), [F, 0, CX, 0, 0, F, CY, 0, 0, 0, 1, 0])
        self.assertEqual(image.encoding, "mono16")
        x, y = numpy.meshgrid((numpy.arange(WIDTH) - CX) / F, (numpy.arange(HEIGHT) - CY) / F)
        expected = 1000 + 100 * (CX + F * x * (1 + K1 * (x * x + y * y)))
        pixels = numpy.frombuffer(image.data, "<u2").reshape(HEIGHT, WIDTH)
        # Places are found to 1/64 px, and values are rounded.
        self.assertLessEqual(numpy.abs(pixels - expected).max(), 100 / 64 + 0.5)
        self.assertGreater(numpy.abs(slope - expected).max(), 60)

        # Another calibration is followed; none leaves the image as it is.
        self.expose(6, [0, 0, 0, 0, 0], png(slope))
        numpy.testing.assert_array_equal(
            numpy.frombuffer(self.images.get(timeout=WAIT_S).data, "<u2").reshape(HEIGHT, WIDTH), slope)
        self.infos.get(timeout=WAIT_S)
        self.assertTrue(self.images.empty() and self.infos.empty())

    def test_a_node_with_wrong_parameters_ends_and_says_what_is_wrong(self):
        for node, parameter, value, words in (
                ("image_decompressor", "detectors", "front", ("/detectors", "front", "a list of texts")),
                ("image_decompressor", "detectors", ["detector a"], ("detector a",)),
                ("image_rectifier", "detectors", ["front", 2], ("/detectors", "a list of texts")),
                ("image_rectifier", "intensity/kind", "bright", ("intensity/kind", "bright", "counts or attenuation")),
                ("image_rectifier", "intensity/kind", 3, ("/intensity/kind", "3", "a text"))):
            rospy.set_param(f"/wrong/{parameter}", value)
            path = roslib.packages.find_node("xray_tracking_tools", node)[0]
            done = subprocess.run([path, "__name:=wrong"], capture_output=True, text=True, timeout=WAIT_S, check=False)
            rospy.delete_param("/wrong")
            self.assertEqual(done.returncode, 1, done.stderr)
            for word in words:
                self.assertIn(word, done.stderr)


if __name__ == "__main__":
    rospy.init_node("image_adapters_test")
    rostest.rosrun("xray_tracking_tools", "image_adapters_test", ImageAdaptersTest)
