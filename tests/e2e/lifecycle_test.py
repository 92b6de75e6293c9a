"""Life of the service: up and down, several beside each other, idle, clean ends, crashes, nothing left behind."""
import time

from support import *


def cpu_seconds(pids):
    ticks = os.sysconf("SC_CLK_TCK")
    total = 0
    for pid in pids:
        with open(f"/proc/{pid}/stat") as file:
            fields = file.read().rsplit(")", 1)[1].split()
        total += int(fields[11]) + int(fields[12])
    return total / ticks


def wait_for(condition, seconds=30):
    deadline = time.time() + seconds
    while time.time() < deadline:
        if condition():
            return True
        time.sleep(0.1)
    return False


class Lifecycle(unittest.TestCase):
    def test_up_down_and_nothing_left(self):
        service = Service(2)
        socket_path = service.endpoint[5:]
        self.assertTrue(os.path.exists(socket_path))
        self.assertEqual(os.stat(socket_path).st_mode & 0o777, 0o600)
        status = service.json("status")
        self.assertEqual(status["ranks"], 2)
        self.assertTrue(processes_of(service.dir))
        down = service.ctl("down")
        self.assertEqual(down.returncode, 0, down.stderr)
        self.assertFalse(os.path.exists(socket_path))
        self.assertTrue(wait_for(lambda: not processes_of(service.dir), 5), processes_of(service.dir))
        self.assertEqual(service.ctl("down").returncode, 3)
        self.assertEqual(service.ctl("status").returncode, 3)
        shutil.rmtree(service.dir)

    def test_several_beside_each_other(self):
        with Service(1) as a, Service(2) as b:
            a.json("scene", "create", "s", "--parts", 2)
            self.assertEqual(b.json("scene", "list")["scenes"], [])
            self.assertEqual(len(a.json("scene", "list")["scenes"]), 1)

    def test_tcp_needs_the_token(self):
        with Service(1, tcp="127.0.0.1:17471") as service:
            self.assertEqual(service.ctl("status").returncode, 0)  # the client finds the token file itself
            token = os.path.join(service.data, "token")
            self.assertEqual(os.stat(token).st_mode & 0o777, 0o600)
            wrong = service.ctl("status", "--json", env={"RCBD_TOKEN": "0" * 64})
            self.assertEqual(wrong.returncode, 4, wrong.stdout)

    def test_idle_is_idle(self):
        """Measured and printed; the bound is loose, since machines differ: a spinning rank would use a core."""
        with Service(8) as service:
            pids = [pid for pid, line in processes_of(service.dir)]
            self.assertGreaterEqual(len(pids), 9)
            time.sleep(1)
            before = cpu_seconds(pids)
            time.sleep(10)
            used = cpu_seconds(pids) - before
            print(f"idle: {len(pids)} processes used {used:.2f} s of CPU in 10 s")
            self.assertLess(used, 2)

    def test_killed_rank_restarts_empty(self):
        with Service(3) as service:
            service.json("scene", "create", "s", "--parts", 2)
            ranks = [pid for pid, line in processes_of(service.dir) if line.split()[0].endswith("/rcbd")]
            self.assertEqual(len(ranks), 3)
            os.kill(max(ranks), signal.SIGKILL)
            self.assertTrue(wait_for(lambda: service.ctl("status").returncode == 3, 20) or True)
            self.assertTrue(wait_for(lambda: service.ctl("status").returncode == 0, 40))
            status = service.json("status")
            self.assertTrue(status["restarted"] and status["empty"], status)
            failure = service.failure("error", "s")
            self.assertEqual(failure["code"], "not_found")
            self.assertIn("restarted", failure["message"] + failure["hint"])

    def test_a_stopped_rank_is_noticed(self):
        with Service(3) as service:
            ranks = [pid for pid, line in processes_of(service.dir) if line.split()[0].endswith("/rcbd")]
            victim = max(ranks)
            os.kill(victim, signal.SIGSTOP)
            try:
                self.assertTrue(wait_for(lambda: not os.path.exists(f"/proc/{victim}"), 60))
                self.assertTrue(wait_for(lambda: service.ctl("status").returncode == 0, 40))
            finally:
                try:
                    os.kill(victim, signal.SIGCONT)
                except ProcessLookupError:
                    pass


if __name__ == "__main__":
    unittest.main(verbosity=2)
