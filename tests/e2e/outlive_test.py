"""What a solver meets that keeps its scene: a service that is started again, and another client that changes the parts."""
import ranks
from member_client import Member, handed_over
from protocol_client import Client, Refused
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

    def test_a_member_that_has_not_heard_of_a_step_gets_its_answer_from_the_next_service(self):
        points = np.random.default_rng(3).random((500, 3))
        rng = np.random.default_rng(4)
        held = np.split(rng.permutation(500), [200])
        with Client(self.path) as control:
            control.ask("scene.create", scene="s", parts=5)
        team = [Member(self.path, "s", k, 2, follow=True) for k in range(2)]
        for one, ids in zip(team, held):
            one.start(0, ids, points)
        answers = [one.finish() for one in team]
        after = handed_over(held, answers)
        self.assertFalse(np.isin(after[0], held[0]).all())
        for _ in range(2):  # the service may die again before all have asked
            self.kill_and_wait()
        with Client(self.path) as control:
            control.ask("scene.create", scene="s", parts=5, recreated=True)
        back = [Member(self.path, "s", k, 2, follow=True, generation=2, session=team[k].session) for k in range(2)]
        self.addCleanup(lambda: [one.close() for one in team + back])
        # Member 0 has its answer and goes on; member 1 asks for its own, and gets what it would have got.
        back[0].start(1, after[0], points)
        with self.assertRaises(Refused) as refused:  # of step 1 there is no answer yet
            back[1].ask("push.begin", **self.nothing(back[1], 1))
        self.assertEqual(refused.exception.args[0], "unsupported")
        self.assertTrue(back[1].ask("push.begin", **self.nothing(back[1], 0))[0]["repeated"])
        back[1].start(0, held[1], points, attempt=2)
        answer, news = back[1].finish()
        self.assertTrue(answer["repeated"])
        self.assertEqual(answer["report"], answers[1][0]["report"])
        for name, values in answers[1][1].items():
            np.testing.assert_array_equal(news[name], values, name)
        back[1].start(1, after[1], points)
        reports = [one.finish()[0]["report"] for one in back]
        self.assertEqual(reports[0], reports[1])
        self.assertEqual((reports[0]["step"], reports[0]["scene_recreated"], reports[0]["n"]), (1, True, 500))
        # Another session never gets it.
        stranger = Client(self.path)
        self.addCleanup(stranger.close)
        with self.assertRaises(Refused) as refused:
            stranger.push("s", 0, points)
        self.assertEqual(refused.exception.args[0], "busy")

    def test_answers_to_a_run_that_is_over_are_nobodys(self):
        """The next run's steps begin again at 0, pushed by the same session."""
        points = np.random.default_rng(3).random((80, 3))

        def push(count, generation):
            with Member(self.path, scene, 0, 1, generation=generation, session=session) as member:
                member.start(0, np.arange(count), points)
                return member.finish()[0]

        def create(**more):
            with Client(self.path) as client:
                client.ask("scene.create", scene=scene, parts=4, **more)

        for scene in ("kill, replace", "kill, drop", "replace, kill"):
            session = np.random.default_rng(len(scene)).bytes(8).hex()
            what, scene = scene, scene.replace(", ", "-")
            create()
            self.assertEqual(push(50, 1)["report"]["n"], 50)
            if what == "replace, kill":
                create(replace=True)
            self.kill_and_wait()
            create(recreated=True)
            if what != "replace, kill":
                self.assertTrue(push(50, 2)["repeated"], what)
            if what == "kill, replace":
                create(replace=True)
            if what == "kill, drop":
                with Client(self.path) as client:
                    client.ask("scene.drop", scene=scene)
                create()
            answer = push(80, 3)
            self.assertEqual((answer.get("repeated", False), answer["report"]["n"]), (False, 80), what)

    def nothing(self, member, step):
        """A push that asks for the answer to this step alone."""
        return {"scene": "s", "session": member.session, "step": step, "attempt": 9, "n": 0, "slices": 0, "order": "id",
                "ids": True, "moved": "none"}

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

    def test_a_scene_made_anew_in_the_place_of_another_begins_a_run(self):
        points = np.random.default_rng(7).random((60, 3))
        session = "00000000000000aa"
        with Client(self.path, session=session) as client:
            client.ask("scene.create", scene="s", parts=2)
            client.push("s", 3, points)
            with self.assertRaises(Refused) as caught:
                client.ask("scene.create", scene="s", parts=2, recreated=True)
            self.assertEqual(caught.exception.args[0], "already_exists")
            client.ask("scene.create", scene="s", parts=2, recreated=True, replace=True)
            anew = client.push("s", 3, points + 1, attempt=1)[0]
            self.assertFalse(anew.get("repeated", False))
            self.assertTrue(anew["report"]["scene_recreated"])

    def test_parts_change_under_a_solver(self):
        self.check_parts_under(self.solver(os.path.join(BIN, "two_spheres"), "--steps", 2000, "--parts", 4, "--scene", "a",
                                           "--json"), "a", "two_spheres")

    def test_parts_change_under_members(self):
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
        self.assertEqual(sum(report["scene_recreated"] for report in json.loads(out)["reports"]), 1)

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
        self.assertEqual(json.loads(out)["failure"]["code"], "not_found")  # the service is back, without its scenes

    def test_no_service_at_all_is_told_at_once(self):
        nowhere = run("status", "--json", "--endpoint", "unix:/nowhere/s")
        self.assertEqual(nowhere.returncode, 3, nowhere.stdout)
        self.assertIn("rcbctl up", json.loads(nowhere.stdout)["failure"]["hint"])


if __name__ == "__main__":
    unittest.main(verbosity=2)
