"""A solver of one process in Python: 3,000 points that drift, 100 steps, in 8 parts. Prints when new cuts were made."""
import sys

import numpy as np

import rcbd


def main():
    xyz = np.fmod(np.arange(9000) * 0.61803398875, 1.0).reshape(3000, 3)
    with rcbd.connect() as client:
        scene = client.scene("serial", parts=8, replace=True)
        for k in range(101):
            report = scene.step(xyz).report
            if report.repartitioned:
                print(f"step {k}: {report.reason}")
            xyz[:1500] *= 0.99  # the solver's own work: half of them drift


if __name__ == "__main__":
    try:
        main()
    except rcbd.Error as failure:
        sys.exit(str(failure))
