"""A service, or what looks after it, that is stopped: nobody waits for it, it is noticed, and `down` ends it."""
import ctypes

from protocol_client import Client, Refused
from support import *


def refused(service, count):
    """Commands on one connection that are refused, each of which is worth a line in the log."""
    client = Client(service.endpoint[5:])
    for _ in range(count):
        try:
            client.ask("error", scene="none")
        except Refused:
            pass
    client.socket.close()


def held_thread(tid):
    """Stops one thread of another process, as no signal can; it goes on when this process lets it go or ends."""
    libc = ctypes.CDLL(None, use_errno=True)
    libc.ptrace.argtypes = [ctypes.c_long] * 4
    seize, interrupt, detach = 0x4206, 0x4207, 17
    for request in (seize, interrupt):
        if libc.ptrace(request, tid, 0, 0) != 0:
            raise OSError(ctypes.get_errno(), "ptrace")
    os.waitpid(tid, 0x40000000)  # __WALL
    return lambda: libc.ptrace(detach, tid, 0, 0)


class Silence(unittest.TestCase):
    def test_a_stopped_mpirun_or_supervisor_stops_nobody(self):
        for name in ("mpirun", "rcbd-supervisor"):
            with self.subTest(name), Service(2) as service:
                victim = service.processes(name)[0]
                os.kill(victim, signal.SIGSTOP)
                refused(service, 3000)
                self.assertEqual(service.ctl("status").returncode, 0)
                service.ctl("down", check=True)
                service.assert_nothing_left()

    def test_a_death_behind_a_stopped_mpirun_is_noticed(self):
        with Service(2, options=("--answer-seconds", 3)) as service:
            ranks = service.processes("rcbd")
            os.kill(service.processes("mpirun")[0], signal.SIGSTOP)
            os.kill(ranks[0], signal.SIGKILL)
            self.assertTrue(wait_for(lambda: not set(ranks) & set(service.processes("rcbd")), 60))
            self.assertTrue(wait_for(lambda: service.ctl("status").returncode == 0, 60))

    def test_a_service_that_does_not_answer_is_started_again(self):
        with Service(1, options=("--answer-seconds", 3)) as service:
            victim = service.processes("rcbd")[0]
            os.kill(victim, signal.SIGSTOP)
            self.assertTrue(wait_for(lambda: not os.path.exists(f"/proc/{victim}"), 60))
            self.assertTrue(wait_for(lambda: service.ctl("status").returncode == 0, 60))
            self.assertIn("it has not answered for", text_of(service.data, "rcbd.log"))

    def test_status_tells_what_has_been_at_work_for_long(self):
        with Service(2) as service, Client(service.endpoint) as client:
            client.ask("scene.create", scene="a", parts=4)
            client.push("a", 0, np.random.default_rng(1).random((100, 3)))
            self.assertEqual(service.json("status")["unfinished"], {"commands": 0, "oldest": None})
            victim = service.processes("rcbd")[1]
            os.kill(victim, signal.SIGSTOP)
            try:
                client.send({"command": "assign", "scene": "a"})
                oldest = lambda: service.json("status")["unfinished"]["oldest"] or {"seconds": 0}
                self.assertTrue(wait_for(lambda: oldest()["seconds"] > 2.5, 20))
                self.assertEqual([oldest()[name] for name in ("command", "scene")], ["assign", "a"])
                self.assertRegex(service.ctl("status").stdout, r"assign of a at work for \d+ s; 1 command")
            finally:
                os.kill(victim, signal.SIGCONT)
            client.answer()
            self.assertIsNone(service.json("status")["unfinished"]["oldest"])

    def test_an_engine_that_stands_still_ends_the_service(self):
        """Its I/O thread answers and sends heartbeats all the while: only the watchdog can tell."""
        with Service(2, env={"RCBD_STALL_SECONDS": "1"}) as service, Client(service.endpoint) as client:
            client.ask("scene.create", scene="a", parts=4)
            client.push("a", 0, np.random.default_rng(1).random((100, 3)))
            victim = service.processes("rcbd")[1]
            try:
                held_thread(victim)
            except OSError as refusal:
                print(f"SKIPPED: a thread can't be held here: {refusal}", file=sys.stderr)
                self.skipTest("no ptrace here")
            client.send({"command": "assign", "scene": "a", "deadline_seconds": 1})
            self.assertTrue(wait_for(lambda: victim not in service.processes("rcbd"), 60))
            self.assertTrue(wait_for(lambda: service.ctl("status").returncode == 0, 60))
            self.assertIn("past its deadline", text_of(service.data, "rcbd.log"))

    def test_a_rank_killed_during_a_commit(self):
        """The others wait for it inside the step when it dies: nothing of the step is seen afterwards."""
        points = np.random.default_rng(2).random((500, 3))
        with Service(3) as service, Client(service.endpoint) as client:
            client.ask("scene.create", scene="a", parts=6)
            client.push("a", 0, points)
            ranks = service.processes("rcbd")
            os.kill(ranks[2], signal.SIGSTOP)
            client.send(*client.push_frame("a", 1, dict(zip("xyz", points[::-1].T)), len(points)))
            time.sleep(0.5)
            os.kill(ranks[2], signal.SIGKILL)
            with self.assertRaises((EOFError, OSError, Refused)):
                client.answer()
            self.assertTrue(wait_for(lambda: not set(ranks) & set(service.processes("rcbd")), 60))
            self.assertTrue(wait_for(lambda: service.ctl("status").returncode == 0, 60))
            status = service.json("status")
            self.assertEqual((status["restarted"], status["scenes"][0]["step"]), (True, 0))
            with Client(service.endpoint) as again:
                self.assertEqual(again.push("a", 1, points[::-1])[0]["report"]["n"], 500)

    def test_down_ends_what_hangs(self):
        with Service(1) as service:
            os.kill(service.processes("rcbd")[0], signal.SIGSTOP)
            service.ctl("down", "--deadline", 5, check=True)
            service.assert_nothing_left()

    def test_a_removed_socket_is_made_again(self):
        with Service(2, options=("--answer-seconds", 3)) as service:
            for name in os.listdir(service.dir):
                if name != "data":
                    os.remove(os.path.join(service.dir, name))
            self.assertTrue(wait_for(lambda: service.ctl("status").returncode == 0, 60))
            self.assertEqual(service.ctl("down").returncode, 0)
            service.assert_nothing_left()


if __name__ == "__main__":
    unittest.main(verbosity=2)
