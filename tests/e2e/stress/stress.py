#!/usr/bin/python3
"""Everything at once: pushes by every way, seats that die, questions, bytes that no client sends, stopped processes,
a full disk, on one service, for seconds (as a test of the suite) or an hour (as a command, on a build with sanitizers).

    tests/e2e/stress/stress.py --seconds 3600 --build build/asan --seed 7

It ends with a table of what was done and with what failed; its exit code is 0 if nothing did."""
import argparse
import os
import random
import shutil
import signal
import subprocess
import sys
import tempfile

HERE = os.path.dirname(os.path.abspath(__file__))
ROOT = os.path.normpath(os.path.join(HERE, "..", "..", ".."))
INSIDE = "RCB_STRESS_INSIDE"  # set in the mount namespace that this program makes for itself
DISK_BYTES, DISK_FILES = 24 << 20, 500
ONLY_LONG_SECONDS = 300
sys.path.append(os.path.dirname(HERE))
TWICE = ("ways", "seats", "readers", "fuzz")  # in the long form


def parse():
    programs = os.environ.get("RCBD_BIN_DIR")
    build = os.path.dirname(programs) if programs else os.path.join(ROOT, "build", "release")
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--seconds", type=float, default=20, help="how long (default: %(default)s)")
    parser.add_argument("--build", default=build, help="build folder (default: %(default)s)")
    parser.add_argument("--seed", type=int, help="default: another one each time")
    parser.add_argument("--ranks", type=int, default=3, help="of the service (default: %(default)s)")
    parser.add_argument("--only", metavar="LIST", help="these actors alone, with commas between")
    parser.add_argument("--without", metavar="LIST", default="", help="actors to leave out")
    parser.add_argument("--kill", action="store_true", help="kill ranks, too; the service is started again")
    parser.add_argument("--keep", action="store_true", help="leave the work directory")
    parser.add_argument("--list", action="store_true", help="print the actors and what they expect, no more")
    return parser.parse_args()


def actor_classes():
    import commands
    import faults
    import fuzz
    import seats
    import mob
    import pushers
    import queries
    import scenes
    import solvers
    return {
        "ways": pushers.Ways, "quitters": pushers.Quitters, "liars": pushers.Liars, "seats": seats.Seats, "mob": mob.Mob,
        "spheres": solvers.TwoSpheres, "slope": solvers.SlopeSeats,
        "readers": queries.Readers, "pipelined": queries.Pipelined, "flood": queries.Flood, "rude": queries.Rude,
        "costly": queries.Costly, "crowd": queries.Crowd, "commands": commands.Commands, "fuzz": fuzz.Fuzz,
        "scenes": scenes.Scenes, "files": scenes.Files,
        "stops": faults.Stops, "disk": faults.Disk, "kills": faults.Kills,
    }


def chosen(arguments, classes):
    """[(name, class)] of what this run does."""
    names = arguments.only.split(",") if arguments.only else list(classes)
    unknown = [name for name in [*names, *filter(None, arguments.without.split(","))] if name not in classes]
    if unknown:
        sys.exit(f"no such actors: {', '.join(unknown)}; --list names them")
    left_out = set(arguments.without.split(","))
    if not arguments.kill:
        left_out.add("kills")
    if "disk" in names and os.environ.get(INSIDE) != "1":
        print("SKIPPED: the full disk, which needs root and mount namespaces", flush=True)
        left_out.add("disk")
    names = [name for name in names if name not in left_out]
    if arguments.seconds >= ONLY_LONG_SECONDS:
        names += [name for name in TWICE if name in names]
    return [(name, classes[name]) for name in names]


def enter_namespace():
    """Starts this program again where it may mount a small file system of its own."""
    if INSIDE in os.environ:
        return
    probe = subprocess.run(["unshare", "-m", "sh", "-c", "mount -t tmpfs none /mnt"], capture_output=True)
    if os.geteuid() == 0 and probe.returncode == 0:
        os.environ[INSIDE] = "1"
        os.execvp("unshare", ["unshare", "-m", "--propagation", "private", sys.executable, *sys.argv])


def data_directory(folder):
    data = os.path.join(folder, "data")
    os.makedirs(data, mode=0o700)
    if os.environ.get(INSIDE) == "1":
        subprocess.run(["mount", "-t", "tmpfs", "-o", f"size={DISK_BYTES},nr_inodes={DISK_FILES},mode=0700", "none", data], check=True)
    return data


def main():
    arguments = parse()
    classes = actor_classes()
    if arguments.list:
        for name, kind in classes.items():
            print(f"{name:10} {kind.expects}")
        return 0
    enter_namespace()
    actors = chosen(arguments, classes)
    from run import Run
    seed = random.SystemRandom().randrange(2**31) if arguments.seed is None else arguments.seed
    print(f"seed {seed}", flush=True)
    folder = tempfile.mkdtemp(prefix="rcb-stress-")
    signal.signal(signal.SIGTERM, lambda *_: sys.exit(143))
    data = data_directory(folder)
    good = False
    try:
        run = Run(os.path.abspath(arguments.build), seed, arguments.ranks, folder, data, arguments.seconds,
                  2 if arguments.seconds > 60 else 0.5)
        good = run.play(actors)
    finally:
        leave(folder, data, keep=arguments.keep or not good)
    return 0 if good else 1


def leave(folder, data, keep):
    if keep:
        import faults
        kept = os.path.join(folder, "data-kept")
        shutil.copytree(data, kept, ignore=shutil.ignore_patterns(faults.FILLING, "tmp"))  # it ends with the namespace
        print(f"\nlogs and reports: {folder}")
    if os.environ.get(INSIDE) == "1":
        subprocess.run(["umount", "-l", data], check=False)
    if not keep:
        shutil.rmtree(folder, ignore_errors=True)


if __name__ == "__main__":
    sys.exit(main())
