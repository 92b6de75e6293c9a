"""Ctrl-C: a command says where it stood, keeps what it has, and ends with 130; and the progress that a terminal shows."""
import contextlib
import csv
import pty
import re
import unittest.mock

from support import *


class Interrupt(ServiceTest):
    @classmethod
    def setUpClass(cls):
        with unittest.mock.patch.dict(os.environ, RCBD_SILENCE_SECONDS="300"):  # for ranks that stand still
            super().setUpClass()
        cls.points = cls.save("points.npy", np.random.default_rng(4).random((500, 3)))
        cls.long = cls.save("long.npy", np.random.default_rng(4).random((1, 20, 3)).repeat(60000, axis=0))

    def start(self, *words, **streams):
        """A program in whose process Ctrl-C isn't ignored, as it is where a shell runs this test in the background."""
        streams = {"stdout": subprocess.PIPE, "stderr": subprocess.PIPE} | streams
        process = subprocess.Popen([RCBCTL, *map(str, words)], **streams,
                                   env=dict(os.environ, RCBD_ENDPOINT=self.service.endpoint),
                                   preexec_fn=lambda: signal.signal(signal.SIGINT, signal.SIG_DFL))
        self.addCleanup(process.wait)
        self.addCleanup(process.kill)
        return process

    @contextlib.contextmanager
    def standing_still(self):
        """A rank does, so that nothing of which it must know is answered."""
        pid = next(host["pid"] for host in self.service.json("status")["hosts"] if host["rank"] == 1)
        os.kill(pid, signal.SIGSTOP)
        try:
            yield
        finally:
            os.kill(pid, signal.SIGCONT)

    @staticmethod
    def takes_interrupts(process):
        caught = next(line for line in text_of(f"/proc/{process.pid}/status").splitlines() if line.startswith("SigCgt:"))
        return int(caught.split()[1], 16) >> (signal.SIGINT - 1) & 1

    def interrupted(self, process):
        """What is said after Ctrl-C."""
        self.assertTrue(wait_for(lambda: self.takes_interrupts(process)))
        process.send_signal(signal.SIGINT)
        out, said = process.communicate(timeout=60)
        self.assertEqual(process.returncode, 130, said)
        return json.loads(out)["failure"] | {"said": said.decode()}

    def step_of(self, scene):
        done = self.service.ctl("error", scene, "--json")
        return json.loads(done.stdout)["step"] if done.returncode == 0 else -1

    def test_replay(self):
        history = os.path.join(self.dir, "history.csv")
        replay = self.start("replay", "long", self.long, "--parts", 4, "--history", history, "--json")
        self.assertTrue(wait_for(lambda: self.step_of("long") >= 5))
        failure = self.interrupted(replay)
        self.assertEqual((failure["code"], failure["exit"]), ("interrupted", 130))
        stand = int(re.search(r"after (\d+) steps, which stand|the (\d+) before it stand", failure["message"])[0].split()[1])
        with open(history) as file:
            self.assertEqual([int(row["step"]) for row in csv.DictReader(file)], list(range(stand)))
        self.assertIn(f"{history} has the reports of the {stand} steps before", failure["said"])
        self.assertIn(self.step_of("long"), (stand - 1, stand))

    def test_a_service_that_stands_still(self):
        out = os.path.join(self.dir, "out")
        with self.standing_still():
            partition = self.start("partition", self.points, "--parts", 4, "--out", out, "--json")
            failure = self.interrupted(partition)
        self.assertIn("nothing was written", failure["message"])
        self.assertFalse(os.path.exists(out))
        self.assertTrue(wait_for(lambda: "rcbctl-" not in self.service.ctl("scene", "list").stdout), "its scene is dropped")
        self.service.json("replay", "asked", self.points, "--parts", 4)
        for command in (["quality", "asked"], ["export", "asked", out]):
            with self.standing_still():
                process = self.start(*command, "--json")
                self.assertIn("interrupted", self.interrupted(process)["message"])
        self.assertFalse(os.path.exists(out))

    def test_watch_is_ended_by_it(self):
        self.service.json("replay", "watched", self.points, "--parts", 4)
        watch = self.start("watch", "watched", "--json")
        self.assertTrue(wait_for(lambda: self.takes_interrupts(watch)))
        watch.send_signal(signal.SIGINT)
        self.assertEqual((watch.communicate(timeout=60)[0], watch.returncode), (b"[]\n", 0))

    def shown(self, *words, until):
        """What a terminal shows of a command, until this matches; then it is interrupted."""
        terminal, its_end = pty.openpty()
        try:
            process = self.start(*words, stderr=its_end, stdout=subprocess.DEVNULL)
            os.close(its_end)
            text = ""
            while not re.search(until, text):
                text += os.read(terminal, 4096).decode()
            process.send_signal(signal.SIGINT)
            while True:
                try:
                    text += os.read(terminal, 4096).decode()
                except OSError:  # the other end is closed
                    break
            self.assertEqual(process.wait(60), 130, text)
            return text
        finally:
            os.close(terminal)

    def test_progress(self):
        text = self.shown("replay", "shown", self.long, "--parts", 4, until=r"\] \d\d+/60000 error")
        self.assertRegex(text, r"reading .*long.npy \.\.\.")
        self.assertRegex(text, r"\r\x1b\[Krcbctl: interrupted")
        with self.standing_still():
            self.shown("partition", self.points, "--parts", 4, until=r"points.npy: dividing \.\.\. \(\d s\)")
        with self.standing_still():
            self.shown("quality", "shown", until=r"waiting for the answer to 'quality' \(\d s\)")


if __name__ == "__main__":
    unittest.main(verbosity=2)
