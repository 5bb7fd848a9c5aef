"""What a campaign found, as JSON and as a table."""
import json
import os

from scipy.stats import beta

from fault import UNSEEN
from faults import FAULTS

BEGIN, END = "<!-- table of faults: begin -->", "<!-- table of faults: end -->"


def bounded_rate(runs, violations, confidence=0.95):
    """Clopper and Pearson's upper bound of the rate; without a violation 1 - (1 - confidence)^(1 / runs)."""
    return 1.0 if violations >= runs else float(beta.ppf(confidence, violations + 1, runs - violations))


def largest(results, key, form):
    values = [result[key] for result in results if result.get(key) is not None]
    return format(max(values), form) if values else ""


def lost(results):
    """How many were not well again, as the target had gone too far unseen."""
    fault = FAULTS[results[0]["fault"]]
    if fault.graph == "started":
        return ""
    count = sum(result.get("recovered_s") is None and not result["violations"] for result in results)
    return f"; {count} not" if count else ""


def row(name, results):
    fault = FAULTS[name]
    closed = [result for result in results if result.get("closed_s") is not None]
    wrong = sum(result.get("wrong_open", 0) for result in results)
    return (f"| {fault.words} | {fault.must} | {fault.recovery} | {len(results)} | "
            f"{len(closed)}, {largest(closed, 'closed_s', '.2f')} | {largest(results, 'worst_open_mm', '.2f')} | {wrong} | "
            f"{largest(results, 'recovered_s', '.1f')}{lost(results)} | {sum(bool(result['violations']) for result in results)} |")


def table(results):
    lines = ["| fault | what must come of it | who ends it | runs | closed: runs, after s at most | worst pose under an open "
             "gate [mm] | of them > 2 mm | open again after s at most | violations |", "|---" * 9 + "|"]
    for name in FAULTS:
        own = [result for result in begun(results) if result["fault"] == name]
        if own:
            lines.append(row(name, own))
    return "\n".join(lines)


def begun(results):
    return [result for result in results if "not_begun" not in result]


def summary(results):
    not_begun = len(results) - len(begun(results))
    results = begun(results)
    violating = sum(bool(result["violations"]) for result in results)
    seen = [result for result in results if FAULTS[result["fault"]].must != UNSEEN]
    violating_seen = sum(bool(result["violations"]) for result in seen)
    sources = sorted({f"{result['source']} at {result['rate']:g} Hz" for result in results})
    return (f"{len(results)} runs ({', '.join(sources)}), {violating} of them with a violation. Of {len(seen)} runs of faults "
            f"that can be seen {violating_seen} violate: with 95 % confidence less than "
            f"{100 * bounded_rate(len(seen), violating_seen):.1f} % of such faults do."
            + (f" {not_begun} runs more were not begun, as the graph was not well before the fault." if not_begun else ""))


def document(results):
    return table(results) + "\n\n" + summary(results) + "\n"


def write(results, seed, folder):
    with open(os.path.join(folder, "report.json"), "w", encoding="utf-8") as file:
        json.dump({"seed": seed, "runs": results}, file, indent=1)
    with open(os.path.join(folder, "report.md"), "w", encoding="utf-8") as file:
        file.write(document(results))


def write_into(path, results):
    """Between the two comments of a Markdown file."""
    with open(path, encoding="utf-8") as file:
        before, rest = file.read().split(BEGIN)
    after = rest.split(END)[1]
    with open(path, "w", encoding="utf-8") as file:
        file.write(f"{before}{BEGIN}\n{document(results)}{END}{after}")


def conclude(results):
    """Says what violated. @return exit status"""
    faulty = [result for result in results if result["violations"] or "not_begun" in result]
    for result in faulty:
        words = "; ".join(result["violations"]) or result["not_begun"]
        print(f"{result['fault']}, seed {result['seed']}, {result['source']} at {result['rate']:g} Hz: {words}")
    print(summary(results))
    return 1 if faulty or not results else 0
