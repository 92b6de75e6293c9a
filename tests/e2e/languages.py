"""What the tests of the languages share: one trajectory, stepped by programs of 1 and 4 processes and by rcbctl replay, is one
history; and programs of cases."""
import contextlib

from seats_client import FIELDS
from support import *

ROOT = os.path.abspath(os.path.join(os.path.dirname(__file__), "..", ".."))
INCLUDE = os.path.join(ROOT, "client", "include")
LIB = os.path.abspath(os.path.join(BIN, "..", "lib"))
SEED, PARTS, STEPS = 4301, 7, 100
TOLD = tuple(field for field in FIELDS if field != "reason")


def drifting(seed, points, dims):
    """STEPS steps of points that drift; on a grid, so that ids decide too."""
    rng = np.random.default_rng(seed)
    start = rng.random((points, dims))
    return np.round((start + rng.normal([0.01] + [0] * (dims - 1), 0.01, (STEPS, points, dims)).cumsum(axis=0)) * 40) / 40


def steps_of(text):
    """What c_history prints: (by step: the values of TOLD and the hash; how many steps were sent)."""
    kinds = (int, int, int, float, float, float, lambda flag: flag == "1", int, int, int, str, int)
    rows = [[kind(word) for kind, word in zip(kinds, line.split(), strict=True)] for line in text.splitlines() if line != "made"]
    for row in rows:
        row[3] = None if np.isnan(row[3]) else row[3]
    return [row[:-1] for row in rows], sum(row[-1] for row in rows)


class LanguageTest(ServiceTest):
    def processes(self, program, scene, path, seats, positions, *more):
        """What each of so many processes prints, which step the trajectory together. program: its words, to which those of
        tests/client/c/history.c are added."""
        raw = os.path.join(self.dir, scene)
        np.ascontiguousarray(path).tofile(raw)
        started = []
        try:
            for seat in range(seats):
                words = [self.service.endpoint, scene, raw, path.shape[1], path.shape[2], len(path), PARTS, positions, seat, seats,
                         *more]
                started.append(subprocess.Popen([*program, *map(str, words)], stdout=subprocess.PIPE,
                                                stderr=subprocess.PIPE, bufsize=0))
                if seat == 0:  # without a buffer, in which communicate() would not find what was read after this line
                    self.assertEqual(started[0].stdout.readline(), b"made\n")
            done = [[text.decode() for text in one.communicate(timeout=120)] for one in started]
        finally:
            for one in started:
                with contextlib.suppress(ProcessLookupError):
                    one.kill()
                one.wait()
                one.stdout.close()
                one.stderr.close()
        for one, (_, complaints) in zip(started, done):
            self.assertEqual((one.returncode, complaints), (0, ""))
        return [text for text, _ in done]

    def cases_of(self, name, number, **surroundings):
        program = os.path.join(BIN, name)
        cases = run(program=program, check=True).stdout.split()
        self.assertEqual(len(cases), number)
        for case in cases:
            with self.subTest(case):
                done = run(self.service.endpoint, case, program=program, env=surroundings)
                self.assertEqual((done.returncode, done.stdout, done.stderr), (0, "", ""))

    def one_history(self, program, *more):
        """By 1 and 4 processes, sent or counted, and by rcbctl replay."""
        for place, path in (("space", drifting(SEED, 600, 3)), ("plane", drifting(SEED + 1, 400, 2))):
            name = self._testMethodName + "-" + place
            file = self.save(name + ".npy", path)
            self.service.json("replay", name, file, "--parts", PARTS, "--tolerance", 0.1)
            expected = [[report[field] for field in TOLD] for report in self.service.json("history", name)]
            last_hash = self.service.json("scene", "show", name)["hash"]
            repartitioned = TOLD.index("repartitioned")
            new_cuts = sum(told[repartitioned] for told in expected)
            self.assertTrue(5 < new_cuts < STEPS - 5, new_cuts)
            for seats in (1, 4):
                for positions in ("every-step", "when-needed"):
                    with self.subTest(name, seats=seats, positions=positions, seed=SEED):
                        texts = self.processes(program, f"{name}-{seats}-{positions}", path, seats, positions, *more)
                        self.assertTrue(all(text.replace("made\n", "") == texts[-1].replace("made\n", "") for text in texts))
                        told, sent = steps_of(texts[0])
                        self.assertEqual([step[:-1] for step in told], expected)
                        self.assertEqual(told[-1][-1], last_hash)
                        # The last one is told to.
                        self.assertEqual(sent, STEPS if positions == "every-step" else new_cuts + (not expected[-1][repartitioned]))

    def serial_example(self, *program):
        """Prints the same as the one in C."""
        told = [run(*words[1:], program=words[0], endpoint=self.service.endpoint, check=True).stdout
                for words in (program, [os.path.join(BIN, "serial_c")])]
        self.assertEqual(told[0], told[1])
        self.assertIn("has reached the tolerance", told[0])
        failed = run(*program[1:], program=program[0], endpoint="unix:/nonexistent/rcbd.sock")
        self.assertEqual(failed.returncode, 1)
        self.assertIn("no service answers", failed.stderr)
