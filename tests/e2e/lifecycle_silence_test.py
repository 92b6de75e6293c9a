"""A service, or what looks after it, that is stopped: nobody waits for it, it is noticed, and `down` ends it."""
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


class Silence(unittest.TestCase):
    def assert_nothing_left(self, service):
        self.assertTrue(wait_for(lambda: not processes_of(service.dir)), processes_of(service.dir))
        self.assertEqual([name for name in os.listdir(service.dir) if name.startswith("s")], [])

    def test_a_stopped_mpirun_or_supervisor_stops_nobody(self):
        for name in ("mpirun", "rcbd-supervisor"):
            with self.subTest(name), Service(2) as service:
                victim = service.processes(name)[0]
                os.kill(victim, signal.SIGSTOP)
                refused(service, 3000)
                self.assertEqual(service.ctl("status").returncode, 0)
                down = service.ctl("down")
                self.assertEqual(down.returncode, 0, down.stderr)
                self.assert_nothing_left(service)

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
            with open(os.path.join(service.data, "rcbd.log")) as log:
                self.assertIn("it has not answered for", log.read())

    def test_down_ends_what_hangs(self):
        with Service(1) as service:
            os.kill(service.processes("rcbd")[0], signal.SIGSTOP)
            down = service.ctl("down", "--deadline", 5)
            self.assertEqual(down.returncode, 0, down.stderr)
            self.assert_nothing_left(service)

    def test_a_removed_socket_is_made_again(self):
        with Service(2, options=("--answer-seconds", 3)) as service:
            for name in os.listdir(service.dir):
                if name != "data":
                    os.remove(os.path.join(service.dir, name))
            self.assertTrue(wait_for(lambda: service.ctl("status").returncode == 0, 60))
            self.assertEqual(service.ctl("down").returncode, 0)
            self.assert_nothing_left(service)


if __name__ == "__main__":
    unittest.main(verbosity=2)
