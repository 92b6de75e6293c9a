"""A session with rcbctl as a person sees it, word for word: golden/session.txt. What a run changes (times, memory, paths)
stands there as #. RCB_GOLDEN_WRITE=1 writes the file anew, to be read before it is committed."""
import difflib
import re

from support import *

GOLDEN = os.path.join(os.path.dirname(os.path.abspath(__file__)), "golden", "session.txt")
MASKS = [(r"\b\d+:\d\d:\d\d\b", "#"), (r"\b[\d.]+(e-?\d+)? (ms|KiB|MiB|GiB)\b", r"# \2"),
         (r"(?m)^milliseconds .*", "milliseconds #"), (r"(?m)^(version|endpoint|log|memory|time a step) .*", r"\1 #"),
         (r"(?m)^time  .* s$", "time #")]


def masked(text, folder):
    for pattern, instead in MASKS:
        text = re.sub(pattern, instead, text.replace(folder, "DIR"))
    # A table with times is as wide as they are.
    return re.sub(r"(?m)^\$ rcbctl compare [^$]*", lambda block: re.sub(r"(?<=\S) {2,}", "  ", block.group()), text)


def write_inputs(folder):
    lattice = np.stack(np.meshgrid(*[np.arange(8.0)] * 3, indexing="ij"), -1).reshape(-1, 3)
    # Sums and products only: those are the same on every CPU, which numpy's powers are not.
    drop = np.modf(np.outer(np.arange(1, 601), [0.7548776662466927, 0.5698402909980532, 0.4301597090019468]))[0]
    for name, points in (("lattice.csv", lattice), ("drop.csv", drop), ("later.csv", drop * (0.9 + 0.1 * drop))):
        np.savetxt(os.path.join(folder, name), points, delimiter=",", header="x,y,z", comments="")
    np.savez(os.path.join(folder, "drop.npz"), xyz=drop)
    open(os.path.join(folder, "empty.csv"), "w").close()


class Golden(unittest.TestCase):
    maxDiff = None

    def test_session(self):
        expected = text_of(GOLDEN)
        with tempfile.TemporaryDirectory() as folder, Service(2) as service:
            write_inputs(folder)
            actual = ""
            for line in re.findall(r"^\$ rcbctl (.*)$", expected, re.M):
                done = service.ctl(*line.split(), cwd=folder)
                actual += f"$ rcbctl {line}\n{done.stdout}{done.stderr}"
                actual += f"[exit {done.returncode}]\n\n" if done.returncode else "\n"
            actual = masked(actual.replace(service.dir, "SERVICE"), folder)
        if os.environ.get("RCB_GOLDEN_WRITE"):
            write_text(GOLDEN, actual)
        if actual != expected:
            self.fail("\n".join(difflib.unified_diff(expected.splitlines(), actual.splitlines(), "golden", "now",
                                                     lineterm="")))


if __name__ == "__main__":
    unittest.main(verbosity=2)
