"""Parallel solvers: M seats push a scene together, wait for one another, die and return."""
import threading
import unittest.mock

import judge
from seat_client import Seat, owner
from protocol_client import NOTICE, Client, Refused, arrays_of, reframed
from push_client import WAYS, Block
from support import *


class Seats(ServiceTest):
    ranks = 3

    @classmethod
    def setUpClass(cls):
        super().setUpClass()
        rng = np.random.default_rng(7)
        cls.walk = rng.random((5, 600, 3)).cumsum(axis=0) * [1, 2, 1]
        cls.walk[2] = cls.walk[1] + rng.normal(0, 1e-2, cls.walk[0].shape)
        cls.walk[3] = cls.walk[2] + rng.normal(0, 1e-2, cls.walk[0].shape)
        cls.control = Client(cls.path)
        cls.addClassCleanup(cls.control.close)

    def create(self, scene, parts=7):
        self.control.ask("scene.create", scene=scene, parts=parts, replace=True)

    def team(self, scene, seats, **kwargs):
        team = [Seat(self.path, scene, k, seats, **kwargs) for k in range(seats)]
        for one in team:
            self.addCleanup(one.close)
        return team

    def state(self, scene):
        shown = self.control.ask("scene.show", scene=scene)[0]
        history = self.control.ask("history", scene=scene)[0]["history"]
        for report in history:
            for name in ("seconds", "scene", "way", "strangers"):
                report.pop(name)
            report["skipped"] = [skip for skip in report["skipped"] if skip != "exchange"]  # by who got which rows
        kept = {name: shown[name] for name in ("hash", "counts", "error", "step", "epoch", "ids")}
        return kept, history, self.control.ask("assign", scene=scene)[1]

    def refused(self, client, code, *words):
        with self.assertRaises(Refused) as caught:
            client.finish()
        self.assertEqual(caught.exception.args[0], code, caught.exception.args)
        for word in words:
            self.assertIn(word, caught.exception.args[1])

    def push_all(self, team, step, shares, points, **more):
        for one, ids in zip(team, shares):
            one.start(step, ids, points, **more)
        return [one.finish() for one in team]

    def test_the_same_scene_as_from_one_client(self):
        self.create("one")
        for step, points in enumerate(self.walk):
            self.control.push("one", step, points, ids=np.arange(600))
        for seats in (1, 2, 3, 5):
            self.create("many")
            team = self.team("many", seats)
            rng = np.random.default_rng(seats)
            known = {}
            for step, points in enumerate(self.walk):  # any split, in any order, by any ways, new ones every time
                order = rng.permutation(len(points))
                shares = np.split(order, np.sort(rng.integers(0, len(points) + 1, seats - 1)))
                for k, (one, ids) in enumerate(zip(team, shares)):
                    deal = np.split(rng.permutation(len(ids)), np.sort(rng.integers(0, len(ids) + 1, 2)))
                    one.start(step, ids, points, way=str(rng.choice(WAYS)), deal=deal, each=70,
                              cuts_known=known if k != 1 else None)
                answers = [one.finish() for one in team]
                for k, (answer, arrays) in enumerate(answers):
                    self.assertEqual(answer["report"], answers[0][0]["report"])
                    self.assertEqual("cuts" in answer, k != 1 and answer["report"]["repartitioned"])
                    self.assertEqual(arrays != {}, "cuts" in answer)
                if "cuts" in answers[0][0]:
                    known = {name: answers[0][0]["cuts"][name] for name in ("epoch", "hash")}
                    parts = judge.Tree.of_arrays(answers[0][1], 3).assign(points)
                    assigned = arrays_of(*self.control.ask("assign", scene="many"))["part"]
                    np.testing.assert_array_equal(parts, assigned)
            self.assertEqual(self.state("many"), self.state("one"))
            for one in team:
                one.close()

    def test_seats_keep_their_parts(self):
        """Who hands over what left its parts brings as strangers what has left since."""
        parts, n = 7, len(self.walk[0])
        for seats in (1, 2, 3, 5):
            self.create("keep", parts)
            team, tree, strange = self.team("keep", seats), None, 0
            held = np.array_split(np.arange(n), seats)
            for step, points in enumerate(self.walk):
                answers = self.push_all(team, step, held, points, cuts_known={})
                expected = 0
                if tree and seats > 1:
                    left = owner(tree.assign(points), parts, seats)
                    expected = sum(int((left[ids] != k).sum()) for k, ids in enumerate(held))
                self.assertEqual(answers[0][0]["report"]["strangers"], expected if tree else 0)
                strange += expected
                tree = judge.Tree.of_arrays(answers[0][1], 3)
                of_id = owner(tree.assign(points), parts, seats)
                held = [np.flatnonzero(of_id == k) for k in range(seats)]
            self.assertEqual(strange > 0, seats > 1)
            for one in team:
                one.close()

    def test_particles_that_come_and_go_in_a_scene_of_weights_and_empty_seats(self):
        ids, come = np.array([5, 900, 7, 2**62, 11]), 6
        points = np.random.default_rng(1).random((6, 2))
        self.control.ask("scene.create", scene="sparse", parts=2, dims=2, replace=True)
        team = self.team("sparse", 3)

        def step(number, ids, *numbers):
            for one, rows, (inserted, removed) in zip(team, ([0, 3], [], list(range(len(ids)))[1:3] + list(range(4, len(ids)))),
                                                      numbers):
                weights = ids[rows] % 3 + 1.0 if rows else None  # who has none need not know
                begin, slices = one.frames("sparse", number, Block(points[rows], ids[rows], weights), inserted=inserted,
                                           removed=removed)
                one.socket.sendall(begin + b"".join(data for _, data in slices))
            return [one.finish()[0]["report"] for one in team]

        none = ((0, 0),) * 3
        for number in range(2):
            self.assertEqual([report["n"] for report in step(number, ids, *none)], [5] * 3)
        report = step(2, np.append(ids, come), (0, 0), (0, 0), (1, 0))[0]  # one comes to the last seat
        self.assertEqual((report["n"], report["inserted"], report["removed"]), (6, 1, 0))
        others = np.append(ids[:-1], (13, come))  # the first says one is gone, the last has another
        report = step(3, others, (0, 1), (0, 0), (1, 0))[0]
        self.assertEqual((report["n"], report["inserted"], report["removed"]), (6, 1, 1))
        shown = self.control.ask("scene.show", scene="sparse")[0]
        self.assertTrue(shown["ids"] and shown["weights"])
        self.assertEqual(arrays_of(*self.control.ask("fetch", scene="sparse"))["id"].tolist(), sorted(others))

    def test_seats(self):
        self.create("seats")

        def refuses(code, *words, **kwargs):
            with self.assertRaises(Refused) as caught:
                Seat(self.path, "seats", **kwargs)
            self.assertEqual(caught.exception.args[0], code, caught.exception.args)
            for word in words:
                self.assertIn(word, caught.exception.args[1])

        team = self.team("seats", 2)
        self.assertEqual(team[1].opened["seat"], {"seat": 1, "seats": 2, "generation": 1})
        refuses("busy", "seat 1", "generation 1", seat=1, seats=2)
        refuses("invalid_argument", "2 seats", seat=1, seats=3)
        refuses("invalid_argument", "seat", seat=2, seats=2)
        refuses("busy", "generation", seat=1, seats=2, generation=1)
        with self.assertRaises(Refused) as caught:
            team[0].ask("scene.open", scene="seats", seat=0, seats=2, generation=9)
        self.assertEqual(caught.exception.args[0], "invalid_argument")
        with self.assertRaises(Refused) as caught:  # others may look, not push
            self.control.push("seats", 0, self.walk[0])
        self.assertEqual(caught.exception.args[0], "busy")
        self.assertIn("2 seats", caught.exception.args[1])
        with self.assertRaises(Refused) as caught:
            self.control.ask("load", scene="seats", path=self.save("theirs.npy", self.walk[0]))
        self.assertEqual(caught.exception.args[0], "busy")
        self.assertIn("2 seats", caught.exception.args[1])
        for one in team:
            one.ask("scene.close", scene="seats")
        third = Seat(self.path, "seats", 2, 3)
        third.ask("scene.close", scene="seats")  # a connection's end is noticed in its own time
        third.close()
        self.create("seats")

    def test_a_seat_that_never_pushes(self):
        self.create("late")
        team = self.team("late", 4)
        halves = np.array_split(np.arange(600), 4)
        for k in (0, 3):
            team[k].start(0, halves[k], self.walk[0], deadline_seconds=1)
        team[1].begin(0, halves[1], self.walk[0], deadline_seconds=9)  # and this one no rows
        for k in (0, 1, 3):
            self.refused(team[k], "deadline_exceeded", "seat 1", "seat 2", "step 0")
        team[1].rest()  # which is dropped
        self.push_all(team, 0, halves, self.walk[0])
        self.assertEqual(self.state("late")[0]["step"], 0)

    def test_a_step_that_is_another_than_that_of_the_others(self):
        halves = np.array_split(np.arange(600), 2)
        self.create("hasty")
        team = self.team("hasty", 2)
        team[0].start(0, halves[0], self.walk[0])
        begun = team[0].begun
        team[0].start(1, halves[0], self.walk[1])  # which is refused, and ends nothing
        self.refused(team[0], "invalid_argument", "the others push step 0")
        team[0].begun = begun
        team[1].start(0, halves[1], self.walk[0])
        for one in team:
            self.assertEqual(one.finish()[0]["report"]["step"], 0)

    def test_a_step_beyond_its_deadline_goes_on(self):
        with Service(2) as service:
            control = Client(service.endpoint[5:])
            self.addCleanup(control.close)
            control.ask("scene.create", scene="slow", parts=2)
            team = [Seat(service.endpoint[5:], "slow", k, 2) for k in range(2)]
            for one in team:
                self.addCleanup(one.close)
            halves = np.array_split(np.arange(600), 2)
            first = control.ask("status")[0]["pid"]
            other, = [pid for pid, line in processes_of(service.dir)
                      if line.split()[0].endswith("/rcbd") and pid != first]
            os.kill(other, signal.SIGSTOP)  # the engine waits for it in the step's first collective
            try:
                for one, ids in zip(team, halves):
                    one.start(0, ids, self.walk[0], deadline_seconds=1)
                for one in team:
                    self.refused(one, "deadline_exceeded", "step 0", "it goes on")
            finally:
                os.kill(other, signal.SIGCONT)
            for answer, _ in self.push_all(team, 0, halves, self.walk[0]):
                self.assertEqual(answer["report"]["step"], 0)
            self.assertEqual(control.ask("scene.show", scene="slow")[0]["step"], 0)
            self.push_all(team, 1, halves, self.walk[1])

    def test_waiting_seats_are_told_for_whom(self):
        self.create("told")
        team = self.team("told", 2)
        team[0].start(0, np.arange(300), self.walk[0])
        kind, request, document, _ = team[0].receive()  # after five seconds
        self.assertEqual((kind, request), (NOTICE, team[0].begun))
        self.assertIn("seat 1", document["notice"])
        team[1].start(0, np.arange(300, 600), self.walk[0])
        self.assertEqual(team[0].finish()[0]["report"]["step"], 0)
        team[1].finish()

    def test_a_seat_that_dies_in_mid_push_and_returns(self):
        self.create("dies")
        halves = np.array_split(np.arange(600), 3)
        team = self.team("dies", 3)
        self.push_all(team, 0, halves, self.walk[0])
        before = self.state("dies")
        for cut in (None, 1, 5000):  # nothing of it, all but a byte, half
            for k in (0, 1):
                team[k].start(1, halves[k], self.walk[1])
            if cut:
                team[2].begin(1, halves[2], self.walk[1], cut)
            generation = team[2].opened["seat"]["generation"]
            team[2].close()
            for k in (0, 1):
                self.refused(team[k], "aborted", "seat 2", "connection")
            self.assertEqual(self.state("dies"), before)
            team[2] = Seat(self.path, "dies", 2, 3)
            self.addCleanup(team[2].close)
            self.assertEqual(team[2].opened["seat"]["generation"], generation + 1)
        self.push_all(team, 1, halves, self.walk[1])
        # Away between two steps: the others wait for the return.
        team[2].close()
        for k in (0, 1):
            team[k].start(2, halves[k], self.walk[2])
        team[2] = Seat(self.path, "dies", 2, 3)
        self.addCleanup(team[2].close)
        team[2].start(2, halves[2], self.walk[2])
        for one in team:
            self.assertEqual(one.finish()[0]["report"]["step"], 2)

    def test_slices_of_an_older_generation_are_dropped(self):
        self.create("older")
        halves = np.array_split(np.arange(600), 2)
        team = self.team("older", 2)
        old = team[1]
        team[0].start(0, halves[0], self.walk[0])
        old.begin(0, halves[1], self.walk[0] + 5)
        new = Seat(self.path, "older", 1, 2, generation=2)
        self.addCleanup(new.close)
        self.refused(team[0], "aborted", "seat 1", "generation 2")
        self.refused(old, "aborted", "seat 1")
        team[0].start(0, halves[0], self.walk[0])
        old.rest()  # too late: read and dropped
        old.start(0, halves[1], self.walk[0] + 5)
        self.refused(old, "aborted", "generation")
        new.start(0, halves[1], self.walk[0])
        self.assertEqual(team[0].finish()[0]["report"]["n"], 600)
        new.finish()
        fetched = self.control.ask("fetch", scene="older")[1]
        np.testing.assert_array_equal(np.frombuffer(fetched[4800:9600], "<f8"), self.walk[0][:, 0])

    def test_a_lost_answer_is_given_again(self):
        self.create("again")
        halves = np.array_split(np.arange(600), 2)
        team = self.team("again", 2)
        answers = self.push_all(team, 0, halves, self.walk[0])
        team[1].close()
        back = Seat(self.path, "again", 1, 2, session=team[1].session)
        self.addCleanup(back.close)
        back.start(0, halves[1][:9], self.walk[1], way="sockets")  # whatever it brings
        answer, arrays = back.finish()
        self.assertEqual((answer["repeated"], answer["report"], arrays), (True, answers[1][0]["report"], {}))
        stranger = Seat(self.path, "again", 1, 2, generation=7)
        self.addCleanup(stranger.close)
        stranger.start(0, halves[1], self.walk[0])
        self.refused(stranger, "stale_step", "0")

    def test_no_answer_is_given_again_after_a_later_step(self):
        self.create("later")
        halves = np.array_split(np.arange(600), 2)
        team = self.team("later", 2)
        self.push_all(team, 0, halves, self.walk[0])
        for one in team:
            one.close()
        wait_for(lambda: "e2e" not in self.control.ask("scene.show", scene="later")[0]["holders"])
        self.control.push("later", 1, self.walk[1], ids=np.arange(600))  # the seats had no part in it
        back = Seat(self.path, "later", 1, 2, session=team[1].session)
        self.addCleanup(back.close)
        back.start(0, halves[1], self.walk[0])
        self.refused(back, "stale_step", "step 0")

    def test_what_seats_push_wrong(self):
        self.create("wrong")
        team = self.team("wrong", 2)
        ids = np.arange(600)

        def both(code, words, first, second, points=self.walk[0], step=0):
            for one, mine in zip(team, (first, second)):
                one.start(step, mine, points)
            for one in team:
                self.refused(one, code, *words)

        both("duplicate_id", ("id 299", "seat 0", "seat 1"), ids[:300], ids[299:])
        both("duplicate_id", ("id 5", "twice", "seat 1"), ids[:5], np.append(ids[5:], 5))
        bad = self.walk[0].copy()
        bad[17, 1] = np.nan
        both("not_finite", ("17",), ids[:300], ids[300:], bad)
        self.push_all(team, 0, (ids[:300], ids[300:]), self.walk[0])
        before = self.state("wrong")
        both("not_conserved", ("599", "600"), ids[:300], ids[301:], step=1)
        more = np.concatenate([self.walk[0], self.walk[0]])
        both("not_conserved", ("601", "600"), ids[:300], np.append(ids[300:], 700), more, step=1)
        both("not_conserved", (), ids[:300], np.append(ids[301:], 700), more, step=1)
        both("not_conserved", (), ids[:300], np.append(ids[301:], 299), more, step=1)
        team[0].begin(1, ids[:300], self.walk[1])
        time.sleep(0.3)
        for step, more, words in ((2, {}, ("step 2", "step 1")), (1, {"step_seconds": -1}, ("step_seconds",)),
                                  (1, {"weights": True}, ("weights",)), (1, {"ids": False}, ("ids",))):
            team[1].start(step, ids[300:], self.walk[1], **more)
            self.refused(team[1], "invalid_argument", *words)
        self.assertEqual(self.state("wrong"), before)
        team[0].rest()
        team[1].start(1, ids[300:], self.walk[1])
        for one in team:
            self.assertEqual(one.finish()[0]["report"]["step"], 1)

    def test_what_is_wrong_in_a_block_to_the_ranks_ends_the_step_for_all(self):
        self.create("odd")
        shares = np.array_split(np.arange(600), 4)
        team = self.team("odd", 4, way="sockets")
        self.push_all(team, 0, shares, self.walk[0])
        before = self.state("odd")

        def refuse_all(code, *words):
            for one in team:
                self.refused(one, code, *words)
            self.assertEqual(self.state("odd"), before)

        for one, ids in zip(team, shares):
            one.begin(1, ids, self.walk[1], each=20)
        for one in team[:-1]:
            one.rest()
        link, data = team[-1].slices[1]
        link.sendall(reframed(data, lambda document: document.update(first=40)))
        refuse_all("invalid_argument", "seat 3")
        for one, ids in zip(team, shares):
            one.begin(1, ids, self.walk[1], deadline_seconds=1 if one is team[0] else 20)
        for one in team[:2]:
            one.rest()
        refuse_all("deadline_exceeded", "seat 2", "seat 3")
        for one, ids in zip(team, shares):
            one.begin(1, ids, self.walk[1])
        for one in team[:-1]:
            one.rest()
        link, data = team[-1].slices[0]
        link.sendall(data[: len(data) // 2])
        team[-1].close()
        for one in team[:-1]:
            self.refused(one, "aborted", "seat 3")
        self.assertEqual(self.state("odd"), before)
        team[-1] = Seat(self.path, "odd", 3, 4)
        self.addCleanup(team[-1].close)
        self.push_all(team, 1, shares, self.walk[1])

    def test_a_rebalance_between_seats_does_not_stop_them(self):
        self.create("between")
        halves = np.array_split(np.arange(600), 2)
        team = self.team("between", 2)
        self.push_all(team, 0, halves, self.walk[0])
        team[0].start(1, halves[0], self.walk[1])
        with Client(self.path) as other:
            self.control.ask("status")
            done = threading.Thread(target=other.ask, args=("rebalance",), kwargs={"scene": "between"})
            done.start()
            self.control.ask("status")
            team[1].start(1, halves[1], self.walk[1])
            for one in team:
                self.assertEqual(one.finish()[0]["report"]["step"], 1)
            done.join()

    def solver(self, service, processes, scene, path, steps=8):
        command = [MPIRUN, str(processes), os.path.join(BIN, "slope_mpi"), "--points", "1500", "--interval", "0.3",
                   "--parts", "6", "--tolerance", "0.02", "--steps", str(steps), "--scene", scene,
                   "--positions", "every-step", "--json", "--check"]
        return subprocess.Popen(command, env=dict(os.environ, RCBD_ENDPOINT=service.endpoint, RCBD_PATH=path),
                                stdin=subprocess.DEVNULL, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)

    def solved(self, running):
        out, errors = running.communicate(timeout=120)
        self.assertEqual(running.returncode, 0, out + errors)
        return json.loads(out)

    def test_the_library_by_every_path(self):
        for processes in (3, 2, 5):
            found = {}
            for path, way in (("gateway", "endpoint"), ("direct", "sockets"), ("shared", "shared-memory")):
                solved = self.solved(self.solver(self.service, processes, path, path))
                for report in solved["reports"]:
                    self.assertEqual((report.pop("way"), report["bytes"]), (way, 32 * 1500))
                    report.pop("seconds"), report.pop("scene")
                    report["skipped"] = [skip for skip in report["skipped"] if skip != "exchange"]
                found[path] = {name: solved[name] for name in ("reports", "held", "handed_over", "repartitions")}
                self.assertEqual((found[path], self.state(path)), (found["gateway"], self.state("gateway")))
            self.assertGreater(found["direct"]["repartitions"], 1)

    def test_the_library_while_others_change_the_cuts(self):
        running = self.solver(self.service, 4, "shaken", "direct", steps=60)
        rebalanced, next_step = 0, 0
        try:
            while running.poll() is None:
                try:
                    step = self.control.ask("scene.show", scene="shaken")[0]["step"]
                    if step is not None and step >= next_step:
                        self.control.ask("rebalance", scene="shaken", method=("bands-x", "rcb")[rebalanced % 2])
                        rebalanced, next_step = rebalanced + 1, step + 5
                except Refused as refused:
                    self.assertIn(refused.args[0], ("not_found", "busy"))
                time.sleep(0.02)
        finally:
            solved = self.solved(running)
        self.assertEqual(sum(solved["held"]), 1500)
        self.assertGreater(rebalanced, 1)

    def test_the_library_and_a_service_of_the_gateway_alone(self):
        with unittest.mock.patch.dict(os.environ, RCBD_GATEWAY_ONLY="1"), Service(2) as service:
            self.solved(self.solver(service, 2, "slope", "auto"))
            running = self.solver(service, 2, "slope", "direct")
            self.assertIn("--gateway-only", running.communicate(timeout=120)[1])
            self.assertEqual(running.returncode, 3)


if __name__ == "__main__":
    unittest.main(verbosity=2)
