#!/usr/bin/python3
"""What TLS costs: steps and connections of a client on one machine, to a service with it and to one without on another
(tests/hosts; so both machines share this one's cores). Needs root.

    tests/bench/step/encryption.py [--ranks R] [--repeats K] [--variants LIST] [--build DIR] [further options of `rcb_bench step`]
"""
import argparse
import os
import shutil
import sys

ROOT = os.path.abspath(os.path.join(os.path.dirname(__file__), "..", "..", ".."))
sys.path.insert(0, os.path.join(ROOT, "tests", "hosts"))
from hosts import Hosts


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--ranks", default="2")
    parser.add_argument("--repeats", default="41")
    parser.add_argument("--variants", default="sockets,endpoint,float32,count,connect")
    parser.add_argument("--build", default=os.path.join(ROOT, "build", "release"))
    told, more = parser.parse_known_args()
    with Hosts(2) as hosts:
        environment = hosts.environment(RCBD_BIN_DIR=hosts.shared)
        for program in ("rcbd", "rcbctl", "rcb_bench"):
            shutil.copy(os.path.join(told.build, "bin", program), hosts.shared)

        def run(name, program, *args, **kwargs):
            return hosts.run(name, os.path.join(hosts.shared, program), *args, env=environment, **kwargs)

        files = []
        for port, name, option in ((7470, "encrypted", []), (7471, "plain", ["--trusted-network"])):
            files.append("file:" + os.path.join(hosts.shared, name))
            run("a", "rcbctl", "up", "-n", told.ranks, "--endpoint", f"{hosts.address('a')}:{port}", "--data-dir",
                os.path.join(hosts.shared, f"data-{name}"), "--publish", files[-1][5:], *option, check=True)
        done = run("b", "rcb_bench", "step", "--scenes", "moving", "--variants", told.variants, "--ranks", told.ranks,
                   "--repeats", told.repeats, "--services", ",".join(files), *more)
        for file in files:
            run("a", "rcbctl", "down", "--endpoint", file, check=True)
        return done.returncode


if __name__ == "__main__":
    sys.exit(main())
