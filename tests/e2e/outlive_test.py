"""What a solver meets that keeps its scene: a service that is started again, and another client that changes the parts."""
import glob

import ranks
from seat_client import Seat
from protocol_client import Client, Refused, arrays_of
from push_client import WAYS, Block, PushClient
from shared_memory_client import SharedClient
from support import *


def wait_for(condition):
    return awaited(condition, 60, (OSError, EOFError, Refused))


class Outlive(unittest.TestCase):
    def setUp(self):
        self.service = Service(3)
        self.addCleanup(self.service.stop)
        self.path = self.service.endpoint[5:]

    def kill_and_wait(self):
        """Another run of the service."""
        with Client(self.path) as client:
            instance = client.hello["instance"]
        ranks.kill(max(ranks.ranks(ranks.supervisor(self.path))))

        def another():
            with Client(self.path, timeout=5) as client:
                return client.hello["instance"] != instance

        wait_for(another)

    def test_a_seat_that_has_not_heard_of_a_step_gets_its_report_from_the_next_service(self):
        points = np.random.default_rng(3).random((508, 3))
        held = np.split(np.random.default_rng(4).permutation(500), [200])
        with Client(self.path) as control:
            control.ask("scene.create", scene="s", parts=5)
        team = [Seat(self.path, "s", k, 2) for k in range(2)]
        for one, ids in zip(team, held):
            one.start(0, ids, points)
        for one in team:
            one.finish()
        now = [np.append(held[0], [500, 501, 502]), np.append(held[1], range(503, 508))]
        for one, ids, come in zip(team, now, (3, 5)):
            one.start(1, ids, points, inserted=come)
        reports = [one.finish()[0]["report"] for one in team]
        for _ in range(2):  # the service may die again before all have asked
            self.kill_and_wait()
        back = [Seat(self.path, "s", k, 2, generation=2, session=team[k].session) for k in range(2)]
        self.addCleanup(lambda: [one.close() for one in team + back])
        for one in back:
            self.assertEqual((one.opened["step"], one.opened["filled"]), (1, False))
        # Seat 0 has its answer and goes on; the other one asks for it before it does so.
        back[0].start(2, now[0], points * [1, 1, 0.5])
        back[1].attempts = 3
        back[1].start(1, [], points)
        again, arrays = back[1].finish()
        self.assertEqual((again["repeated"], again["report"], arrays), (True, reports[1], {}))
        back[1].start(2, now[1][1:], points)
        for one in back:
            with self.assertRaises(Refused) as refused:
                one.finish()
            self.assertEqual(refused.exception.args[0], "not_conserved")
        for one, ids, way in zip(back, now, ("shared-memory", "sockets")):
            one.start(2, ids, points * [1, 1, 0.5], way=way)
        reports = [one.finish()[0]["report"] for one in back]
        self.assertEqual(reports[0], reports[1])
        self.assertEqual((reports[0]["step"], reports[0]["n"]), (2, 508))
        with Client(self.path) as control:
            self.assertEqual([one["step"] for one in control.ask("history", scene="s")[0]["history"]], [0, 1, 2])
        # Another session never gets it.
        stranger = Client(self.path)
        self.addCleanup(stranger.close)
        with self.assertRaises(Refused) as refused:
            stranger.push("s", 0, points)
        self.assertEqual(refused.exception.args[0], "busy")

    def test_what_comes_and_goes_by_counts_is_in_the_next_block_and_the_next_service(self):
        points, parts = np.random.default_rng(3).random((700, 3)), np.split(np.random.default_rng(4).permutation(600), 4)
        has = [list(map(int, ids)) for ids in parts]
        with Client(self.path) as control:
            control.ask("scene.create", scene="s", parts=1, positions="when-needed")
        team = [Seat(self.path, "s", k, 4) for k in range(4)]
        opened = list(team)
        self.addCleanup(lambda: [one.close() for one in opened])

        def step(how, number, refused=None, says=(), inserted=(0, 0, 0, 0), removed=(0, 0, 0, 0)):
            for one, ids, come, go in zip(team, has, inserted, removed):
                if how == "count":
                    one.count(number, ids, inserted=come, removed=go)
                else:
                    one.start(number, ids, points, inserted=come, removed=go)
            answers = []
            for one in team:
                try:
                    answers.append(one.finish()[0])
                except Refused as why:
                    answers.append(why.args)
            self.assertTrue(all(answer == answers[0] for answer in answers), answers)
            if not refused:
                return answers[0]
            self.assertEqual(answers[0][0], refused)
            for word in says:
                self.assertIn(word, answers[0][1])

        def state():
            with Client(self.path) as control:
                shown = control.ask("scene.show", scene="s")[0]
                return [shown[name] for name in ("step", "n", "positions_step")]

        step("push", 0)
        has[0] += [600, 601]
        has[3].pop()
        for come in ((2, 1, 0, 0), (0, 0, 0, 0)):
            step("count", 1, "not_conserved", ("601 particles", "has 600"), inserted=come, removed=(0, 0, 0, 1))
        self.assertEqual(state(), [0, 600, 0])
        report = step("count", 1, inserted=(2, 0, 0, 0), removed=(0, 0, 0, 1))["report"]
        self.assertEqual([report[name] for name in ("n", "inserted", "removed", "way", "drifted", "positions_step")],
                         [601, 2, 1, "count", None, 0])
        kept, has[2][0] = has[2][0], 602
        step("count", 2, "not_conserved", ("ids",))
        has[2][0] = kept
        # A twin comes. The next block tells, and changes nothing.
        has[0].append(has[1][5])
        step("count", 2, inserted=(1, 0, 0, 0))
        twins = "duplicate_id", (f"id {has[1][5]} is pushed by seat 0 and by seat 1",)
        step("push", 3, *twins)
        self.assertEqual(state(), [2, 602, 0])
        step("count", 3)
        has[0][-1] = 603
        step("push", 4, "not_conserved", ("ids",))
        step("push", 4, inserted=(1, 0, 0, 0), removed=(1, 0, 0, 0))
        self.assertEqual(state(), [4, 602, 4])
        # A service that is started again knows what was counted, and its first block tells as well.
        has[2][0], has[3][0] = 604, has[1][5]
        step("count", 5, inserted=(0, 0, 1, 1), removed=(0, 0, 1, 1))
        self.kill_and_wait()
        team[:] = [Seat(self.path, "s", k, 4, generation=2, session=one.session) for k, one in enumerate(team)]
        opened += team
        self.assertEqual(state(), [5, 602, None])
        self.assertIn("send", step("count", 6))
        step("push", 6, twins[0], (f"id {has[1][5]} is pushed by seat 1 and by seat 3",))
        has[3][0] = 605
        step("push", 6, inserted=(0, 0, 0, 1), removed=(0, 0, 0, 1))
        with Client(self.path) as control:
            self.assertEqual(arrays_of(*control.ask("fetch", scene="s"))["id"].tolist(), sorted(sum(has, [])))

    def test_the_next_step_after_a_start_is_judged_by_the_cuts_in_force(self):
        points = np.random.default_rng(3).random((80, 3))
        with Client(self.path) as client:
            client.ask("scene.create", scene="r", parts=4)
            first = client.push("r", 3, points)[0]["report"]
            session, hash_before = client.session, client.ask("scene.show", scene="r")[0]["hash"]
        for step, way in enumerate((*WAYS, "held"), 4):
            self.kill_and_wait()
            with PushClient(self.path, session=session) as client, SharedClient(self.path, session=session) as held:
                for command in ("fetch", "assign", "rebalance"):
                    with self.assertRaises(Refused) as refused:
                        client.ask(command, scene="r")
                    self.assertRegex(refused.exception.args[1], "the ranks hold (no positions|the positions of no step)")
                with self.assertRaises(Refused) as refused:
                    client.push("r", step, points[:79])
                self.assertEqual(refused.exception.args[0], "not_conserved")
                self.assertTrue(client.push("r", step - 1, points + 9)[0]["repeated"])  # whatever it brings
                if way == "held":
                    rows = held.positions(80)
                    rows[:] = points
                    report = held.step("r", step, rows)[0]["report"]
                else:
                    client.attempts = 9
                    report = client.push_block("r", step, Block(points), way=way)[0]["report"]
                self.assertEqual((report["n"], report["drifted"], report["epoch"], report["error_before"]),
                                 (80, None, first["epoch"], first["error"]))
                self.assertEqual(client.ask("scene.show", scene="r")[0]["hash"], hash_before)
                self.assertEqual(client.ask("fetch", scene="r")[0]["positions_step"], step)

    def solver(self, *command):
        return subprocess.Popen([*map(str, command), "--endpoint", self.service.endpoint], stdin=subprocess.DEVNULL,
                                stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)

    def step(self, scene):
        with Client(self.path) as client:
            return client.ask("error", scene=scene)[0]["step"]

    def check_parts_under(self, running, scene, name):
        """The parts change under a solver by force alone, and its reports tell."""
        try:
            wait_for(lambda: self.step(scene) >= 2)
            refused = self.service.failure("rebalance", scene, "--parts", 5)
            self.assertEqual((refused["code"], refused["exit"]), ("busy", 1))
            self.assertIn(name, refused["message"])
            self.assertIn("--force", refused["hint"])
            self.service.json("rebalance", scene, "--tolerance", 0.2, "--method", "bands-x")
            self.service.json("rebalance", scene, "--parts", 5, "--force")
            at = self.step(scene)
            wait_for(lambda: self.step(scene) > at + 3)
            self.service.json("rebalance", scene, "--parts", 11, "--force")
            out, err = running.communicate(timeout=200)
        finally:
            running.kill()
        self.assertEqual(running.returncode, 0, out[-2000:] + err)
        reports = json.loads(out)["reports"]
        self.assertEqual([report["step"] for report in reports], list(range(len(reports))))
        parts = [report["parts"] for report in reports]
        self.assertEqual([p for k, p in enumerate(parts) if k == 0 or parts[k - 1] != p], [4, 5, 11])

    def test_parts_change_under_a_solver(self):
        self.check_parts_under(self.solver(os.path.join(BIN, "two_spheres"), "--steps", 2000, "--parts", 4, "--scene", "a",
                                           "--json"), "a", "two_spheres")

    def test_parts_change_under_seats(self):
        self.check_parts_under(self.solver(MPIRUN, 3, os.path.join(BIN, "slope_mpi"), "--points", 1000, "--steps", 2000,
                                           "--interval", 0.05, "--parts", 4, "--scene", "b", "--json", "--check"), "b",
                               "slope_mpi 0 of 3")

    def test_a_solver_says_at_once_that_its_service_was_stopped_and_goes_on_with_the_next(self):
        running = self.solver(os.path.join(BIN, "two_spheres"), "--steps", 1500, "--scene", "d", "--json", "--deadline", 120)
        try:
            wait_for(lambda: self.step("d") >= 2)
            self.assertEqual(self.service.ctl("down").returncode, 0)
            self.assertRegex(running.stderr.readline(), "^two_spheres: the service at .* was stopped; ")
            run("up", "-n", 2, "--data-dir", self.service.data, endpoint=self.service.endpoint, check=True)
            out, err = running.communicate(timeout=200)
        finally:
            running.kill()
        self.assertEqual(running.returncode, 0, out[-2000:] + err)
        self.assertEqual([report["step"] for report in json.loads(out)["reports"]], list(range(1501)))
        self.assertEqual(self.service.json("history", "d"), json.loads(out)["reports"])

    def test_solvers_go_on_when_the_supervisor_is_killed_and_a_service_is_started_again(self):
        for k, (seats, command) in enumerate(((1, ["two_spheres", "--steps", 1500, "--parts", 7]),
                                                (4, ["slope_mpi", "--points", 1000, "--steps", 300, "--interval", 0.05]))):
            scene = f"k{k}"
            program = [os.path.join(BIN, command[0]), *command[1:], "--scene", scene, "--json", "--deadline", 120]
            running = self.solver(*(program if seats == 1 else [MPIRUN, seats, *program]))
            try:
                wait_for(lambda: self.step(scene) >= 2)
                supervisor = ranks.supervisor(self.path)
                job = ranks.ranks(supervisor) + ranks.children(supervisor)
                ranks.kill(supervisor)
                awaited(lambda: not any(os.path.exists(f"/proc/{pid}") for pid in job), 60)
                run("up", "-n", 3 - k, "--data-dir", self.service.data, endpoint=self.service.endpoint, check=True)
                out, err = running.communicate(timeout=200)
            finally:
                running.kill()
            self.assertEqual(running.returncode, 0, out[-2000:] + err)
            reports = json.loads(out)["reports"]
            self.assertEqual(self.service.json("history", scene), reports)
            self.assertEqual([report["step"] for report in reports], list(range(command[command.index("--steps") + 1] + 1)))

    def test_a_service_that_begins_anew_keeps_the_old_scenes_aside(self):
        with Client(self.path) as client:
            client.ask("scene.create", scene="old", parts=3)
            client.push("old", 0, np.random.default_rng(1).random((50, 3)))
        for options, steps in (((), [0]), (("--empty",), [])):
            self.service.ctl("down", check=True)
            run("up", "-n", 2, "--data-dir", self.service.data, *options, endpoint=self.service.endpoint, check=True)
            self.assertEqual([scene["step"] for scene in self.service.json("status")["scenes"]], steps)
        self.assertTrue(glob.glob(os.path.join(self.service.data, "scenes.old-*", "old.*", "state")))
        with Client(self.path) as client:
            client.ask("scene.create", scene="new", parts=3)
        self.kill_and_wait()  # and this doesn't begin anew once more
        self.assertEqual([scene["scene"] for scene in self.service.json("status")["scenes"]], ["new"])
        self.assertIn("yes, after it had died: 1 scene, 0 steps restored", self.service.ctl("status").stdout)

    def test_a_solver_that_does_not_outlive_ends_and_the_hint_is_true(self):
        running = self.solver(os.path.join(BIN, "two_spheres"), "--steps", 100000, "--scene", "c", "--json", "--no-outlive")
        try:
            wait_for(lambda: self.step("c") >= 2)
            ranks.kill(max(ranks.ranks(ranks.supervisor(self.path))))
            out, err = running.communicate(timeout=60)
        finally:
            running.kill()
        self.assertNotEqual(running.returncode, 0)
        self.assertNotIn("start it again", err)

    def test_a_command_while_the_service_is_down_is_told_that_it_comes_back(self):
        supervisor = ranks.supervisor(self.path)
        os.kill(supervisor, signal.SIGSTOP)  # so that it doesn't come back at once
        try:
            for pid in ranks.ranks(supervisor) + ranks.children(supervisor):
                ranks.kill(pid)
            asking = subprocess.Popen([RCBCTL, "error", "s", "--json"], text=True, stdout=subprocess.PIPE,
                                      stderr=subprocess.PIPE, env=dict(os.environ, RCBD_ENDPOINT=self.service.endpoint))
            waiting = asking.stderr.readline()
        finally:
            os.kill(supervisor, signal.SIGCONT)
        out, _ = asking.communicate(timeout=60)
        self.assertIn("is being started again", waiting)
        self.assertEqual(json.loads(out)["failure"]["code"], "not_found")  # the service is back; there was no such scene

    def test_no_service_at_all_is_told_at_once(self):
        nowhere = run("status", "--json", "--endpoint", "unix:/nowhere/s")
        self.assertEqual(nowhere.returncode, 3, nowhere.stdout)
        self.assertIn("rcbctl up", json.loads(nowhere.stdout)["failure"]["hint"])


if __name__ == "__main__":
    unittest.main(verbosity=2)
