#!/usr/bin/python3
"""Runs every command of docs/own_data.md as it stands there, and judges the poses that come of it."""

import csv
import os
import re
import subprocess
import tempfile
import unittest

import numpy
import roslib.packages
import rostest

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


class OwnDataTest(unittest.TestCase):
    def test_every_command_leads_where_the_document_says(self):
        with tempfile.TemporaryDirectory() as folder:
            ran = []
            for language, place, text in blocks():
                if language == "yaml":
                    self.assertLessEqual(len(text.splitlines()), 20, place)
                    with open(os.path.join(folder, place), "w", encoding="utf-8") as file:
                        file.write(text)
                    continue
                directory = folder if place == "make" else os.path.join(folder, place)
                for command in text.splitlines():
                    with self.subTest(command):
                        result = subprocess.run(["bash", "-c", command], cwd=directory, stdout=subprocess.PIPE,
                                                stderr=subprocess.STDOUT, universal_newlines=True, timeout=300)
                        self.assertEqual(result.returncode, 0, result.stdout)
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


if __name__ == "__main__":
    rostest.rosrun("xray_tracking_tools", "own_data_test", OwnDataTest)
