"""Exposures whose truth is known, and the geometry that they were made in: what the campaigns play to the graph. By
docs/own_data.md alone; shares no code with the nodes."""
import csv
import itertools
import os
import subprocess
import sys
import threading

import numpy as np
import yaml
from PIL import Image as Picture
from scipy.spatial.transform import Rotation
from sensor_msgs.msg import CameraInfo

BREATH_S = 4.0  # of the phantom
COUGH_MM = 12.0
# The phantom's breath [mm, room axes]: 6.9 mm, 5.4 mm/s at most.
BREATH_MM = np.array([-4.5, 3.3, 4.0])
COUGHS = 8  # exposures of a cough, evenly over the breath


def pose(translation_mm, xyzw):
    """4 x 4 matrix in metres."""
    result = np.eye(4)
    result[:3, :3] = Rotation.from_quat(xyzw).as_matrix()
    result[:3, 3] = np.array(translation_mm) / 1000.0
    return result


class Detector:
    """An entry of a setup file's detectors; lengths in mm."""

    def __init__(self, entry):
        self.name, (self.columns, self.rows) = entry["name"], entry["image_size"]
        self.pitch = np.array(entry["pixel_pitch_mm"], float)
        self.source, self.origin = (np.array(entry[key], float) for key in ("source_mm", "origin_mm"))
        self.x, self.y = (np.array(entry[key], float) for key in ("x_direction", "y_direction"))

    def project(self, point_mm):
        normal = np.cross(self.x, self.y)
        ray = point_mm - self.source
        on_panel = self.source + ray * (normal @ (self.origin - self.source)) / (normal @ ray) - self.origin
        return np.array([on_panel @ self.x, on_panel @ self.y]) / self.pitch

    def camera_info(self):
        normal = np.cross(self.x, self.y)
        focal = normal @ (self.origin - self.source) / self.pitch
        centre = self.project(self.source + normal)
        info = CameraInfo(width=self.columns, height=self.rows, distortion_model="plumb_bob", D=[0.0] * 5)
        info.header.frame_id = self.name + "_optical_frame"
        info.K = [focal[0], 0, centre[0], 0, focal[1], centre[1], 0, 0, 1]
        info.R = [1, 0, 0, 0, 1, 0, 0, 0, 1]
        info.P = [focal[0], 0, centre[0], 0, 0, focal[1], centre[1], 0, 0, 0, 1, 0]
        return info


class Setup:
    """A setup file (keys of a sequence.yaml)."""

    def __init__(self, path):
        self.path = os.path.realpath(path)
        with open(path, encoding="utf-8") as file:
            self.entries = yaml.safe_load(file)
        if isinstance(self.entries["detectors"], str):
            with open(self.beside("detectors"), encoding="utf-8") as file:
                self.entries["detectors"] = yaml.safe_load(file)["detectors"]
        self.detectors = {entry["name"]: Detector(entry) for entry in self.entries["detectors"]}
        box = self.entries["target_box_mm"]
        self.box_mm = (np.array(box["min"], float), np.array(box["max"], float))
        initial = self.entries["initial_pose"]
        self.initial_pose = pose(initial["translation_mm"], initial["rotation_xyzw"])
        self.offset = self.entries["intensity"].get("offset", 0)

    def beside(self, key):
        return os.path.join(os.path.dirname(self.path), self.entries[key])

    @property
    def source(self):
        return "ct" if "ct" in self.entries else "phantom"

    @property
    def pixels(self):
        """Of an exposure."""
        return sum(detector.columns * detector.rows for detector in self.detectors.values())

    def region(self, name):
        """Columns and rows (first, behind the last, both) that the target's box is seen in at the initial pose."""
        corners = np.array(list(itertools.product(*zip(*self.box_mm)))) / 1000.0
        room_mm = 1000.0 * (corners @ self.initial_pose[:3, :3].T + self.initial_pose[:3, 3])
        detector = self.detectors[name]
        pixels = np.array([detector.project(point) for point in room_mm])
        low, high = pixels.min(axis=0).astype(int), pixels.max(axis=0).astype(int) + 1
        size = (detector.columns, detector.rows)
        return [(int(np.clip(low[i], 0, size[i])), int(np.clip(high[i], 0, size[i]))) for i in (0, 1)]

    def write_miscalibrated(self, path, detector, shift_mm=0.0, turn_degrees=0.0):
        """The same setup but for one detector, which stands shifted along its rows and turned about them at its source by
        what is given."""
        entries = dict(self.entries, detectors=[dict(entry) for entry in self.entries["detectors"]])
        if "ct" in entries:
            entries["ct"] = os.path.realpath(self.beside("ct"))
        own, entry = self.detectors[detector], next(e for e in entries["detectors"] if e["name"] == detector)
        turn = Rotation.from_rotvec(np.radians(turn_degrees) * own.x)
        entry["origin_mm"] = (own.source + turn.apply(own.origin - own.source) + shift_mm * own.x).tolist()
        entry["x_direction"], entry["y_direction"] = turn.apply(own.x).tolist(), turn.apply(own.y).tolist()
        with open(path, "w", encoding="utf-8") as file:
            yaml.safe_dump(entries, file)


class Bank:
    """images: detector -> array of exposures, rows, columns; truth: one pose (4 x 4, metres) an exposure. The first
    `cycle` exposures follow each other and begin anew behind the last; those behind them are of coughs."""

    def __init__(self, images, truth, cycle, native_rate):
        self.images, self.truth, self.cycle, self.native_rate = images, truth, cycle, native_rate

    def save(self, path):
        np.savez(path, truth=self.truth, cycle=self.cycle, native_rate=self.native_rate,
                 **{"image_" + name: images for name, images in self.images.items()})

    @classmethod
    def load(cls, path):
        with np.load(path) as data:
            images = {key[len("image_"):]: data[key] for key in data.files if key.startswith("image_")}
            return cls(images, data["truth"], int(data["cycle"]), float(data["native_rate"]))

    def index(self, k, rate):
        """Which exposure the k-th one at `rate` is."""
        return int(k * self.native_rate / rate) % self.cycle

    def cough(self, index):
        """The exposure of a cough at the place in the breath that `index` has, about; None if there is none."""
        coughs = len(self.truth) - self.cycle
        return self.cycle + index * coughs // self.cycle if coughs else None


def bank_of_sequence(folder):
    """To and fro over a sequence folder with a gold standard."""
    def rows(name):
        with open(os.path.join(folder, name), encoding="utf-8") as file:
            return list(csv.DictReader(file))
    setup, frames = Setup(os.path.join(folder, "sequence.yaml")), rows("frames.csv")
    images = {name: np.stack([np.array(Picture.open(os.path.join(folder, row["file"])))
                              for row in frames if row["detector"] == name]) for name in setup.detectors}
    images = {name: array.astype(np.uint8 if array.max() < 256 else np.uint16) for name, array in images.items()}
    truth = np.array([pose([float(row[key]) for key in ("tx_mm", "ty_mm", "tz_mm")],
                           [float(row[key]) for key in ("qx", "qy", "qz", "qw")])
                      for row in rows("gold_standard.csv")])
    stamps = sorted({float(row["stamp_s"]) for row in frames})
    order = list(range(len(truth))) + list(range(len(truth) - 2, 0, -1))
    return Bank({name: array[order] for name, array in images.items()}, truth[order], len(order),
                (len(stamps) - 1) / (stamps[-1] - stamps[0]))


def phantom_places(cycle):
    """Shift of every exposure from the initial pose [mm]: so many of a breath, and of coughs behind them."""
    breath = [BREATH_MM * (1 - np.cos(2 * np.pi * k / cycle)) / 2 for k in range(cycle)]
    away = COUGH_MM * BREATH_MM / np.linalg.norm(BREATH_MM)
    return np.array(breath + [breath[k * cycle // COUGHS] + away for k in range(COUGHS)])


def write_places(setup, places, path):
    initial = setup.entries["initial_pose"]
    with open(path, "w", encoding="utf-8") as file:
        file.write("stamp_s,tx_mm,ty_mm,tz_mm,qx,qy,qz,qw\n")
        for k, shift in enumerate(places):
            numbers = [float(k)] + list(np.add(initial["translation_mm"], shift)) + initial["rotation_xyzw"]
            file.write(",".join(f"{number:.9f}" for number in numbers) + "\n")


def make_phantom_bank(setup_path, out, rate, timeout=180.0):
    """Has the simulator make them, for exposures at `rate` and what divides it. In a process of its own (it becomes a
    node of the master that is there)."""
    import rospy
    from sensor_msgs.msg import Image
    setup, csv_file, cycle = Setup(setup_path), out + ".csv", int(BREATH_S * rate)
    places = phantom_places(cycle)
    write_places(setup, places, csv_file)
    count = len(places)
    for name, value in {"setup_file": setup.path, "exposures": count, "rate": 10.0, "wait_for_start": False,
                        "motion/type": "csv", "motion/csv_file": csv_file}.items():
        rospy.set_param("/detector_simulator/" + name, value)
    got, done = {name: {} for name in setup.detectors}, threading.Event()

    def take(message, name):
        got[name][message.header.stamp.to_nsec()] = np.frombuffer(message.data, "<u2").reshape(message.height, -1)
        if all(len(images) == count for images in got.values()):
            done.set()
    rospy.init_node("bank")
    subscribers = [rospy.Subscriber(f"/{name}/image_raw", Image, take, callback_args=name, queue_size=100)
                   for name in setup.detectors]
    simulator = subprocess.Popen(["rosrun", "xray_tracking_detector_simulator", "detector_simulator_node"],
                                 stdout=subprocess.DEVNULL)
    try:
        if not done.wait(timeout):
            raise TimeoutError(f"{[len(images) for images in got.values()]} of {count} exposures of the phantom "
                               f"in {timeout} s")
    finally:
        simulator.terminate()
        simulator.wait(30)
    truth = np.repeat(setup.initial_pose[None], count, axis=0)
    truth[:, :3, 3] += places / 1000.0
    Bank({name: np.stack([images[stamp] for stamp in sorted(images)]) for name, images in got.items()}, truth, cycle,
         rate).save(out)
    del subscribers


if __name__ == "__main__":
    make_phantom_bank(sys.argv[1], sys.argv[2], float(sys.argv[3]))
