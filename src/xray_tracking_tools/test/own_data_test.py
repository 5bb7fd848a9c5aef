#!/usr/bin/python3
"""Runs every command of docs/own_data.md as it stands there, and judges the poses that come of it. The DICOM files that it
runs them with are somebody's: nothing that says whose may be in what comes of them."""

import csv
import os
import re
import shutil
import subprocess
import sys
import tempfile
import unittest

import numpy
import pydicom
import roslib.packages
import rostest

sys.path.insert(0, os.path.dirname(os.path.abspath(__file__)))
from patient_marks import dicom_files, mark, marks_in, name_by_uid  # noqa: E402

DOCUMENT = os.path.join(roslib.packages.get_pkg_dir("xray_tracking_tools"), "../../docs/own_data.md")
# Where make_exports has the phantom's origin, and its target [mm, LPS].
SHIFT = numpy.array([12.5, -180.0, -431.0])
TARGET = numpy.array([1.25, 15.25, 1.0])
# Slices of 2.5 mm, every second one of the original's left out; measured 0.09 to 0.16.
MOST_MM = 0.4


def blocks():
    """(language, place, text) of the document's blocks that say where they belong."""
    with open(DOCUMENT, encoding="utf-8") as file:
        return re.findall(r"^```(sh|yaml) (\S+)\n(.*?)^```$", file.read(), re.MULTILINE | re.DOTALL)


def places(path, method, point):
    """Where a point of the patient is in every exposure."""
    with open(path, encoding="utf-8") as file:
        rows = [row for row in csv.DictReader(file) if method is None or row["method"] == method]
    found = []
    for row in rows:
        x, y, z, w = (float(row[key]) for key in ("qx", "qy", "qz", "qw"))
        rotation = numpy.array([[1 - 2 * (y * y + z * z), 2 * (x * y - z * w), 2 * (x * z + y * w)],
                                [2 * (x * y + z * w), 1 - 2 * (x * x + z * z), 2 * (y * z - x * w)],
                                [2 * (x * z - y * w), 2 * (y * z + x * w), 1 - 2 * (x * x + y * y)]])
        found.append(rotation @ point + [float(row[key]) for key in ("tx_mm", "ty_mm", "tz_mm")])
    return numpy.array(found)


# The live graph on the plan's setup and the linac's images; and what refuses, whose messages are longest: two series in a
# folder, a structure set and a plan of another CT.
FURTHER = """rosrun xray_tracking_tools sequence_to_bag exports/linac exposures.bag
roslaunch xray_tracking_bringup playback.launch bag:=$PWD/exposures.bag setup_file:=$PWD/exports/linac/sequence.yaml \
rviz:=false supervised:=true exposures:=6 record:=$PWD/recorded.bag
rosrun xray_tracking_tools check_bag recorded.bag
! rosrun xray_tracking_tools setup_from_ct two_series refused.yaml
! rosrun xray_tracking_tools setup_from_plan other_ct exports/linac/structures.dcm exports/linac/plan.dcm refused.yaml \
--roi C4 --detectors exports/linac/detectors.yaml"""


class OwnDataTest(unittest.TestCase):
    def run_all(self, text, directory, environment, said):
        for command in text.splitlines():
            result = subprocess.run(["bash", "-c", command], cwd=directory, stdout=subprocess.PIPE, env=environment,
                                    stderr=subprocess.STDOUT, universal_newlines=True, timeout=300)
            self.assertEqual(result.returncode, 0, command + "\n" + result.stdout)
            said.append(result.stdout)

    def test_every_command_leads_where_the_document_says(self):
        with tempfile.TemporaryDirectory() as folder:
            ran, said, marks = [], [], set()
            environment = dict(os.environ, ROS_HOME=os.path.join(folder, "ros"), ROS_LOG_DIR=os.path.join(folder, "log"))
            for language, place, text in blocks():
                if language == "yaml":
                    self.assertLessEqual(len(text.splitlines()), 20, place)
                    with open(os.path.join(folder, place), "w", encoding="utf-8") as file:
                        file.write(text)
                    continue
                directory = folder if place == "make" else os.path.join(folder, place)
                self.run_all(text, directory, environment, said)
                if place == "make":
                    marks = mark(folder)
                    for name in ("biplane", "linac"):
                        name_by_uid(os.path.join(folder, "exports", name, "ct"))
                ran.append(place)
            self.assertEqual(ran, ["make", "exports/biplane", "exports/room", "exports/linac"])
            expected = places(os.path.join(folder, "standard_set/translation/gold_standard.csv"), None, TARGET)
            for place in ran[1:]:
                with self.subTest(place):
                    results = os.path.join(folder, place, "results")
                    found = places(os.path.join(results, "poses.csv"), "tracking_and_registration", TARGET + SHIFT)
                    self.assertEqual(found.shape, expected.shape)
                    self.assertLess(numpy.linalg.norm(found - expected, axis=1).max(), MOST_MM)
                    self.assertTrue(os.path.exists(os.path.join(results, "report.html")))
                    self.assertTrue(os.path.exists(os.path.join(folder, place, "setup.png")))
            self.assertGreater(len(marks), 100)
            marks |= self.make_refused(folder)
            self.run_all(FURTHER, folder, environment, said)
            with open(os.path.join(folder, "said.txt"), "w", encoding="utf-8") as file:
                file.writelines(said)
            for words in ("Warning: In", "WARNING: In", "gdcm", "itk::"):
                self.assertFalse([text for text in said if words in text], words)
            inputs = set(dicom_files(folder))
            self.assertEqual(sorted(set(marks_in(folder, marks, inputs))), [])

    @staticmethod
    def make_refused(folder):
        """Two series in one folder, and one of another frame of reference. @return their marks"""
        ct = os.path.join(folder, "exports", "linac", "ct")
        for name in ("two_series", "other_ct"):
            shutil.copytree(ct, os.path.join(folder, name))
        other = list(dicom_files(os.path.join(folder, "other_ct")))
        for path in other:
            data = pydicom.dcmread(path)
            data.SeriesInstanceUID = data.SeriesInstanceUID[:-2] + ".2"
            data.FrameOfReferenceUID = data.FrameOfReferenceUID[:-2] + ".2"
            data.save_as(path)
            data.SOPInstanceUID = data.SOPInstanceUID[:-2] + ".2"
            data.save_as(os.path.join(folder, "two_series", f"CT.{data.SOPInstanceUID}.dcm"))
        return mark(os.path.join(folder, "other_ct"))


if __name__ == "__main__":
    rostest.rosrun("xray_tracking_tools", "own_data_test", OwnDataTest)
