"""What the tests of rcb_bench and rcb_stress share: a program is run, its JSON is read, wrong usage is refused."""
import json
import os
import subprocess
import tempfile

BIN = os.environ["RCBD_BIN_DIR"]


def run(program, *arguments, timeout=280):
    return subprocess.run([os.path.join(BIN, program), *arguments], capture_output=True, text=True, timeout=timeout)


def bench(*arguments):
    return run("rcb_bench", *arguments, timeout=200)


def measure(*arguments, run=bench, code=0):
    """The JSON of a run, and what it printed."""
    with tempfile.TemporaryDirectory() as folder:
        path = os.path.join(folder, "result.json")
        done = run(*arguments, "--json", path)
        assert done.returncode == code, done.stderr
        with open(path) as file:
            return json.load(file), done


def expect_refused(test, program, *usages):
    for arguments in usages:
        done = run(program, *arguments)
        test.assertEqual(done.returncode, 2, arguments)
        test.assertTrue(done.stderr.startswith(program + ": "), done.stderr)
