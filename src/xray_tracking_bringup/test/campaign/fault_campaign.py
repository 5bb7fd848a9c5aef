#!/usr/bin/python3
"""Injects faults into living graphs, and reports what came of them. See docs/safety.md."""
import argparse
import collections
import json
import os
import subprocess
import sys
import tempfile

import numpy as np
import rospkg

sys.path.insert(0, os.path.dirname(os.path.abspath(__file__)))
from exposures import Setup, bank_of_sequence  # noqa: E402
from fault import ends_graph  # noqa: E402
from faults import FAULTS  # noqa: E402
from graph import Master  # noqa: E402
import report  # noqa: E402

HERE = os.path.dirname(os.path.abspath(__file__))
RATES = (5.0, 30.0)
SESSION_S = 3600.0
PHANTOM_MM, SEQUENCE_MM = 8.0, 60.0  # gate/max_displacement, wider than the motion
PIXELS_A_SECOND = 2e7  # that one process of Python can send


def phantom_setup():
    return os.path.join(rospkg.RosPack().get_path("xray_tracking_core"), "config", "phantom_neck.yaml")


def write_other_ct(setup, path):
    """Somebody else's bones at the same place, as a MetaImage: two rods across in a ball of water."""
    centre, spacing = np.mean(setup.box_mm, axis=0), 2.0
    axis = (np.arange(80) - 39.5) * spacing
    z, y, x = np.meshgrid(axis, axis, axis, indexing="ij")
    hu = np.where(x * x + y * y + z * z < 75.0 ** 2, 0, -1000).astype("<i2")
    hu[(np.hypot(x - 12, z + 5) < 8) | (np.hypot(y + 9, x + 9) < 7)] = 900
    with open(path, "wb") as file:
        file.write(("ObjectType = Image\nNDims = 3\nDimSize = 80 80 80\nElementType = MET_SHORT\n"
                    f"ElementSpacing = {spacing} {spacing} {spacing}\n"
                    f"Offset = {' '.join(str(number) for number in centre - 39.5 * spacing)}\n"
                    "TransformMatrix = 1 0 0 0 1 0 0 0 1\nElementByteOrderMSB = False\n"
                    "ElementDataFile = LOCAL\n").encode())
        file.write(hu.tobytes())


def make_source(name, setup_path, bank, other_ct, max_displacement):
    return {"name": name, "setup": setup_path, "bank": bank, "other_ct": other_ct, "max_displacement": max_displacement}


def make_sources(sequences, rate, folder):
    """Banks of exposures: the phantom's, for this rate and what divides it, and one a sequence folder."""
    bank, ct = os.path.join(folder, "phantom.npz"), os.path.join(folder, "other_ct.mha")
    master = Master(folder)
    try:
        subprocess.run([sys.executable, os.path.join(HERE, "exposures.py"), phantom_setup(), bank, str(rate)],
                       check=True, timeout=300)
    finally:
        master.kill()
    write_other_ct(Setup(phantom_setup()), ct)
    sources = [make_source("phantom", phantom_setup(), bank, ct, PHANTOM_MM)]
    for sequence in sequences:
        name = os.path.basename(os.path.realpath(sequence))
        setup = os.path.join(sequence, "sequence.yaml")
        bank, ct = (os.path.join(folder, name + end) for end in (".npz", "_other_ct.mha"))
        bank_of_sequence(sequence).save(bank)
        write_other_ct(Setup(setup), ct)
        sources.append(make_source(name, setup, bank, ct, SEQUENCE_MM))
    return sources


def plan(faults, sources, rates, count, seed):
    """`count` runs: all faults in turn, each of them in turn of all sources and rates."""
    random = np.random.default_rng(seed)
    settings = [(source["name"], rate) for source in sources for rate in rates
                if rate * Setup(source["setup"]).pixels <= PIXELS_A_SECOND]
    turns = {fault: list(random.permutation(len(settings))) for fault in faults}
    runs = []
    for number in range(count):
        fault = faults[number % len(faults)]
        of_fault = [settings[i] for i in turns[fault] if settings[i][0] == "phantom" or fault != "cough"]
        source, rate = of_fault[number // len(faults) % len(of_fault)]
        runs.append({"run": number, "fault": fault, "seed": int(random.integers(1 << 31)), "source": source,
                     "rate": rate})
    return runs


def sessions(runs, seed):
    """Lists of runs that one graph may live through, those that end it last."""
    groups = collections.defaultdict(list)
    for run in runs:
        graph = FAULTS[run["fault"]].graph
        groups[run["source"], run["rate"], graph].append(run)
    for (_, _, graph), group in groups.items():
        random = np.random.default_rng(seed)
        group = [group[i] for i in random.permutation(len(group))]
        lasting = [run for run in group if not ends_graph(FAULTS[run["fault"]])]
        ending = [run for run in group if ends_graph(FAULTS[run["fault"]])]
        yield from ([run] for run in group) if graph == "started" else [lasting + ending]


def run_session(runs, source, folder, number, seed):
    """@return results; a graph that does not live on leaves the rest to the next one"""
    results = []
    while runs:
        number[0] += 1
        own = os.path.join(folder, f"session_{number[0]:03d}")
        os.makedirs(own)
        out, spec_path = os.path.join(own, "results.jsonl"), os.path.join(own, "spec.json")
        spec = {**{key: source[key] for key in ("setup", "bank", "other_ct", "max_displacement")}, "folder": own,
                "graph": FAULTS[runs[0]["fault"]].graph, "rate": runs[0]["rate"], "runs": runs, "out": out,
                "seed": seed + number[0]}
        with open(spec_path, "w", encoding="utf-8") as file:
            json.dump(spec, file)
        session = subprocess.Popen([sys.executable, os.path.join(HERE, "session.py"), spec_path])
        failure = {}
        try:
            if session.wait(SESSION_S):
                failure = {"violations": [], "not_begun": "the graph does not come up"}
        except subprocess.TimeoutExpired:
            session.kill()
            failure = {"violations": [f"the session did not end within {SESSION_S} s"]}
        done = []
        if os.path.exists(out):
            with open(out, encoding="utf-8") as file:
                done = [json.loads(line) for line in file]
        if len(done) < len(runs) and (failure or not done):
            done.append({**runs[len(done)], "violations": ["the session ended without a result"], **failure})
        results += done
        runs = runs[len(done):]
    return results


def main():
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--runs", type=int, default=200)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--out", required=True, help="folder for report.json, report.md and logs")
    parser.add_argument("--faults", nargs="+", choices=sorted(FAULTS), default=list(FAULTS), metavar="FAULT")
    parser.add_argument("--rates", nargs="+", type=float, default=list(RATES), metavar="HZ")
    parser.add_argument("--sequences", nargs="*", default=[], metavar="DIR",
                        help="sequence folders with a gold standard to be played, beside the phantom")
    parser.add_argument("--table", help="Markdown file whose table of faults is written anew")
    arguments = parser.parse_args()
    if arguments.runs < 1:
        parser.error(f"--runs {arguments.runs}: expected 1 or more")
    os.makedirs(arguments.out, exist_ok=True)
    folder = tempfile.mkdtemp(prefix="sessions_", dir=arguments.out)
    sources = make_sources(arguments.sequences, max(arguments.rates), folder)
    by_name = {source["name"]: source for source in sources}
    number, results = [0], []
    for runs in sessions(plan(arguments.faults, sources, arguments.rates, arguments.runs, arguments.seed),
                         arguments.seed):
        results += run_session(runs, by_name[runs[0]["source"]], folder, number, arguments.seed)
        report.write(results, arguments.seed, arguments.out)
    for source in sources:
        os.remove(source["bank"])
    if arguments.table:
        report.write_into(arguments.table, results)
    return report.conclude(results)


if __name__ == "__main__":
    sys.exit(main())
