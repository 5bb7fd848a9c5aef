#!/usr/bin/python3
"""The most telling faults of the campaign, one after another in one graph, with what must come of them."""
import os
import sys
import tempfile
import unittest

import rostest

sys.path.insert(0, os.path.join(os.path.dirname(os.path.abspath(__file__)), "campaign"))
import fault_campaign  # noqa: E402
import report  # noqa: E402

RATE = 5.0
FAULTS = ("detector_stops", "detector_freezes", "garbage_message", "camera_info_changes", "stamps_of_the_future", "cough",
          "registration_killed")


class FaultsTest(unittest.TestCase):
    def test_the_gate_is_closed_in_time_and_no_pose_is_wrong(self):
        with tempfile.TemporaryDirectory() as folder:
            source = fault_campaign.make_sources([], RATE, folder)[0]
            runs = [{"run": number, "fault": fault, "seed": number, "source": source["name"], "rate": RATE}
                    for number, fault in enumerate(FAULTS)]
            results = {result["fault"]: result for result in fault_campaign.run_session(runs, source, folder, [0], 1)}
        self.assertEqual(set(results), set(FAULTS))
        for name, result in results.items():
            with self.subTest(name):
                self.assertEqual(result["violations"], [], result)
        for name in ("detector_stops", "detector_freezes", "garbage_message"):
            self.assertEqual(results[name]["posed"], 0, f"{name}: a pose without the second view")
        self.assertEqual(results["detector_stops"]["answered"], 0)
        # Tracking goes on without the registration; one exposure may be on its way.
        killed = results["registration_killed"]
        self.assertGreaterEqual(killed["exposures"], 4)
        self.assertGreaterEqual(killed["posed"], killed["exposures"] - 1)

    def test_the_rate_that_runs_bound(self):
        # Of none in n the bound is the rate with which n runs pass in 5 % of campaigns; of all, none.
        for runs in (1, 47, 200):
            self.assertAlmostEqual(report.bounded_rate(runs, 0), 1 - 0.05 ** (1 / runs), places=9)
        self.assertEqual(report.bounded_rate(7, 7), 1.0)
        # Clopper and Pearson's, of tables: 2 of 20.
        self.assertAlmostEqual(report.bounded_rate(20, 2), 0.2826, places=4)


if __name__ == "__main__":
    rostest.rosrun("xray_tracking_bringup", "faults", FaultsTest)
