"""Life of the service: up and down, several beside each other, idle, clean ends, crashes, nothing left behind."""
from protocol_client import Client, count_record
from support import *


def wake_ups(pids):
    """How often the threads of these processes have been woken, by thread."""
    counts = {}
    for pid in pids:
        for task in os.listdir(f"/proc/{pid}/task"):
            with open(f"/proc/{pid}/task/{task}/status") as file:
                fields = dict(line.split(":", 1) for line in file)
            counts[pid, task] = int(fields["voluntary_ctxt_switches"])
    return counts


def running_threads(pids):
    """The threads that are running or want to at this moment."""
    found = set()
    for pid in pids:
        for task in os.listdir(f"/proc/{pid}/task"):
            with open(f"/proc/{pid}/task/{task}/stat") as file:
                if file.read().rsplit(")", 1)[1].split()[0] == "R":
                    found.add((pid, task))
    return found


class Lifecycle(unittest.TestCase):
    def test_up_down_and_nothing_left(self):
        service = Service(2)
        socket_path = service.endpoint[5:]
        self.assertTrue(os.path.exists(socket_path))
        self.assertEqual(os.stat(socket_path).st_mode & 0o777, 0o600)
        status = service.json("status")
        self.assertEqual(status["ranks"], 2)
        self.assertTrue(processes_of(service.dir))
        service.ctl("down", check=True)
        self.assertEqual(os.listdir(service.dir), ["data"])
        self.assertEqual(sorted(os.listdir(service.data)), ["clean-shutdown", "rcbd.log"])
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
        """Nobody runs in most of the moments at which one looks, and nobody is woken again and again: neither a rank that
        spins, nor one that looks every millisecond. Both hold however busy the machine is."""
        with Service(8) as service:
            pids = [pid for pid, line in processes_of(service.dir)]
            self.assertGreaterEqual(len(pids), 10)
            time.sleep(1)
            looks, seen = 100, {}
            before, began = wake_ups(pids), time.monotonic()
            for _ in range(looks):
                for thread in running_threads(pids):
                    seen[thread] = seen.get(thread, 0) + 1
                time.sleep(0.05)
            seconds = time.monotonic() - began
            after = wake_ups(pids)
            self.assertEqual(before.keys(), after.keys())
            rates = {thread: (after[thread] - before[thread]) / seconds for thread in after}
            print(f"idle: of {len(after)} threads the busiest was seen running in {max(seen.values(), default=0)} of {looks} "
                  f"looks, and woken {max(rates.values()):.1f} times a second")
            self.assertLess(max(seen.values(), default=0), looks / 4, seen)
            self.assertLess(max(rates.values()), 50, rates)

    def test_counts_wake_rank_0_alone(self):
        with Service(4) as service, Client(service.endpoint[5:]) as client:
            client.ask("scene.create", scene="s", parts=4, positions="when-needed")
            client.push("s", 0, np.random.default_rng(1).random((400, 3)))
            shown = client.ask("scene.show", scene="s")[0]
            others = [one["pid"] for one in service.json("status")["hosts"]][1:]
            time.sleep(1)  # what the step left behind
            steps, before = 10000, wake_ups(others)
            for step in range(1, steps + 1):
                client.send({"command": "count", "scene": "s"}, count_record(step, shown, shown["counts"]))
                self.assertEqual(client.answer()[0]["report"]["way"], "count")
            woken = {thread: times - before[thread] for thread, times in wake_ups(others).items()}
            print(f"{steps} counts: no thread of another rank was woken more than {max(woken.values())} times")
            self.assertLess(max(woken.values()), steps / 10, woken)  # signs of life, some a second

    def test_a_service_whose_rank_is_killed_comes_back_with_its_scenes(self):
        with Service(3) as service:
            service.json("scene", "create", "s", "--parts", 2)
            ranks = service.processes("rcbd")
            self.assertEqual(len(ranks), 3)
            os.kill(max(ranks), signal.SIGKILL)
            # The one that was is gone, whether or not anybody has seen the moment without one.
            self.assertTrue(wait_for(lambda: not set(ranks) & set(service.processes("rcbd"))))
            self.assertTrue(wait_for(lambda: service.ctl("status").returncode == 0))
            status = service.json("status")
            self.assertTrue(status["restarted"] and not status["empty"], status)
            self.assertEqual(status["restored"], {"scenes": 1, "steps": 0, "lost_records": 0})
            self.assertEqual(service.json("scene", "show", "s")["parts"], 2)

    def test_a_stopped_rank_is_noticed(self):
        with Service(3) as service:
            victim = max(service.processes("rcbd"))
            os.kill(victim, signal.SIGSTOP)
            try:
                self.assertTrue(wait_for(lambda: not os.path.exists(f"/proc/{victim}"), 60))
                self.assertTrue(wait_for(lambda: service.ctl("status").returncode == 0, 40))
            finally:
                try:
                    os.kill(victim, signal.SIGCONT)
                except ProcessLookupError:
                    pass

    def test_options_for_rcbd_hold_at_restarts_too(self):
        with Service(1, options=("--log-level", "warn", "--bulk-bytes", "1gb")) as service:
            def told():
                return [line for pid, line in processes_of(service.dir) if process_name(pid) == "rcbd"]
            first = service.processes("rcbd")
            self.assertIn("--log-level warn --bulk-bytes 1gb", told()[0])
            os.kill(first[0], signal.SIGKILL)
            self.assertTrue(wait_for(lambda: service.processes("rcbd") not in ([], first)))
            self.assertIn("--log-level warn --bulk-bytes 1gb", told()[0])

    def test_a_folder_without_rcbd_is_named(self):
        with tempfile.TemporaryDirectory(prefix="rcb-e2e-") as folder:
            failed = run("up", "--json", "--data-dir", f"{folder}/data", endpoint=f"unix:{folder}/s",
                         env={"RCBD_BIN_DIR": "/nowhere"})
        self.assertEqual(failed.returncode, 1)
        self.assertIn("RCBD_BIN_DIR is /nowhere", json.loads(failed.stdout)["failure"]["message"])


if __name__ == "__main__":
    unittest.main(verbosity=2)
