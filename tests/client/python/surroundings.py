"""Surroundings in which a solver may call: threads, forks, signals, another floating-point environment; steps that somebody ends."""
import asyncio
import ctypes
import os
import signal
import subprocess
import sys
import tempfile
import threading
import time

from expect import *
from rcbd import _waiting


class Threads(WithClient):
    def test_two_threads(self):
        """Of one scene, and of two, and questions beside."""
        one, two = self.client.scene("one", 8, replace=True), self.client.scene("two", 8, replace=True)
        xyz = points()
        one.step(xyz), two.step(xyz)
        cuts, faults = one.cuts, []
        expected = cuts.owner(xyz)

        def work(scene):
            try:
                for _ in range(50):
                    self.assertEqual(scene.step(xyz).report.n, 3000)
                    np.testing.assert_array_equal(scene.cuts.owner(xyz), expected)
                    self.assertEqual(len(cuts.halo(xyz, 0.1)), 8)
            except BaseException as fault:
                faults.append(fault)

        threads = [threading.Thread(target=work, args=(scene,)) for scene in (one, one, two)]
        for thread in threads:
            thread.start()
        work(two)
        for thread in threads:
            thread.join()
        self.assertEqual(faults, [])
        self.assertEqual((one.last_step, two.last_step), (100, 100))

    def test_fork(self):
        """A child's calls fail, and leave the connection alone; it may connect by itself."""
        scene = self.opened()
        xyz = points()
        step = scene.step(xyz)
        scene.step_begin(xyz).wait()
        cuts = scene.cuts
        for end in (os._exit, sys.exit):
            child = os.fork()
            if child == 0:
                wrong = []
                for call in (lambda: scene.step(xyz), lambda: scene.step_begin(xyz), lambda: scene.cuts, lambda: scene.last_step,
                             lambda: cuts.owner(xyz), lambda: step.parts, scene.close, self.client.close,
                             lambda: self.client.scene("a", 8)):
                    try:
                        call()
                        wrong.append("no failure")
                    except rcbd.Error as failure:
                        if failure.code != "unsupported" or "forked" not in failure.message:
                            wrong.append(str(failure))
                with rcbd.connect() as own:
                    wrong += [] if own.scene("forked", 2, replace=True).step(xyz).report.n == 3000 else ["a wrong n"]
                for fault in wrong:
                    print("in the child:", fault, file=sys.stderr, flush=True)
                os._exit(len(wrong)) if end is os._exit else os.execv(sys.executable, [sys.executable, "-c", f"exit({len(wrong)})"])
            self.assertEqual(os.waitpid(child, 0)[1], 0)
            self.assertEqual(scene.step(xyz).report.n, 3000)
        self.assertEqual(scene.last_step, 3)

    def test_an_exit_without_close(self):
        """With a step under way, and handles of all kinds."""
        text = ("import rcbd, numpy as np\nclient = rcbd.connect()\nscene = client.scene('left', 2, replace=True, seats=2)\n"
                "xyz = scene.positions(9); xyz[:] = 0\nop = scene.step_begin(xyz, range(9))\nop.wait(0.2)\nprint('end')")
        done = subprocess.run([sys.executable, "-c", text], capture_output=True, text=True, timeout=60)
        self.assertEqual((done.returncode, done.stdout, done.stderr), (0, "end\n", ""))


class Signals(WithClient):
    """A step waits for a seat that is missing, until Ctrl-C."""

    def setUp(self):
        super().setUp()
        self.scene = self.opened(2, seats=2)
        self.xyz = points(100)
        self.addCleanup(signal.signal, signal.SIGINT, signal.default_int_handler)

    def soon(self, number=signal.SIGINT, seconds=0.3):
        timer = threading.Timer(seconds, os.kill, (os.getpid(), number))
        timer.start()
        self.addCleanup(timer.join)

    def waits(self, deadline_seconds=3000):  # so that whoever isn't interrupted is missed
        return self.scene.step(self.xyz[:50], np.arange(50), deadline_seconds=deadline_seconds)

    def both_step(self):
        """The scene is usable: with the seat that was missing the step is made."""
        with rcbd.connect() as another:
            seat = another.scene(self.scene.name, 2, seat=1, seats=2)
            op = seat.step_begin(self.xyz[50:], np.arange(50, 100))
            self.assertEqual(self.waits().report.n, 100)
            self.assertEqual(op.wait().report.n, 100)

    def test_ctrl_c(self):
        for _ in range(2):
            self.soon()
            with self.assertRaises(KeyboardInterrupt):
                self.waits()
        self.both_step()
        self.assertEqual(signal.set_wakeup_fd(-1), -1)

    def test_ctrl_c_beside_quick_steps(self):
        """It ends no later call."""
        scene = self.client.scene("quick", 2, replace=True)
        for _ in range(5):
            self.soon(seconds=0.05)
            with self.assertRaises(KeyboardInterrupt):
                while True:
                    scene.step(self.xyz)
        time.sleep(0.3)  # as long as a call that goes on would not be ended
        with self.fails("deadline_exceeded"):
            self.waits(deadline_seconds=0.5)
        self.both_step()

    def test_ctrl_c_where_files_were_closed(self):
        """The program closes all files that it doesn't know, the pipe of the watch as well, and opens others with these numbers:
        they get nothing, and lose nothing."""
        scene = self.client.scene("quick", 2, replace=True)
        scene.step(self.xyz)
        for which in (slice(None), slice(0, 1), slice(1, 2)):  # both ends, the one to read, the one to write
            watch = sorted(number for number in map(int, os.listdir("/proc/self/fd")) if _waiting._watch.owns(number))[which]
            with tempfile.TemporaryFile(buffering=0) as file:
                file.write(bytes([signal.SIGINT]) * 100)
                file.seek(0)
                for number in watch:
                    os.dup2(file.fileno(), number)
                for _ in range(2):
                    self.soon()
                    with self.assertRaises(KeyboardInterrupt):
                        self.waits()
                    scene.step(self.xyz)
                self.assertEqual((file.tell(), os.fstat(file.fileno()).st_size), (0, 100))
                for number in watch:
                    os.close(number)
        self.both_step()

    def test_a_handler_that_raises(self):
        class Stop(BaseException):
            pass

        def stop(*_):
            raise Stop

        signal.signal(signal.SIGINT, stop)
        self.soon()
        with self.assertRaises(Stop):
            self.waits()
        self.both_step()

    def test_a_handler_that_does_not(self):
        """The step goes on."""
        called = []
        signal.signal(signal.SIGINT, lambda *_: called.append(1))
        self.soon()
        with self.fails("deadline_exceeded"):
            self.waits(deadline_seconds=1)
        self.assertEqual(called, [1])
        self.both_step()

    def test_other_signals(self):
        called = []
        before = signal.signal(signal.SIGUSR1, lambda *_: called.append(1))
        self.addCleanup(signal.signal, signal.SIGUSR1, before)
        self.soon(signal.SIGUSR1)
        with self.fails("deadline_exceeded"):
            self.waits(deadline_seconds=1)
        self.assertEqual(called, [1])

    def test_beside_asyncio(self):
        """Which asks for signals by the same way."""
        async def ended():
            loop = asyncio.get_running_loop()
            stop = asyncio.Event()
            loop.add_signal_handler(signal.SIGUSR1, stop.set)
            self.assertEqual(self.client.scene("beside", 2, replace=True).step(self.xyz).report.n, 100)
            os.kill(os.getpid(), signal.SIGUSR1)
            await asyncio.wait_for(stop.wait(), 10)
            return True

        self.assertTrue(asyncio.run(ended()))

    def test_ctrl_c_in_other_calls(self):
        """Opening a scene that seat 0 has still to make; waiting for an op, which goes on; the service, asked for cuts."""
        self.soon()
        with self.assertRaises(KeyboardInterrupt):
            self.client.scene("not-there", 2, seat=1, seats=2)
        op = self.scene.step_begin(self.xyz[:50], np.arange(50))
        self.soon()
        with self.assertRaises(KeyboardInterrupt):
            op.wait()
        self.assertFalse(op.done)
        self.assertIsNone(op.wait(0))
        self.assertIsNone(op.wait(0.25))
        with self.fails("busy"):
            self.waits()
        op.cancel()
        with self.fails("interrupted"):
            op.wait()
        with self.fails("interrupted"):
            op.wait(0)
        self.assertTrue(op.done)
        self.both_step()

    def test_interrupt_by_a_thread(self):
        timer = threading.Timer(0.3, self.client.interrupt)
        timer.start()
        with self.fails("interrupted"):
            self.waits()
        timer.join()
        op = self.scene.step_begin(self.xyz[:50], np.arange(50))
        del op  # which cancels it, and waits
        self.both_step()


class FloatingPoint(WithClient):
    def history(self, name):
        scene = self.client.scene(name, 8, replace=True)
        for xyz in self.path:
            step = scene.step(xyz)
            scene.cuts.neighbours(0, 0.1), scene.cuts.halo(xyz, 0.05, (0, 2)), scene.cuts.narrowest()
        return step.report.epoch, scene.cuts.hash

    def setUp(self):
        super().setUp()
        self.path = [points() * np.where(np.arange(3000) < 1500, 0.97**k, 1.0)[:, None] for k in range(20)]
        self.libm = ctypes.CDLL("libm.so.6")

    def test_traps_and_rounding(self):
        calm = self.history("calm")
        self.assertGreater(calm[0], 2)
        with np.errstate(all="raise"):
            self.assertEqual(self.history("errstate"), calm)
        for rounding in (0x400, 0x800, 0xC00) if os.uname().machine == "x86_64" else ():
            self.libm.fesetround(rounding)
            try:
                found = self.history("rounded")
                self.assertEqual(self.libm.fegetround(), rounding)
            finally:
                self.libm.fesetround(0)
            self.assertEqual(found, calm)
        self.libm.feenableexcept(0x0D)  # invalid, division by zero, overflow
        try:
            found = self.history("trapping")
            with self.fails("not_finite"):
                bad = self.path[0].copy()
                bad.view(np.int64)[3, 0] = 0x7FF8000000000000
                self.client.scene("trapping").step(bad)
        finally:
            self.libm.fedisableexcept(0x3F)
        self.assertEqual(found, calm)


if __name__ == "__main__":
    unittest.main(verbosity=2)
