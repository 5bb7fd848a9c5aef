"""What the node's tests share: exposures of the phantom, and requests about them."""
import gzip
import os
import struct
import threading
import time
import unittest

import numpy as np
import rospy
import yaml
from geometry_msgs.msg import Point, Pose, PoseStamped, Quaternion, Transform, TransformStamped, Vector3
from sensor_msgs.msg import CameraInfo, Image
from std_srvs.srv import Trigger
from tf2_msgs.msg import TFMessage

DETECTORS = ("detector_a", "detector_b")
# Where geometry/cyberknife.yaml puts the sources [m] and turns the optical frames: by 135 and 225 degrees about room x.
SOURCES = (Vector3(0.0, 1.8384776310850236, 1.8384776310850236), Vector3(0.0, -1.8384776310850236, 1.8384776310850236))
TURNS = tuple(Quaternion(np.sin(a / 2), 0.0, 0.0, np.cos(a / 2)) for a in np.radians((135.0, 225.0)))
EXPOSURES = 6
TIMEOUT = 60.0  # s


def matrix(pose):
    """4 x 4 matrix [m] of a message."""
    x, y, z, w = pose.orientation.x, pose.orientation.y, pose.orientation.z, pose.orientation.w
    result = np.eye(4)
    result[:3, :3] = [[1 - 2 * (y * y + z * z), 2 * (x * y - z * w), 2 * (x * z + y * w)],
                      [2 * (x * y + z * w), 1 - 2 * (x * x + z * z), 2 * (y * z - x * w)],
                      [2 * (x * z - y * w), 2 * (y * z + x * w), 1 - 2 * (x * x + y * y)]]
    result[:3, 3] = pose.position.x, pose.position.y, pose.position.z
    return result


def shifted(pose, x, y, z):
    """The pose moved in the room [m]."""
    return Pose(position=Point(pose.position.x + x, pose.position.y + y, pose.position.z + z),
                orientation=Quaternion(pose.orientation.x, pose.orientation.y, pose.orientation.z, pose.orientation.w))


class Exposure:
    def __init__(self):
        self.images, self.camera_infos, self.truth = {}, {}, None

    def complete(self):
        return len(self.images) == len(self.camera_infos) == len(DETECTORS) and self.truth is not None


class RegistrationTestCase(unittest.TestCase):
    @classmethod
    def setUpClass(cls):
        with open(rospy.get_param("/setup_file"), encoding="utf-8") as file:
            box = yaml.safe_load(file)["target_box_mm"]
        axes = [np.array(ends) / 1000.0 for ends in zip(box["min"], box["max"])]
        cls.corners = np.stack(np.meshgrid(*axes, [1.0], indexing="ij"), -1).reshape(-1, 4).T
        cls.exposures = cls.record_exposures()
        cls.tf_static = rospy.Publisher("/tf_static", TFMessage, queue_size=1, latch=True)
        cls.frames = {}
        cls.send_frames("optical_frame")

    @classmethod
    def send_frames(cls, suffix, x=0.0):
        """Where the detectors are, in frames of that name, moved along room x [m]."""
        for name, source, turn in zip(DETECTORS, SOURCES, TURNS):
            frame = TransformStamped(child_frame_id=f"{name}_{suffix}",
                                     transform=Transform(Vector3(source.x + x, source.y, source.z), turn))
            frame.header.frame_id = "treatment_room"
            cls.frames[frame.child_frame_id] = frame
        cls.tf_static.publish(TFMessage(list(cls.frames.values())))

    @classmethod
    def record_exposures(cls):
        """What the simulator sends, in order."""
        by_stamp, changed = {}, threading.Condition()

        def keep(message, where):
            with changed:
                where(by_stamp.setdefault(message.header.stamp, Exposure()), message)
                changed.notify_all()

        def keep_truth(exposure, message):
            exposure.truth = message.pose

        subscribers = [rospy.Subscriber("/sim/patient_ground_truth", PoseStamped, keep, keep_truth)]
        for name in DETECTORS:
            subscribers.append(rospy.Subscriber(
                f"/sim/{name}/image_raw", Image, keep,
                lambda exposure, message, name=name: exposure.images.update({name: message})))
            subscribers.append(rospy.Subscriber(
                f"/sim/{name}/camera_info", CameraInfo, keep,
                lambda exposure, message, name=name: exposure.camera_infos.update({name: message})))
        cls.wait_for(lambda: all(s.get_num_connections() > 0 for s in subscribers), "the simulator's topics")
        start = rospy.ServiceProxy("/sim/detector_simulator/start", Trigger)
        start.wait_for_service(TIMEOUT)
        cls.wait_for(lambda: start().success, "the simulator's start")
        cls.wait_for(lambda: sum(e.complete() for e in by_stamp.values()) == EXPOSURES, "exposures")
        for subscriber in subscribers:
            subscriber.unregister()
        return [by_stamp[stamp] for stamp in sorted(by_stamp)]

    @staticmethod
    def wait_for(condition, what):
        end = time.monotonic() + TIMEOUT
        while not condition():
            if time.monotonic() > end or rospy.is_shutdown():
                raise AssertionError(f"not within {TIMEOUT} s: {what}")
            time.sleep(0.01)

    def error_mm(self, pose, truth):
        """Largest distance of the target box's corners."""
        return 1000.0 * np.linalg.norm(((matrix(pose) - matrix(truth)) @ self.corners)[:3], axis=0).max()


class Sender:
    """Passes exposures on to a node in a namespace."""

    sent = 0

    def __init__(self, namespace):
        self.images = {n: rospy.Publisher(f"/{namespace}/{n}/image_raw", Image, queue_size=50) for n in DETECTORS}
        self.infos = {n: rospy.Publisher(f"/{namespace}/{n}/camera_info", CameraInfo, queue_size=50)
                      for n in DETECTORS}
        publishers = list(self.images.values()) + list(self.infos.values())
        RegistrationTestCase.wait_for(lambda: all(p.get_num_connections() > 0 for p in publishers),
                                      f"{namespace} listens, so has its volume")

    def send(self, exposure, stamp, detectors=DETECTORS):
        Sender.sent += 1
        for name in detectors:
            # Last bits of the pixels, as a detector's noise changes them: the same image is no new exposure.
            pixels = np.frombuffer(exposure.images[name].data, np.uint8).copy()
            bits = np.random.RandomState(Sender.sent).randint(0, 2, pixels[::4].size, np.uint8)
            pixels[::4] = pixels[::4] & 0xFE | bits
            exposure.images[name].data = pixels.tobytes()
            for publisher, message in ((self.infos[name], exposure.camera_infos[name]),
                                       (self.images[name], exposure.images[name])):
                message.header.stamp = stamp
                publisher.publish(message)


def not_a_volume(folder):
    path = os.path.join(folder, "not_a_volume.nrrd")
    with open(path, "w", encoding="utf-8") as file:
        file.write("NRRD0004\nand then no more")
    return path


VOLUME_HEADER = ("NRRD0004\ntype: short\ndimension: 3\nspace: left-posterior-superior\nsizes: {} {} {}\n"
                 "space directions: (4,0,0) (0,4,0) (0,0,4)\nkinds: domain domain domain\nendian: little\n"
                 "encoding: raw\nspace origin: (-78,-78,-78)\n\n")


def write_volume(path, values):
    """Values (z, y, x), voxels of 4 mm."""
    with open(path, "wb") as file:
        file.write(VOLUME_HEADER.format(*values.shape[::-1]).encode() + values.astype("<i2").tobytes())


def read_volume(path):
    """@return values (z, y, x) of a NRRD of shorts, raw or compressed"""
    with open(path, "rb") as file:
        header, data = file.read().split(b"\n\n", 1)
    fields = dict(line.split(": ", 1) for line in header.decode().split("\n") if ": " in line)
    data = gzip.decompress(data) if fields["encoding"] in ("gzip", "gz") else data
    return np.frombuffer(data, "<i2").reshape([int(size) for size in fields["sizes"].split()][::-1])


def small_volume(folder):
    """Water with a rod of bone through the target, voxels of 4 mm."""
    path = os.path.join(folder, "small.nrrd")
    index = np.stack(np.meshgrid(*[(np.arange(40) - 19.5) * 4.0] * 3, indexing="ij"), -1)  # z, y, x
    hu = np.where(np.hypot(index[..., 1], index[..., 2]) < 70.0, 0, -1000)
    hu[(np.abs(index[..., 1] - 10.0) < 9.0) & (np.abs(index[..., 2]) < 11.0)] = 700
    write_volume(path, hu)
    return path


def element(group, tag, vr, value):
    """Of a DICOM data set, explicit VR."""
    value = value.encode() if isinstance(value, str) else value
    value += (b"\0" if vr == "UI" else b" ") * (len(value) % 2)
    length = b"\0\0" + struct.pack("<I", len(value)) if vr in ("SQ", "OW") else struct.pack("<H", len(value))
    return struct.pack("<HH", group, tag) + vr.encode() + length + value


def item(data):
    return struct.pack("<HHI", 0xFFFE, 0xE000, len(data)) + data


def write_dicom(path, sop_class, modality, data):
    with open(path, "wb") as file:
        file.write(b"\0" * 128 + b"DICM" + element(2, 0x10, "UI", "1.2.840.10008.1.2.1") +
                   element(8, 0x16, "UI", sop_class) + element(8, 0x18, "UI", "1.2.3.4") +
                   element(8, 0x60, "CS", modality) + data)


def write_dicom_ct(folder, values, frame_of_reference):
    """Values (z, y, x) as a series, voxels of 4 mm about the origin."""
    os.makedirs(folder, exist_ok=True)
    first = [-2.0 * (size - 1) for size in values.shape]  # z, y, x
    for k, plane in enumerate(values):
        numbers = [(0x02, 1), (0x10, plane.shape[0]), (0x11, plane.shape[1]), (0x100, 16), (0x101, 16), (0x102, 15),
                   (0x103, 1)]
        image = {tag: element(0x28, tag, "US", struct.pack("<H", number)) for tag, number in numbers}
        image[0x04] = element(0x28, 0x04, "CS", "MONOCHROME2")
        image[0x30] = element(0x28, 0x30, "DS", "4\\4")
        write_dicom(os.path.join(folder, f"{k}.dcm"), "1.2.840.10008.5.1.4.1.1.2", "CT",
                    element(0x20, 0x0E, "UI", "1.2.3.5") +
                    element(0x20, 0x32, "DS", f"{first[2]}\\{first[1]}\\{first[0] + 4.0 * k}") +
                    element(0x20, 0x37, "DS", "1\\0\\0\\0\\1\\0") + element(0x20, 0x52, "UI", frame_of_reference) +
                    b"".join(image[tag] for tag in sorted(image)) +
                    element(0x7FE0, 0x10, "OW", plane.astype("<i2").tobytes()))


def write_structure_set(path, roi, contours, frame_of_reference):
    """@param contours of the one structure: lists of points (x, y, z) [mm]"""
    drawn = b"".join(item(element(0x3006, 0x42, "CS", "CLOSED_PLANAR") +
                          element(0x3006, 0x50, "DS", "\\".join(str(value) for point in points for value in point)))
                     for points in contours)
    write_dicom(path, "1.2.840.10008.5.1.4.1.1.481.3", "RTSTRUCT",
                element(0x3006, 0x20, "SQ", item(element(0x3006, 0x22, "IS", "1") +
                                                 element(0x3006, 0x24, "UI", frame_of_reference) +
                                                 element(0x3006, 0x26, "LO", roi))) +
                element(0x3006, 0x39, "SQ", item(element(0x3006, 0x40, "SQ", drawn) +
                                                 element(0x3006, 0x84, "IS", "1"))))
