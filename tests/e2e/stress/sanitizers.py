"""What a build's sanitizers are told, and what of their reports counts."""
import glob
import os
import re

HERE = os.path.dirname(os.path.abspath(__file__))
# How much longer a program may take than an optimised one.
PATIENCE = {"": 1, "address,undefined": 4, "thread": 8}

# A frame of this project's own sources.
OURS = re.compile(r"/(common|server|client)/[\w/]+\.[ch]pp:\d+")
LEAKS = re.compile(r"^==\d+==ERROR: LeakSanitizer.*?^SUMMARY: .*?$", re.M | re.S)


def of_build(build):
    """What a build folder was configured with, as -fsanitize takes it."""
    with open(os.path.join(build, "CMakeCache.txt")) as file:
        found = re.search(r"^RCB_SANITIZE:\w+=(.*)$", file.read(), re.M)
    return found.group(1) if found else ""


def environment(folder):
    """Findings go to files in a folder, and a program goes on after one."""
    common = f"log_path={folder}/report:halt_on_error=0:print_stacktrace=1:print_suppressions=0"
    return {
        "ASAN_OPTIONS": f"{common}:detect_leaks=1:quarantine_size_mb=16:allocator_release_to_os_interval_ms=1000",
        "UBSAN_OPTIONS": common,
        "LSAN_OPTIONS": f"suppressions={HERE}/suppressions/leak.txt:exitcode=0",
        "TSAN_OPTIONS": f"{common}:suppressions={HERE}/suppressions/thread.txt:second_deadlock_stack=1",
    }


def findings(folder):
    """What the programs' reports say: {path: text}."""
    found = {}
    for path in glob.glob(os.path.join(folder, "report*")):
        with open(path, errors="replace") as file:
            text = LEAKS.sub(our_leaks, file.read()).strip(" =\n")
        if text:
            found[path] = text
    return found


def our_leaks(report):
    """Open MPI, its plug-ins and hwloc leave memory at their end, and the plug-ins are gone then, so that their stacks have
    no names: a leak is ours if any frame of its stack is."""
    leaks = [leak for leak in report.group(0).split("\n\n") if " leak of " in leak and OURS.search(leak)]
    return "\n\n".join(leaks)
