"""Sums up the demo's two error histories: python3 demo_summary.py FOLDER."""

import csv
import sys


def row(folder, tolerance):
    with open(f"{folder}/history_tolerance_{tolerance}.csv", newline="") as file:
        steps = list(csv.DictReader(file))
    found = [float(s["error_before"]) for s in steps if s["error_before"]]
    stood = [float(s["error"]) for s in steps]
    again = [s for s in steps if s["repartitioned"] == "true" and s["error_before"]]
    return [
        tolerance,
        str(len(steps)),
        str(len(again)),
        f"{sum(found) / len(found):.3g}",
        f"{max(found):.3g}",
        f"{max(stood):.3g}",
        str(sum(int(s["drifted"]) + int(s["moved"]) for s in steps)),
        f"{sum(float(s['seconds_total']) for s in steps) * 1000:.3g}",
    ]


def main():
    heads = ["tolerance", "steps", "repartitions", "mean error", "largest error", "after the step", "points moved", "ms in service"]
    table = [heads] + [row(sys.argv[1], tolerance) for tolerance in ("inf", "0.1")]
    widths = [max(len(line[c]) for line in table) for c in range(len(heads))]
    for line in table:
        print("  ".join(cell.rjust(width) for cell, width in zip(line, widths)))


main()
