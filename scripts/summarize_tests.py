#!/usr/bin/python3
"""Counts the test cases of a catkin test_results folder, names those that failed and prints the closing line.

usage: summarize_tests.py RESULTS_DIR LOG      exit status 1 if a test failed or none ran
A case counts as skipped where its runner says so; a result file that cannot be read, or that catkin put in the place of
one that a test never wrote, counts as failed."""
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
        for case in root.iter("testcase"):
            # rostest wraps each of its test nodes' own result files in a file that says no more than those do.
            name = f"{path.parent.name}/{path.stem}: {case.get('classname', '')}.{case.get('name', '')}"
            if case.find("failure") is not None or case.find("error") is not None:
                yield name, "failed"
            elif case.find("skipped") is not None or case.get("status") == "notrun" or case.get("result") == "skipped":
                yield name, "skipped"
            else:
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
