#!/usr/bin/python3
"""Counts the test cases of a catkin test_results folder, names those that failed and prints the closing line.

usage: summarize_tests.py RESULTS_DIR LOG      exit status 1 if a test failed or none ran
A case counts as skipped where its runner says so, or (rostest cannot) its suite's output has the line "skipped: NAME"; a
result file that cannot be read, or that catkin put in the place of one that a test never wrote, counts as failed."""
import pathlib
import sys
import xml.etree.ElementTree as ElementTree


def cases(results):
    """Yields (name, outcome) for each test case; outcome is passed, failed or skipped."""
    for path in sorted(results.rglob("*.xml")):
        try:
            root = ElementTree.parse(path).getroot()
        except (ElementTree.ParseError, OSError) as error:
            yield f"{path.name}: {error}", "failed"
            continue
        output = "".join(element.text or "" for element in root.iter("system-out")).splitlines()
        for case in root.iter("testcase"):
            name = f"{path.parent.name}/{path.stem}: {case.get('classname', '')}.{case.get('name', '')}"
            if case.find("failure") is not None or case.find("error") is not None:
                yield name, "failed"
            elif (case.find("skipped") is not None or "skipped" in (case.get("result"), case.get("status"))
                  or case.get("status") == "notrun" or f"skipped: {case.get('name')}" in output):
                yield name, "skipped"
            # rostest's own result says of a test node that passed no more than the node's result file does.
            elif not path.name.startswith("rostest-"):
                yield name, "passed"


def main():
    results, log = pathlib.Path(sys.argv[1]), sys.argv[2]
    outcomes = {"passed": [], "failed": [], "skipped": []}
    for name, outcome in cases(results):
        outcomes[outcome].append(name)
    for outcome in ("skipped", "failed"):
        for name in outcomes[outcome]:
            print(f"{outcome}: {name}")
    if outcomes["failed"]:
        print(f"log: {log}")
    counts = {outcome: len(names) for outcome, names in outcomes.items()}
    print("{passed} passed, {failed} failed, {skipped} skipped".format(**counts))
    return 1 if counts["failed"] or not counts["passed"] else 0


if __name__ == "__main__":
    sys.exit(main())
