"""A service over several machines whose links are slow, lossy or cut (tests/hosts): the answers are those of one
machine, no step is half done, and who is waited for is told. Needs root, since the machines are made of network
namespaces."""
import re
import threading

import judge
from machines import *
from protocol_client import arrays_of
from push_client import Block, PushClient

PARTS = 6


class LinksTest(MachinesTest):
    def setUp(self):
        super().setUp()
        self.machines(3, lambda count: Hosts(count, os.path.join(BIN, "rcb_switch")))

    def up_on_three(self, **more):
        self.up("--hosts", "a:2,b:2,c:2", "--trusted-network", **more)
        return self.ctl("status", "--json")["pid"]

    def solver(self, *options):
        """Started on machine a, with its output in files."""
        self.told, self.found = (os.path.join(self.hosts.shared, name) for name in ("told", "found"))
        environment = self.hosts.environment(RCBD_ENDPOINT=TCP, RCBD_TOKEN_FILE=os.path.join(self.data, "token"))
        with open(self.told, "w") as told, open(self.found, "w") as found:
            started = subprocess.Popen(
                self.hosts.command("a", os.path.join(self.bin, "two_spheres"), "--parts", PARTS, "--json",
                                   "--deadline", 240, *options),
                env=environment, stdin=subprocess.DEVNULL, stdout=found, stderr=told)
        for end in (started.wait, started.kill):
            self.addCleanup(end)
        return started

    def ended(self, solver):
        """What its run has found."""
        self.assertEqual(solver.wait(timeout=240), 0, self.heard() + self.log())
        return json.loads(text_of(self.found))

    def heard(self):
        return text_of(self.told)

    def step_of(self, scene="two_spheres"):
        done = self.on("a", os.path.join(self.bin, "rcbctl"), "scene", "show", scene, "--json")
        return json.loads(done.stdout)["step"] if done.returncode == 0 else None

    @staticmethod
    def errors(result):
        return [(report["error"], report["repartitioned"]) for report in result["reports"]]

    def test_answers_do_not_depend_on_delay(self):
        found = {}
        for layout in (("-n", 2), ("--hosts", "a:2,b:2,c:2")):
            self.up(*layout, "--trusted-network")
            for name in self.hosts.names:
                self.hosts.set_link(name, 0.0005 if "--hosts" in layout else 0)
            before = self.hosts.counts()[0]
            answers = found[layout[0]] = {}
            for name, points in hard_scenes().items():
                file = os.path.join(self.hosts.shared, f"{name}.npy")
                np.save(file, points)
                parts = min(7, len(points))
                answers[name] = self.ctl("partition", file, "--parts", parts, "--json")["hash"]
            answers["two_spheres"] = self.errors(self.ended(self.solver("--steps", 10)))
            self.assertEqual(self.hosts.counts()[0] > before + 100, "--hosts" in layout, "messages over links")
            for name in self.hosts.names:
                self.hosts.set_link(name)
            self.down()
        self.assertEqual(found["-n"], found["--hosts"])

    def test_a_step_over_a_slow_link_is_done_whole(self):
        instance = self.up_on_three()
        walk = np.random.default_rng(3).random((3, 3000, 3))
        walk[1:] = walk[0] + 0.01 * walk[1:]  # some change their rank
        known = {"token": token_of(self.data), "timeout": 240}
        with self.hosts.network("a"):
            client, watcher = PushClient(TCP, "sockets", **known), PushClient(TCP, **known)
        self.addCleanup(client.close)
        self.addCleanup(watcher.close)
        client.ask("scene.create", scene="s", parts=PARTS)
        more = {"deadline_seconds": 200}
        answers = [client.push_block("s", 0, Block(walk[0]))[0]]
        for step, delay in ((1, 2), (2, 0.5)):
            begin, slices = client.frames("s", step, Block(walk[step]), each=500, **more)
            self.hosts.set_link("b", delay=delay)
            for link, data in [(client.socket, begin), *slices]:
                link.sendall(data)
            if step == 2:  # for less than the silence that ranks bear
                time.sleep(0.7)
                self.hosts.link("b", "down")
                threading.Timer(3, self.hosts.link, ("b", "up")).start()
            during, bulk = watcher.ask("fetch", scene="s", **more)
            answers.append(client.finish()[0])
            self.hosts.set_link("b")
            for held, bulk in ((during, bulk), watcher.ask("fetch", scene="s")):
                arrays = arrays_of(held, bulk)
                np.testing.assert_array_equal(np.stack([arrays[axis] for axis in "xyz"], axis=1), walk[held["positions_step"]])
            self.assertEqual((during["positions_step"] in (step - 1, step), held["positions_step"]), (True, step))
        for answer, expected in zip(answers, judge.reports(walk, PARTS, 6), strict=True):
            expected["drifted"] = answer["report"]["drifted"]  # which nobody has counted
            self.assertEqual({name: answer["report"][name] for name in expected}, expected)
        self.assertEqual(self.ctl("status", "--json")["pid"], instance, self.log())
        self.down()

    def test_a_link_that_loses_a_third_of_its_frames(self):
        instance = self.up_on_three()
        calm = self.errors(self.ended(self.solver("--steps", 300)))
        solver = self.solver("--steps", 300)
        self.assertTrue(wait_for(lambda: (self.step_of() or 0) > 0), self.heard())
        self.hosts.set_link("b", loss=0.3)
        silent = lambda: re.search(r"rank [23] on b has been silent", self.log())
        lost = lambda: self.hosts.counts()[1]["b"]["lost"]
        self.assertTrue(wait_for(lambda: solver.poll() is not None or silent() or lost() > 40, 120), self.log())
        self.hosts.set_link("b")
        result = self.ended(solver)
        self.assertGreater(lost(), 10)
        self.assertEqual(self.errors(result), calm)
        if self.ctl("status", "--json")["pid"] != instance:
            self.assertTrue(silent(), self.log())
        self.down()

    def test_a_link_that_is_cut_in_a_step(self):
        instance = self.up_on_three(RCBD_SILENCE_SECONDS="10")
        solver = self.solver("--steps", 300)
        self.assertTrue(wait_for(lambda: (self.step_of() or 0) > 0), self.heard())
        self.hosts.link("b", "down")
        silent = lambda: re.search(r"rank [23] on b has been silent for 10 s", self.log())
        self.assertTrue(wait_for(silent, 60), self.log())
        self.assertRegex(self.heard(), r"step \d+ of scene 'two_spheres' has waited \d+ s for .*rank [23] on b, silent for \d+ s")
        self.hosts.link("b", "up")
        result = self.ended(solver)
        self.assertIn("waiting for the service at 10.77.0.1:7470", self.heard())
        self.assertEqual(len(result["reports"]), 301)
        self.assertEqual({report["n"] for report in result["reports"]}, {1500})
        self.assertNotEqual(self.ctl("status", "--json")["pid"], instance)
        self.down()


if __name__ == "__main__":
    unittest.main(verbosity=2)
