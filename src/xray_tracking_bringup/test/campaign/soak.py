#!/usr/bin/python3
"""Runs one graph for long, and asks whether anything grows: memory, descriptors, threads, queues, latency."""
import argparse
import json
import os
import sys
import tempfile
import threading
import time

import numpy as np
import rospy
from diagnostic_msgs.msg import DiagnosticArray

sys.path.insert(0, os.path.dirname(os.path.abspath(__file__)))
from fault_campaign import make_sources  # noqa: E402
from session import START_S, Rig  # noqa: E402

PERIOD_S = 5.0
PAGE = os.sysconf("SC_PAGE_SIZE")
# What may differ between quarters of a run in which nothing grows: allocators give back and take again.
MEMORY_MB, MEMORY_SHARE = 4.0, 0.02
LATENCY_S, LATENCY_FACTOR = 0.02, 1.5
QUEUES = ("waiting", "pending", "dropped", "late", "incomplete", "duplicate")


def process_figures(pid):
    with open(f"/proc/{pid}/statm", encoding="ascii") as file:
        resident = int(file.read().split()[1]) * PAGE / 1e6
    return {"memory_mb": resident, "descriptors": len(os.listdir(f"/proc/{pid}/fd")),
            "threads": len(os.listdir(f"/proc/{pid}/task"))}


class Queues:
    """Figures of diagnostics that tell of queues."""

    def __init__(self):
        self.latest, self.lock = {}, threading.Lock()
        self.subscriber = rospy.Subscriber("/diagnostics", DiagnosticArray, self.take, queue_size=100)

    def take(self, message):
        for status in message.status:
            for entry in status.values:
                if any(word in entry.key for word in QUEUES):
                    try:
                        with self.lock:
                            self.latest[f"{status.name}: {entry.key}"] = float(entry.value)
                    except ValueError:
                        pass  # a text

    def now(self):
        with self.lock:
            return dict(self.latest)


def quarter(values, number):
    size = max(len(values) // 4, 1)
    return values[(number - 1) * size:number * size]


def latencies(judge, injector, since, until):
    """From an exposure to its answer [s], in order of the exposures."""
    with judge.lock:
        return np.array([judge.motions[stamp].time - sent for stamp, sent in sorted(injector.sent_at.items())
                         if since <= sent <= until and stamp in judge.motions])


def judge_soak(samples, waits, unanswered):
    """Every figure beside its bound. @return (figures, violations)"""
    figures, violations = {"unanswered": unanswered}, []
    if unanswered:
        violations.append(f"{unanswered} exposures have no answer")
    for node in samples[0]["nodes"]:
        for key in ("memory_mb", "descriptors", "threads"):
            series = [sample["nodes"][node][key] for sample in samples]
            before, after = np.median(quarter(series, 2)), np.median(quarter(series, 4))
            allowed = MEMORY_MB + MEMORY_SHARE * before if key == "memory_mb" else 0.0
            figures[f"{node} {key}"] = [float(before), float(after)]
            if after > before + allowed:
                violations.append(f"{key} of {node} grew from {before:.1f} to {after:.1f}")
    for key in sorted(set().union(*(sample["queues"] for sample in samples))):
        series = [sample["queues"].get(key, 0.0) for sample in samples]
        figures[key] = [float(max(quarter(series, 2))), float(max(quarter(series, 4)))]
        if max(quarter(series, 4)) > max(quarter(series, 2)) + 1:
            violations.append(f"{key} grew from {max(quarter(series, 2)):g} to {max(quarter(series, 4)):g}")
    for percent in (50.0, 99.0, 99.9):
        before, after = (float(np.percentile(quarter(waits, number), percent)) for number in (2, 4))
        figures[f"latency p{percent:g} [s]"] = [before, after]
        if percent == 99.9 and after > LATENCY_FACTOR * before + LATENCY_S:
            violations.append(f"latency p99.9 grew from {before:.3f} to {after:.3f} s")
    return figures, violations


def main():
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--minutes", type=float, default=60.0)
    parser.add_argument("--rate", type=float, default=30.0, help="exposures a second [Hz]")
    parser.add_argument("--out", required=True, help="folder for soak.json and logs")
    arguments = parser.parse_args()
    os.makedirs(arguments.out, exist_ok=True)
    folder = tempfile.mkdtemp(prefix="soak_", dir=arguments.out)
    source = make_sources([], arguments.rate, folder)[0]
    rig = Rig({**source, "folder": folder, "rate": arguments.rate, "graph": "plain", "seed": 1})
    try:
        rig.start_graph()
        if rig.judge.wait_until_well(START_S) is None:
            raise TimeoutError(f"the gate does not open: {rig.judge.last_text()}")
        queues, samples, since = Queues(), [], time.monotonic()
        while time.monotonic() < since + 60.0 * arguments.minutes:
            time.sleep(PERIOD_S)
            samples.append({"time_s": time.monotonic() - since, "queues": queues.now(),
                            "nodes": {node: process_figures(pid) for node, pid in rig.pids.items()}})
        until = time.monotonic() - 2.0  # what came later may be on its way
        exposures, answered, posed = rig.judge.answers(since, until)
        under_open, _ = rig.judge.errors(since, until)
        figures, violations = judge_soak(samples, latencies(rig.judge, rig.injector, since, until), exposures - answered)
    finally:
        rig.close()
        os.remove(source["bank"])
    figures.update(exposures=exposures, without_pose=exposures - posed, worst_open_mm=max(under_open, default=None),
                   sent_late=rig.injector.late, rate=arguments.rate, minutes=arguments.minutes)
    with open(os.path.join(arguments.out, "soak.json"), "w", encoding="utf-8") as file:
        json.dump({"figures": figures, "violations": violations, "samples": samples}, file, indent=1)
    for name, figure in figures.items():
        print(f"{name}: {figure}")
    print("\n".join(f"violation: {words}" for words in violations) or "nothing grew")
    sys.stdout.flush()
    os._exit(1 if violations else 0)


if __name__ == "__main__":
    main()
