"""One living graph into which faults are injected one after another. A process of its own, as it is a node of a master
that may die: session.py SPEC.json appends a line of JSON a run to the file that SPEC names, and ends early if the graph
does not live on."""
import json
import os
import re
import sys
import time
import traceback

import numpy as np
import rospy

from exposures import Bank, Setup
from fault import CLOSES, CLOSES_ONCE, NEVER_OPENS, UNSEEN, ends_graph
from faults import FAULTS
from graph import NODES, Graph, Master
from injector import Clock, Injector, RegistrationInTheMiddle, StaticTransforms
from judge import WRONG_MM, Judge

START_S = 90.0  # until the gate is open, from the graph's start
DEAD_NODE = re.compile(r"\[(?:/)?([\w/]+?)(?:-\d+)?\]")


class NotBegun(Exception):
    """The graph is not well before the fault, as on a machine that is too slow: no verdict on it."""


class Rig:
    """What faults may lay hands on."""

    def __init__(self, spec):
        self.folder, self.rate = spec["folder"], spec["rate"]
        self.master = Master(self.folder)
        self.graph_kind = spec["graph"]
        sim_time = self.graph_kind == "sim_time"
        rospy.set_param("/use_sim_time", sim_time)
        rospy.init_node("campaign", disable_signals=True)
        self.setup = Setup(spec["setup"])
        self.arguments = {"setup_file": self.setup.path, "source": self.setup.source, "sim_time": str(sim_time).lower(),
                          "interposed": str(self.graph_kind == "interposed").lower(),
                          "max_displacement": spec["max_displacement"],
                          "data_folder": os.path.dirname(spec["other_ct"])}
        if self.graph_kind == "record":
            self.arguments["record"] = os.path.join(self.folder, "recorded.bag")
        self.other_ct = spec["other_ct"]
        self.clock = Clock(sim_time)
        self.injector = Injector(Bank.load(spec["bank"]), self.setup, self.rate, self.clock, spec["seed"])
        self.judge = Judge(self.injector, self.setup.box_mm)
        self.transforms = StaticTransforms()
        self.middle = RegistrationInTheMiddle() if self.graph_kind == "interposed" else None
        self.graph, self.pids, self.onset = None, {}, None

    def start_graph(self):
        self.graph = Graph(self.folder, self.arguments)
        nodes = NODES + (("recorder",) if self.graph_kind == "record" else ())
        self.pids = self.graph.wait_for(nodes, START_S)
        end = time.monotonic() + START_S
        while unconnected := self.injector.unconnected(2):  # trackers or motion estimation, and registration
            if time.monotonic() > end:
                raise TimeoutError(f"two of trackers, motion estimation and registration do not listen to each topic "
                                   f"within {START_S} s; listeners: {unconnected}")
            time.sleep(0.1)
        self.injector.start()

    def use_setup(self, path):
        """What the graph takes for the geometry; the images are made in the true one."""
        self.arguments["setup_file"] = path
        self.injector.infos = {name: detector.camera_info() for name, detector in Setup(path).detectors.items()}

    def one_detector(self, random):
        return str(random.choice(sorted(self.setup.detectors)))

    def note_onset(self):
        if self.onset is None:
            self.onset = time.monotonic()

    def altering(self, alter, prepared=False):
        """@param prepared the first exposure that is altered is as it would be, and those after it are not"""
        seen = []

        def altered(sent, k):
            if not prepared or seen:
                self.note_onset()
            seen.append(k)
            alter(sent, k)
        self.injector.alter = altered
        return lambda: setattr(self.injector, "alter", None)

    def alter_one(self, name, change):
        return self.altering(lambda sent, k: change(sent[name], k))

    def alter_all(self, change, prepared=False):
        return self.altering(lambda sent, k: [change(one, k) for one in sent.values()], prepared)

    def show(self, show):
        def shown(k):
            self.note_onset()
            return show(k)
        self.injector.show = shown
        return lambda: setattr(self.injector, "show", None)

    def alter_answers(self, change):
        def altered(result):
            self.note_onset()
            change(result)
        self.middle.alter = altered
        return lambda: setattr(self.middle, "alter", None)

    def close(self):
        self.injector.stop()
        if self.graph:
            self.graph.stop()
        self.master.kill()


def closed_for_good(spans, onset):
    """Until the last moment at which the gate was open [s]."""
    return max((end - onset for _, end in spans), default=0.0)


def first_closed(spans, onset):
    """Until the gate was closed for the first time [s]."""
    until = onset
    for begin, end in spans:
        if begin - until > 1e-3:
            break
        until = end
    return until - onset


def judge_run(rig, fault, onset, ended, recovered, finished):
    """What came of a run, and what of that must not be."""
    bound = max(3.0 / rig.rate, 0.2)
    during = rig.judge.open_spans(onset, ended)
    under_open, all_errors = rig.judge.errors(onset, finished)
    exposures, answered, posed = rig.judge.answers(onset, ended)
    closed = (closed_for_good if fault.must == CLOSES else first_closed)(during, onset)
    stayed_open = closed > ended - onset - 0.01
    result = {"closed_s": None if stayed_open else closed, "bound_s": bound, "open_s": sum(e - b for b, e in during),
              "worst_open_mm": max(under_open, default=None), "worst_mm": max(all_errors, default=None),
              "wrong_open": sum(error > WRONG_MM for error in under_open), "exposures": exposures, "answered": answered,
              "posed": posed, "recovered_s": None if recovered is None else recovered - ended,
              "reasons": rig.judge.reasons(onset, ended)}
    violations = list(rig.judge.bad_numbers)
    if fault.must in (CLOSES, CLOSES_ONCE) and closed > bound:
        violations.append(f"the gate was open {closed:.3f} s after the fault, {bound:.3f} s are allowed")
    if fault.must == NEVER_OPENS and during:
        violations.append("the gate was open")
    if fault.must != UNSEEN and result["wrong_open"]:
        violations.append(f"{result['wrong_open']} poses of up to {result['worst_open_mm']:.2f} mm under an open gate")
    result["gone_too_far"] = bool(
        rig.judge.gone_too_far(onset, finished, rig.setup.initial_pose if fault.begins_anew else None))
    if recovered is None and rig.graph_kind != "started" and not result["gone_too_far"]:
        violations.append(f"not well again within {fault.recovery_s} s; {rig.judge.last_text()}")
    return result, violations


def deaths(rig, fault, since):
    """Processes that ended although the fault does not end them, in words; with nodes that do not answer."""
    found = []
    for line in rig.graph.deaths(since):
        node = DEAD_NODE.search(line)
        if not node or node.group(1) not in fault.dies + (("recorder",) if rig.graph_kind == "record" else ()):
            found.append(line)
    if rig.graph.process.poll() is not None:
        found.append("roslaunch has ended")
    if rig.master.process.poll() is None and fault.name != "master_dies":
        pids = rig.graph.pids(tuple(node for node in rig.pids if node != "recorder"))
        found += [f"{node} does not answer" for node, pid in pids.items() if pid is None]
        found += [f"{node} is another process than before" for node, pid in pids.items()
                  if pid and pid != rig.pids[node] and node not in fault.dies]
        rig.pids.update(pids)
    return found


def run_started(rig, run, fault, random):
    """Of a fault that is there before the graph is."""
    _, strength = fault.inject(rig, random)
    rig.start_graph()
    onset = time.monotonic()
    time.sleep(random.uniform(*fault.seconds) + 2.0)
    ended = time.monotonic()
    result, violations = judge_run(rig, fault, onset, ended, None, ended)
    return {**run, "strength": strength, **result, "violations": violations + deaths(rig, fault, 0)}


def run_fault(rig, run, fault, random):
    time.sleep(random.uniform(0.0, 1.0))
    if rig.judge.wait_until_well(START_S) is None:
        raise NotBegun(f"the graph is not well before the fault: {rig.judge.last_text()}")
    since, seconds = rig.graph.log_size(), random.uniform(*fault.seconds)
    begun, rig.onset = time.monotonic(), None
    end, strength = fault.inject(rig, random)
    alters = rig.injector.alter or rig.injector.show or (rig.middle and rig.middle.alter)
    while alters and rig.onset is None and time.monotonic() < begun + 5.0:
        time.sleep(0.002)
    onset = rig.onset or begun
    time.sleep(max(onset + seconds - time.monotonic(), 0.0))
    ended = time.monotonic()
    if end:
        end()
    recovered = rig.judge.wait_until_well(fault.recovery_s)
    time.sleep(0.5)
    finished = time.monotonic()
    result, violations = judge_run(rig, fault, onset, ended, recovered, finished)
    violations += deaths(rig, fault, since)
    return {**run, "seconds": ended - onset, "strength": strength, **result, "violations": violations}


def perform(rig, run):
    """@return the run's result; whether the graph lives on"""
    fault, random = FAULTS[run["fault"]], np.random.default_rng(run["seed"])
    try:
        result = (run_started if rig.graph_kind == "started" else run_fault)(rig, run, fault, random)
    except NotBegun as error:
        return {**run, "violations": [], "not_begun": str(error)}, False
    except Exception as error:  # whatever it is, the campaign is to hear of it
        traceback.print_exc()
        return {**run, "violations": [f"it could not be run: {error}"]}, False
    result["late_sends"] = rig.injector.late
    lives = rig.graph_kind != "started" and not ends_graph(fault) and result["recovered_s"] is not None
    return result, lives


def main(path):
    with open(path, encoding="utf-8") as file:
        spec = json.load(file)
    rig = Rig(spec)
    try:
        if rig.graph_kind != "started":
            rig.start_graph()
        for run in spec["runs"]:
            result, lives = perform(rig, run)
            with open(spec["out"], "a", encoding="utf-8") as file:
                file.write(json.dumps(result) + "\n")
            print(f"{run['source']} {run['rate']:g} Hz, {run['fault']} ({result.get('strength', '')}): "
                  f"{'; '.join(result['violations']) or result.get('not_begun', 'as it must')}", flush=True)
            if not lives:
                break
    finally:
        rig.close()


if __name__ == "__main__":
    status = 1
    try:
        main(sys.argv[1])
        status = 0
    except Exception:  # of a graph that does not come up; the campaign goes on with the next one
        traceback.print_exc()
    sys.stdout.flush()
    os._exit(status)  # rospy's threads may wait for a master that is dead
